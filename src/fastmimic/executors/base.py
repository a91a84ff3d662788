"""The interface of executors, and the executors by name."""

from collections.abc import Callable, Generator, Iterable
from dataclasses import dataclass
from typing import Any, Final, Protocol

from fastmimic.base.errors import ConfigError, FastMimicError, did_you_mean
from fastmimic.base.registry import load_extensions

EXECUTORS: Final = {"local": "processes on this machine", "ray": "a Ray cluster"}
ATTEMPTS: Final = 4  # starts of a job, in all, if its process or machine dies

Report = Callable[[float], None]  # takes a job's finished share in [0, 1], called now and then
Work = Callable[[Any, Report], Any]  # a module's function, called with each job: other processes import it by its name


@dataclass(frozen=True)
class JobOutcome:
    """Outcome of a job.

    Attributes:
        index: of the job, from 0.
        result: what the function returned; None if it raised.
        error: what it raised, or a `WorkerError` if its process or machine was lost every time; None without.
    """

    index: int
    result: Any = None
    error: FastMimicError | None = None


class Executor(Protocol):
    """Runs jobs."""

    @property
    def workers(self) -> int:
        """How many run at a time, as far as known beforehand."""

    def run(
        self, work: Work, jobs: Iterable[Any], progress: Callable[[int, float], None] | None = None
    ) -> Generator[JobOutcome, None, None]:
        """Runs `work` on all jobs, which can be pickled; yields each outcome as soon as it is there. Closing it
        (`contextlib.closing`), or Ctrl-C, stops what runs. `progress` is called with a job's index and its finished
        share. Raises `ClusterError` if no more jobs can run; of what a job raises, anything but a `FastMimicError` is a
        defect and is raised here."""


def attempt(work: Work, job: Any, report: Report) -> tuple[Any, FastMimicError | None]:
    """A job's result, or the `FastMimicError` that it raised."""
    try:
        load_extensions()  # a process of its own has not got them yet
        return work(job, report), None
    except FastMimicError as error:
        return None, error


def make_executor(name: str, *, workers: int | None = None, address: str | None = None) -> Executor:
    """The executor of that name, one of `EXECUTORS`, for `workers` jobs at a time (one per core if None); `address` is
    of a running Ray cluster. Raises `ConfigError` for a wrong argument, or if Ray is needed and not installed."""
    if name not in EXECUTORS:
        raise ConfigError(f"unknown executor '{name}'; there are {', '.join(EXECUTORS)}{did_you_mean(name, EXECUTORS)}")
    if name == "local":
        from fastmimic.executors.local import LocalExecutor

        if address is not None:
            raise ConfigError("an address is of a Ray cluster; the executor 'local' has none")
        return LocalExecutor(workers)
    from fastmimic.executors.ray_cluster import RayExecutor

    return RayExecutor(address, workers)


def check_workers(workers: int | None) -> None:
    """Raises `ConfigError` if fewer than one is asked for."""
    if workers is not None and workers < 1:
        raise ConfigError(f"workers must be at least 1, found {workers}")
