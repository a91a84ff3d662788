"""The command `fastmimic`, also as `python -m fastmimic`."""

import gc
import sys

from fastmimic.cli import main


def run() -> int:
    """Runs the command line of the process; returns the exit status."""
    gc.set_threshold(50_000, 20, 100)  # a start makes many objects that stay: looking through them costs time
    return main()


if __name__ == "__main__":
    sys.exit(run())
