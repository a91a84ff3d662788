"""The main jobs: `imitate`, `evaluate` and `stitch`, and the methods by name."""
