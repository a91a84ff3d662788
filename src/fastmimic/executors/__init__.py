"""Where jobs run: on this machine's cores, or on a Ray cluster. Jobs know nothing of it, and share nothing.

An executor runs a function over jobs and yields the outcomes as they come. If a process or a machine dies, only its own
jobs are restarted elsewhere, a few times. To add an executor: its file, and its name in `EXECUTORS`.
"""

from typing import Final

from fastmimic.base.errors import ConfigError, unknown
from fastmimic.executors.base import Executor, JobOutcome, Report

__all__ = ["EXECUTORS", "Executor", "JobOutcome", "Report", "make_executor"]

EXECUTORS: Final = {"local": "processes on this machine", "ray": "a Ray cluster"}


def make_executor(name: str, *, workers: int | None = None, address: str | None = None) -> Executor:
    """The executor of that name, one of `EXECUTORS`, for `workers` jobs at a time (one per core if None); `address` is
    of a running Ray cluster. Raises `ConfigError` for a wrong argument, or if Ray is needed and not installed."""
    if name not in EXECUTORS:
        raise unknown("executor", name, EXECUTORS)
    if name == "local":
        from fastmimic.executors.local import LocalExecutor

        if address is not None:
            raise ConfigError("an address is of a Ray cluster; the executor 'local' has none")
        return LocalExecutor(workers)
    from fastmimic.executors.ray_cluster import RayExecutor

    return RayExecutor(address, workers)
