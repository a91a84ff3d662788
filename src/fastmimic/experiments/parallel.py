"""Runs on all cores: one single-threaded process per run.

With more runs than cores this is faster than the threads of `imitate`, which wait for the slowest of them in every
iteration, share one interpreter, and run fitting, logged episodes and CMA-ES on one thread. Runs share nothing, so the
rows do not depend on the number of processes. `benchmarks/comparison.py --scaling` measures both ways.
"""

import time
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass, field

from fastmimic.executors.local import LocalExecutor
from fastmimic.experiments.comparison_run import Row, RunTask, perform
from fastmimic.imitation.methods import method_named


@dataclass
class RunProgress:
    """Progress, and the remaining time by the pace of each method so far."""

    tasks: Sequence[RunTask]
    workers: int
    finished: int = 0
    _began: dict[int, float] = field(default_factory=dict)
    _first: dict[int, tuple[float, int]] = field(default_factory=dict)
    _done_s: dict[int, float] = field(default_factory=dict)
    _pace: dict[int, tuple[float, float]] = field(default_factory=dict)  # seconds, and simulated seconds

    def begin(self, index: int) -> None:
        self._began[index] = time.perf_counter()

    def advance(self, index: int, iteration: int) -> None:
        """Records an iteration of a run's search; the first one starts its clock, after the preparations."""
        now, task = time.perf_counter(), self.tasks[index]
        at, first = self._first.setdefault(index, (now, iteration))
        self._done_s[index] = task.searched_s(iteration)
        if iteration > first:
            self._pace[index] = (now - at, task.searched_s(iteration - first))

    def finish(self, index: int) -> None:
        now, task = time.perf_counter(), self.tasks[index]
        self._done_s[index] = task.simulated_s
        if index not in self._pace:
            self._pace[index] = (now - self._began.get(index, now), task.simulated_s)
        self.finished += 1

    @property
    def share(self) -> float:
        """Finished share of the simulated time, in [0, 1]."""
        total = sum(task.simulated_s for task in self.tasks)
        return min(1.0, sum(self._done_s.values()) / total) if total > 0 else 1.0

    @property
    def remaining_s(self) -> float | None:
        """None before the pace of a search is known, if there is one to do."""
        pace: dict[str, float] = {}
        for method in {task.run.method for task in self.tasks}:
            seen = [self._pace[i] for i, task in enumerate(self.tasks) if task.run.method == method and i in self._pace]
            if seen:
                pace[method] = sum(took for took, _ in seen) / max(1e-9, sum(simulated for _, simulated in seen))
        long = {task.run.method for task in self.tasks if method_named(task.run.method).optimises}
        known = [pace[method] for method in long or pace if method in pace]
        if not known:
            return None
        left = sum(
            (task.simulated_s - self._done_s.get(i, 0.0)) * pace.get(task.run.method, max(known))
            for i, task in enumerate(self.tasks)
        )
        return max(0.0, left) / self.workers


ReportProgress = Callable[[RunProgress, Row | None], None]
"""Called after each iteration of a run, and with the row of each finished run."""


def run_all(tasks: Sequence[RunTask], workers: int, report: ReportProgress) -> list[Row]:
    """Performs all tasks; returns the rows in their order. One worker runs them in this process. Raises
    `FastMimicError` as the first failed run, and stops the others. Results and checkpoints survive that and Ctrl-C."""
    executor = LocalExecutor(max(1, min(workers, len(tasks))))
    effort = RunProgress(tasks, executor.workers)
    rows: list[Row | None] = [None] * len(tasks)

    def progress(index: int, share: float) -> None:
        if share > 0.0:
            effort.advance(index, round(share * tasks[index].settings.iterations))
            report(effort, None)
        else:
            effort.begin(index)

    outcomes = executor.run(perform, tasks, progress)
    with closing(outcomes):
        for outcome in outcomes:
            if outcome.error is not None:
                raise outcome.error
            rows[outcome.index] = outcome.result
            effort.finish(outcome.index)
            report(effort, outcome.result)
    return [row for row in rows if row is not None]
