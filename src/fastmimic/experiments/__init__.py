"""The paper's comparison and ours, each a function that returns a table."""
