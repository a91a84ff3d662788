"""Where jobs run: on this machine's cores, or on a Ray cluster. Jobs know nothing of it, and share nothing.

An executor runs a function over jobs and yields the outcomes as they come. If a process or a machine dies, only its own
jobs are restarted elsewhere, a few times. To add an executor: its file, and its name in `EXECUTORS`.
"""

from collections.abc import Callable, Generator, Iterable
from dataclasses import dataclass
from typing import Any, Final, Protocol

from fastmimic.base.errors import ConfigError, FastMimicError, unknown
from fastmimic.base.registry import load_extensions

EXECUTORS: Final = {"local": "processes on this machine", "ray": "a Ray cluster"}
ATTEMPTS: Final = 4  # starts of a job, in all, if its process or machine dies

Told = Callable[[int, float], None]  # takes a job's index and its finished share in [0, 1]
Report = Callable[[float], None]  # takes a job's finished share in [0, 1], called now and then
Work = Callable[[Any, Report], Any]  # a module's function, called with each job: other processes import it by its name


@dataclass(frozen=True)
class JobOutcome:
    """Outcome of a job."""

    index: int  # of the job, from 0
    result: Any = None  # what the function returned; None if it raised
    error: FastMimicError | None = None  # what it raised; a `WorkerError` if its process or machine was lost every time


Outcomes = Generator[JobOutcome, None, None]


class Executor(Protocol):
    def run(self, work: Work, jobs: Iterable[Any], progress: Told | None = None) -> Outcomes:
        """Runs `work` on all jobs, which can be pickled; yields each outcome as soon as it is there. Closing it, or
        Ctrl-C, stops what runs. `progress` is called with a job's index and finished share, before its outcome. Raises
        `ClusterError` if no more jobs can run, and what a job raises, if it is no `FastMimicError`: a defect."""


def attempt(work: Work, job: Any, report: Report = lambda share: None) -> tuple[Any, FastMimicError | None]:
    """A job's result, or the `FastMimicError` that it raised."""
    try:
        load_extensions()  # a process of its own has not got them yet
        return work(job, report), None
    except FastMimicError as error:
        return None, error


def check_workers(workers: int | None) -> None:
    """Raises `ConfigError` if fewer than one is asked for."""
    if workers is not None and workers < 1:
        raise ConfigError(f"workers must be at least 1, found {workers}")


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
