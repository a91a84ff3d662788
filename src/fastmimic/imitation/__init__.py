"""The main functions `imitate`, `evaluate` and `stitch`, and the methods by name."""
