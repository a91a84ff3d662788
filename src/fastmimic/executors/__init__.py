"""Where jobs run: on this machine's cores, or on a Ray cluster. Jobs know nothing of it, and share nothing.

An executor runs a function over jobs and yields the outcomes as they come. If a process or a machine dies, only its own
jobs are restarted elsewhere, a few times. To add an executor: its file, and its name in `EXECUTORS`.
"""

from fastmimic.executors.base import Executor, JobOutcome, Report
from fastmimic.executors.choice import EXECUTORS, make_executor

__all__ = ["EXECUTORS", "Executor", "JobOutcome", "Report", "make_executor"]
