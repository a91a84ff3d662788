"""The command line in a process of its own, choosing quickly at the end of a search, and evaluating shortly."""

import signal
import sys

import fastmimic.experiments.comparison_run as runs
import fastmimic.optimize.cma_es as cma_es
from fastmimic.cli import main

if __name__ == "__main__":
    signal.signal(signal.SIGINT, signal.default_int_handler)  # a test runner in the background has it ignored
    vars(runs).update(EVALUATION_S=0.6)
    vars(cma_es).update(VALIDATION_S=0.4, VALIDATION_EPISODES=2, VALIDATED=2)
    sys.exit(main())
