"""The command line in a process of its own, choosing quickly at the end of a search."""

import signal
import sys

import fastmimic.optimize.cma_es as cma_es
from fastmimic.cli import main

if __name__ == "__main__":
    signal.signal(signal.SIGINT, signal.default_int_handler)  # a test runner in the background has it ignored
    cma_es.VALIDATION_S, cma_es.VALIDATION_EPISODES, cma_es.VALIDATED = 0.4, 2, 2
    sys.exit(main())
