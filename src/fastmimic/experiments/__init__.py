"""Experiments of the paper and further ones, each a function that returns a table."""
