"""The cores of this machine: one process for each, one thread in each.

Each process has a pipe of its own, so it is known whose job is lost when one dies, however early. The pools of
`multiprocessing`, `concurrent.futures` and Pebble break as a whole, or lose the job, if one dies as it begins.
"""

import multiprocessing
import os
import signal
import traceback
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from functools import partial
from itertools import islice
from multiprocessing.connection import wait
from typing import Any, Final

from fastmimic.base.errors import WorkerError
from fastmimic.base.machine import available_cores
from fastmimic.executors import ATTEMPTS, JobOutcome, Outcomes, Told, Work, attempt, check_workers

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

    def run(self, work: Work, jobs: Iterable[Any], progress: Told | None = None) -> Outcomes:
        tell = progress if progress is not None else lambda index, share: None
        if self.workers > 1 or not self._in_process:
            with _one_thread_each():
                yield from _spread(work, jobs, self.workers, tell)
            return
        for index, job in enumerate(jobs):
            yield JobOutcome(index, *attempt(work, job, partial(tell, index)))


class _Worker:
    """A process that does one job after the other. If it dies, another begins the job again."""

    def __init__(self, work: Work) -> None:
        self._work = work
        self._start()

    def _start(self) -> None:
        self.pipe, theirs = _CONTEXT.Pipe()
        self._process = _CONTEXT.Process(target=_serve, args=(theirs, self._work), daemon=True)
        self._process.start()
        theirs.close()  # so that the pipe ends when the process does

    def begin(self, index: int, job: Any, attempts: int = 1) -> None:
        self.index, self._job, self._attempts = index, job, attempts
        with suppress(BrokenPipeError):  # a process that died after its last job: `hear` finds the pipe's end
            self.pipe.send(job)

    def hear(self) -> float | JobOutcome | None:
        """Waits for what its process says: the job's finished share or its outcome, None if it is begun once more.
        Raises what a defect raised."""
        try:
            said = self.pipe.recv()
        except (EOFError, OSError):
            status = self.end()
            self._start()
            if self._attempts < ATTEMPTS:
                self.begin(self.index, self._job, self._attempts + 1)
                return None
            why = "perhaps for want of memory: fewer workers leave more to each"
            if status == 1:  # it could not start: it imports the script that started it
                why = "a script must call this under if __name__ == '__main__':"
            died = f"its process died {self._attempts} times (exit status {status}); {why}"
            return JobOutcome(self.index, error=WorkerError(died))
        if isinstance(said, Exception):
            raise said
        return JobOutcome(self.index, *said) if isinstance(said, tuple) else said

    def end(self) -> int | None:
        """Kills its process, if it still lives; returns the exit status."""
        self._process.kill()
        self._process.join()
        self.pipe.close()
        return self._process.exitcode


def _spread(work: Work, jobs: Iterable[Any], workers: int, progress: Told) -> Outcomes:
    waiting = enumerate(jobs)
    busy: list[_Worker] = []
    try:
        for first in islice(waiting, workers):
            busy.append(_Worker(work))
            busy[-1].begin(*first)
        while busy:
            ready = wait([worker.pipe for worker in busy])
            for worker in [worker for worker in busy if worker.pipe in ready]:
                said = worker.hear()
                if isinstance(said, float):
                    progress(worker.index, said)
                elif said is not None:
                    if (following := next(waiting, None)) is not None:
                        worker.begin(*following)
                    else:
                        busy.remove(worker)
                        worker.end()
                    yield said
    finally:
        for worker in busy:
            worker.end()


@contextmanager
def _one_thread_each() -> Iterator[None]:
    """Processes begun meanwhile have one thread for linear algebra, unless the user said otherwise."""
    added = [name for name in _ONE_THREAD if name not in os.environ]
    os.environ.update(dict.fromkeys(added, "1"))
    try:
        yield
    finally:
        for name in added:
            os.environ.pop(name, None)


def _serve(pipe: Any, work: Work) -> None:
    """What a process of a worker does, until the pipe ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the parent's to handle
    try:
        while True:
            job = pipe.recv()
            try:
                pipe.send(attempt(work, job, lambda share: pipe.send(float(share))))
            except Exception as defect:  # noqa: BLE001  the parent raises it
                defect.add_note(traceback.format_exc())  # where it was raised, which does not travel with it
                pipe.send(defect)
    except (EOFError, OSError):
        pass  # the parent was killed, and nobody will ask for the result
