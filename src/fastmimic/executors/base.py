"""What every executor is."""

from collections.abc import Callable, Generator, Iterable
from dataclasses import dataclass
from typing import Any, Final, Protocol

from fastmimic.base.errors import FastMimicError
from fastmimic.base.extensions import load_extensions

ATTEMPTS: Final = 4
"""How often a job is begun, in all, whose process or machine dies."""

Report = Callable[[float], None]
"""What a job calls now and then with the share of it that is done, in [0, 1]."""
Work = Callable[[Any, Report], Any]
"""What is done with a job. A module's function: other processes import it by its name."""


@dataclass(frozen=True)
class JobOutcome:
    """What came of a job.

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
        """How many run at a time, as far as that is known beforehand."""

    def run(
        self, work: Work, jobs: Iterable[Any], progress: Callable[[int, float], None] | None = None
    ) -> Generator[JobOutcome, None, None]:
        """Runs all jobs; yields each one's outcome as it is there.

        Closing it (`contextlib.closing`), or Ctrl-C, stops what runs. Anything but a `FastMimicError` that a job raises
        is a defect, and is raised here.

        Args:
            work: the function.
            jobs: what it is called with, one after another; anything that can be pickled.
            progress: called with a job's index and the share of it that is done, where the executor is told.

        Raises:
            ClusterError: no job can be run there any more.
        """


def attempt(work: Work, job: Any, report: Report) -> tuple[Any, FastMimicError | None]:
    """A job's result, or what it raised that a user can cause."""
    try:
        load_extensions()  # a process of its own has not got them yet
        return work(job, report), None
    except FastMimicError as error:
        return None, error
