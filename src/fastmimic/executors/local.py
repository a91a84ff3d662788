"""The cores of this machine: one process for each, one thread in each.

Pebble's pool replaces a process that dies and tells which job it had; `concurrent.futures` breaks as a whole.
"""

import multiprocessing
import os
import queue
import signal
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, wait
from contextlib import contextmanager
from typing import Any, Final

from pebble import ProcessExpired, ProcessPool

from fastmimic.base.errors import ConfigError, FastMimicError, WorkerError
from fastmimic.base.machine import available_cores
from fastmimic.executors.base import ATTEMPTS, JobOutcome, Report, Work, attempt

_POLL_S: Final = 0.5
_AHEAD: Final = 2  # jobs handed out for each process, so that none waits for the next
_ONE_THREAD: Final = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


class LocalExecutor:
    """Processes on this machine."""

    def __init__(self, workers: int | None = None, *, in_process: bool = True) -> None:
        """`workers` are processes; one for each core if None. Raises `ConfigError` if fewer than one. With `in_process`
        a single worker is this process itself, one job after another; otherwise it is a separate process, too, which is
        restarted if it dies."""
        if workers is not None and workers < 1:
            raise ConfigError(f"workers must be at least 1, found {workers}")
        self._workers = workers if workers is not None else available_cores()
        self._in_process = in_process

    @property
    def workers(self) -> int:
        """Processes."""
        return self._workers

    def run(
        self, work: Work, jobs: Iterable[Any], progress: Callable[[int, float], None] | None = None
    ) -> Generator[JobOutcome, None, None]:
        """As `Executor.run`."""
        if self._workers == 1 and self._in_process:
            return _here(work, jobs, progress)
        return _spread(work, jobs, self._workers, progress)


def _here(
    work: Work, jobs: Iterable[Any], progress: Callable[[int, float], None] | None
) -> Generator[JobOutcome, None, None]:
    for index, job in enumerate(jobs):

        def report(share: float, index: int = index) -> None:
            if progress is not None:
                progress(index, share)

        yield JobOutcome(index, *attempt(work, job, report))


def _spread(
    work: Work, jobs: Iterable[Any], workers: int, progress: Callable[[int, float], None] | None
) -> Generator[JobOutcome, None, None]:
    context = multiprocessing.get_context("spawn")
    steps: Any = context.Queue()
    waiting = enumerate(jobs)
    running: dict[Future[Any], tuple[int, Any, int]] = {}  # its job's index, the job, and how often it was begun

    with _one_thread_each(), _pool(workers, context, steps) as pool:

        def begin(index: int, job: Any, attempts: int) -> None:
            running[pool.schedule(_work, args=(work, index, job))] = (index, job, attempts)

        def fill() -> None:
            while len(running) < _AHEAD * workers and (following := next(waiting, None)) is not None:
                begin(*following, 1)

        fill()
        while running:
            done, _ = wait(running, timeout=_POLL_S, return_when=FIRST_COMPLETED)
            for index, share in _drained(steps):
                if progress is not None:
                    progress(index, share)
            for future in done:
                index, job, attempts = running.pop(future)
                try:
                    outcome = JobOutcome(index, *future.result())
                except ProcessExpired as died:
                    if attempts < ATTEMPTS:
                        begin(index, job, attempts + 1)
                        continue
                    outcome = JobOutcome(index, error=_died(attempts, died))
                fill()
                yield outcome


def _died(attempts: int, died: ProcessExpired) -> FastMimicError:
    return WorkerError(
        f"its process died {attempts} times (exit status {died.exitcode}), perhaps for want of memory: fewer workers"
        " leave more to each"
    )


@contextmanager
def _pool(workers: int, context: Any, steps: Any) -> Iterator[ProcessPool]:
    """A pool that stops its processes, without waiting, if its jobs are no longer wanted."""
    pool = ProcessPool(workers, initializer=_begin, initargs=(steps,), context=context)
    try:
        yield pool
        pool.close()
    finally:
        pool.stop()
        pool.join()


@contextmanager
def _one_thread_each() -> Iterator[None]:
    """Makes processes started in the block use one thread for linear algebra, unless the user said otherwise."""
    added = [name for name in _ONE_THREAD if name not in os.environ]
    os.environ.update(dict.fromkeys(added, "1"))
    try:
        yield
    finally:
        for name in added:
            os.environ.pop(name, None)


_steps: Any = None


def _begin(steps: Any) -> None:
    """Prepares a process of the pool: Ctrl-C is the parent's to handle."""
    global _steps
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    _steps = steps


def _work(work: Work, index: int, job: Any) -> tuple[Any, FastMimicError | None]:
    def report(share: float) -> None:
        parent = multiprocessing.parent_process()
        if parent is not None and not parent.is_alive():
            os._exit(1)  # it was killed, and nobody will ask for the result
        _steps.put((index, share))

    reporting: Report = report
    return attempt(work, job, reporting)


def _drained(steps: Any) -> Iterator[tuple[int, float]]:
    while True:
        try:
            yield steps.get_nowait()
        except queue.Empty:
            return
