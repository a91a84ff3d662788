"""The command line in a process of its own, choosing quickly at the end of a search, and evaluating shortly."""

import gc
import signal
import sys

from searches import quick_main

if __name__ == "__main__":
    gc.set_threshold(50_000, 20, 100)  # as in `conftest`
    signal.signal(signal.SIGINT, signal.default_int_handler)  # a test runner in the background has it ignored
    sys.exit(quick_main())
