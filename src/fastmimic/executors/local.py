"""The cores of this machine: one process for each, one thread in each.

Pebble's pool replaces a process that dies and tells which job it had; `concurrent.futures` breaks as a whole.
"""

import multiprocessing
import os
import queue
import signal
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, wait
from contextlib import contextmanager, suppress
from functools import partial
from typing import Any, Final

from pebble import ProcessExpired, ProcessPool

from fastmimic.base.errors import FastMimicError, WorkerError
from fastmimic.base.machine import available_cores
from fastmimic.executors import ATTEMPTS, JobOutcome, Work, attempt, check_workers

_POLL_S: Final = 0.5
_AHEAD: Final = 2  # jobs handed out for each process, so that none waits for the next
_ONE_THREAD: Final = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
_CONTEXT: Final = multiprocessing.get_context("spawn")


class LocalExecutor:
    """Processes on this machine; `workers` is their number."""

    def __init__(self, workers: int | None = None, *, in_process: bool = True) -> None:
        """`workers` is one for each core if None; raises `ConfigError` if fewer than one. With `in_process` a single
        worker is this process itself; otherwise it is a separate one, too, which is restarted if it dies."""
        check_workers(workers)
        self.workers = workers if workers is not None else available_cores()
        self._in_process = in_process

    def run(
        self, work: Work, jobs: Iterable[Any], progress: Callable[[int, float], None] | None = None
    ) -> Generator[JobOutcome, None, None]:
        tell = progress if progress is not None else lambda index, share: None
        if self.workers > 1 or not self._in_process:
            yield from _spread(work, jobs, self.workers, tell)
            return
        for index, job in enumerate(jobs):
            yield JobOutcome(index, *attempt(work, job, partial(tell, index)))


def _spread(
    work: Work, jobs: Iterable[Any], workers: int, progress: Callable[[int, float], None]
) -> Generator[JobOutcome, None, None]:
    steps: Any = _CONTEXT.Queue()
    waiting = enumerate(jobs)
    running: dict[Future[Any], tuple[int, Any, int]] = {}  # its job's index, the job, and how often it was begun
    with _pool(workers, steps) as pool:

        def begin(index: int, job: Any, attempts: int) -> None:
            running[pool.schedule(_work, args=(work, index, job))] = (index, job, attempts)

        def fill() -> None:
            while len(running) < _AHEAD * workers and (following := next(waiting, None)) is not None:
                begin(*following, 1)

        fill()
        while running:
            done, _ = wait(running, timeout=_POLL_S, return_when=FIRST_COMPLETED)
            with suppress(queue.Empty):
                while True:
                    progress(*steps.get_nowait())
            for future in done:
                index, job, attempts = running.pop(future)
                try:
                    outcome = JobOutcome(index, *future.result())
                except ProcessExpired as died:
                    if attempts < ATTEMPTS:
                        begin(index, job, attempts + 1)
                        continue
                    said = (
                        f"its process died {attempts} times (exit status {died.exitcode}), perhaps for want of memory"
                    )
                    outcome = JobOutcome(index, error=WorkerError(f"{said}: fewer workers leave more to each"))
                fill()
                yield outcome


@contextmanager
def _pool(workers: int, steps: Any) -> Iterator[ProcessPool]:
    """Processes with one thread each for linear algebra, unless the user said otherwise; stops them at the end without
    waiting, as their jobs are done or no longer wanted."""
    added = [name for name in _ONE_THREAD if name not in os.environ]
    os.environ.update(dict.fromkeys(added, "1"))
    pool = ProcessPool(workers, initializer=_begin, initargs=(steps,), context=_CONTEXT)
    try:
        yield pool
    finally:
        pool.stop()
        pool.join()
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

    return attempt(work, job, report)
