"""CMA-ES over a problem's parameters (Hansen 2006), with the author's library pycma, and its checkpoints.

CMA-ES is deterministic given its seed and the scores, so the history is its state: resuming replays the history without
running an episode and checks that the replayed candidates equal the recorded ones, bit for bit.
"""

import hashlib
import sys
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from fastmimic.base.arrays import Array
from fastmimic.base.configuration import check, parameter
from fastmimic.base.errors import CheckpointError, ConfigError
from fastmimic.base.files import UNREADABLE, open_arrays, replace_file
from fastmimic.base.progress import progress_bar, slow_start, tenths
from fastmimic.optimize.parameters import FinalChoice
from fastmimic.optimize.problem import Problem

MOST_ITERATIONS: Final = 200
_SETTLED: Final = (20, 5e-4)  # iterations whose best scores differ by less: nothing more is to be gained
_TRACKED: Final = (0.9, 0.25)  # score from which a motion counts as tracked, and the share of the step size for it
_VERSION: Final = 1


@dataclass(frozen=True, eq=False)
class Checkpoint:
    """The course of an optimisation so far: `candidates` (i, p, k), scaled to [0, 1] within their bounds, with their
    `scores` (i, p), greater is better. `identity` is a digest of the problem and the optimiser's settings."""

    identity: str
    candidates: Array
    scores: Array
    elapsed_s: float

    def save(self, path: str | Path) -> None:
        """Writes the checkpoint and replaces an earlier one; raises `OutputError` if it cannot."""
        about: dict[str, Any] = {"version": np.int64(_VERSION), "identity": np.str_(self.identity)}
        about |= {"candidates": self.candidates, "scores": self.scores, "elapsed_s": np.float64(self.elapsed_s)}
        replace_file(path, lambda file: np.savez(file, **about))

    @classmethod
    def load(cls, path: str | Path, identity: str | None = None) -> "Checkpoint":
        """Reads a checkpoint; raises `CheckpointError` if it is missing, damaged, or not of the problem `identity`."""
        try:
            with open_arrays(path) as file:
                version = int(file["version"])
                found = cls(str(file["identity"]), file["candidates"], file["scores"], float(file["elapsed_s"]))
        except FileNotFoundError:
            raise CheckpointError(f"{path}: no checkpoint to resume from; leave out --resume to start anew") from None
        except UNREADABLE as error:
            raise CheckpointError(f"{path}: damaged checkpoint ({error}); leave out --resume to start anew") from None
        if version != _VERSION:
            raise CheckpointError(f"{path}: checkpoint version {version}; this release reads version {_VERSION}")
        if identity not in (None, found.identity):
            said = "of another problem (motion, robot, configuration, duration, seed or population differ)"
            again = "resume with the same arguments or choose another output folder"
            raise CheckpointError(f"{path}: this checkpoint is {said}; {again}")
        if found.candidates.ndim != 3 or found.scores.shape != found.candidates.shape[:2]:
            raise CheckpointError(f"{path}: damaged checkpoint (shapes {found.candidates.shape}, {found.scores.shape})")
        return found


@dataclass(frozen=True)
class CmaSettings:
    """Settings of the optimiser. `iterations` are as many, or with None at the most 200: the search ends when its best
    scores have settled, as by the criterion TolFun of Hansen 2023, "The CMA evolution strategy: a tutorial", B.3. From
    a motion that the robot tracks as it is, the search begins at a quarter of `step_size`: what is better is near."""

    iterations: int | None = None
    population: int = parameter(10, low=4)
    seed: int = parameter(0)
    step_size: float = parameter(0.2, above=0.0, high=1.0)  # initial deviation, share of each parameter's range
    choice: FinalChoice = FinalChoice()
    checkpoint_every: int = 5  # iterations

    def __post_init__(self) -> None:
        if self.iterations is not None and self.iterations < 1:
            raise ConfigError(f"iterations must be at least 1, found {self.iterations}")
        check(self, "")


@dataclass(frozen=True, eq=False)
class History:
    """The course of an optimisation: `best`, `mean` and `std` (i,) of the scores in each iteration."""

    best: Array
    mean: Array
    std: Array
    sigma: Array  # (i,) overall step size, share of the parameters' ranges
    baseline: float  # score of the unmodulated motion
    start: float  # the best among the given candidates, the unmodulated motion and the start of the search


@dataclass(frozen=True, eq=False)
class Optimum:
    """Result of an optimisation; numbers of episodes and times include those before a resume."""

    x: Array  # (k,) the parameters, physical units
    score: float  # objective in the optimisation's episode
    validation: float  # mean over the validation episodes; NaN if interrupted before
    history: History
    evaluations: int  # episodes run
    simulated_s: float  # their total length
    elapsed_s: float
    interrupted: bool


@dataclass(frozen=True)
class Progress:
    """Argument of the callback after each iteration."""

    iteration: int
    iterations: int  # in all, at the most
    best: float
    evaluations_per_s: float
    remaining_s: float


@contextmanager
def optimisation_progress() -> Iterator[Callable[[Progress], None]]:
    """Progress of an optimisation: a bar on a terminal, otherwise a line for each tenth."""
    with slow_start() as started, progress_bar("optimising") as show:
        due = tenths()

        def progress(step: Progress) -> None:
            started()
            left = f"{step.remaining_s // 60:.0f}:{step.remaining_s % 60:02.0f}"
            figures = f"best {step.best:.3f}  {step.evaluations_per_s:.0f} evaluations/s  {left} left"
            done, total = step.iteration, step.iterations
            line = f"iteration {done}/{total}  {figures}" if due(done, total) else ""
            show(line, completed=done, total=total, info=figures)
            if done == total:
                show("validating the best candidates in longer episodes", description="validating")

        yield progress


def optimize(
    problem: Problem,
    settings: CmaSettings,
    *,
    checkpoint: str | Path | None = None,
    resume: bool = False,
    progress: Callable[[Progress], None] | None = None,
) -> Optimum:
    """Maximises the problem's objective. Longer episodes from perturbed starts choose the result among the best
    candidates of all iterations and the unmodulated motion, so that one lucky episode does not decide; what is better
    by chance alone is not taken. Ctrl-C ends the search early and keeps its results so far.

    The file `checkpoint` takes the course every few iterations; with `resume` the search goes on from it, and the
    result is bit for bit that of an uninterrupted run.

    Raises `CheckpointError` if the checkpoint to resume from is missing, damaged, or of another problem, `ConfigError`
    if an episode is too short for its disturbances, and `OutputError` if the checkpoint cannot be written.
    """
    return _Search(problem, settings, Path(checkpoint) if checkpoint is not None else None).run(resume, progress)


def _is_better(gains: Array) -> bool:
    """Whether gains (n,) from the same starts are more than chance: their mean above two standard errors."""
    error = gains.std(ddof=1) / np.sqrt(len(gains)) if len(gains) > 1 else 0.0
    return bool(gains.mean() > 2 * error)


class _Search:
    def __init__(self, problem: Problem, settings: CmaSettings, checkpoint: Path | None) -> None:
        self.problem, self.settings, self.checkpoint = problem, settings, checkpoint
        self.lower, upper = problem.bounds
        self.span = upper - self.lower
        self.strategy: Any = None
        start, initial = self.problem.start, self.problem.initial
        self.given = initial[None] if np.array_equal(start, initial) else np.stack([initial, start])
        self.candidates: list[Array] = []
        self.scores: list[Array] = []
        self.sigma: list[float] = []
        self.choice, self.limit = settings.choice, settings.iterations or MOST_ITERATIONS
        self.validated = self.validation_steps = self.recorded = 0
        own = {name: getattr(settings, name) for name in ("population", "seed", "step_size")}
        self.identity = hashlib.sha256(f"{problem.identity}{own}".encode()).hexdigest()

    def run(self, resume: bool, progress: Callable[[Progress], None] | None) -> Optimum:
        saved = self._saved() if resume else None
        began = time.perf_counter()
        given = self.problem.evaluate(self.given)
        first = (self.problem.start - self.lower) / self.span
        tracked, share = _TRACKED
        step_size = self.settings.step_size * (share if given.max() >= tracked else 1.0)
        self.strategy = _make_strategy(first, step_size, self.settings)
        before = self._replay(saved) if saved is not None else 0.0
        done_before = len(self.scores)
        interrupted = False
        try:
            while len(self.scores) < self.limit and not self._settled():
                u = np.array(self.strategy.ask())
                self._tell(u, self.problem.evaluate(self.lower + self.span * u))
                elapsed = time.perf_counter() - began
                done = len(self.scores)
                if done % self.settings.checkpoint_every == 0:
                    self._save(before + elapsed)
                if progress is not None:
                    each = elapsed / (done - done_before)
                    best = max(float(given.max()), *(float(s.max()) for s in self.scores))
                    last = done if self._settled() else self.limit
                    remaining = each * (last - done)
                    progress(Progress(done, last, best, self.settings.population / each, remaining))
        except KeyboardInterrupt:
            interrupted = True
            whole = len(self.sigma)  # an interrupt may come while an iteration is being recorded
            del self.candidates[whole:], self.scores[whole:]
        self._save(before + time.perf_counter() - began)
        x, score, validation, hurried = self._choose(given)
        elapsed = before + time.perf_counter() - began
        self._save(elapsed)
        scores = np.array(self.scores).reshape(-1, self.settings.population)
        course = scores.max(axis=1), scores.mean(axis=1), scores.std(axis=1), np.array(self.sigma)
        searched, validated = len(given) + scores.size, self.validated * self.choice.episodes
        steps = searched * self.problem.steps + validated * self.validation_steps
        return Optimum(
            x=x,
            score=score,
            validation=validation,
            history=History(*course, baseline=float(given[0]), start=float(given.max())),
            evaluations=searched + validated,
            simulated_s=steps / self.problem.config.rate_hz,
            elapsed_s=elapsed,
            interrupted=interrupted or hurried,
        )

    def _settled(self) -> bool:
        """Whether the search ends by itself."""
        count, least = _SETTLED
        best = [float(scores.max()) for scores in self.scores[-count:]]
        return self.settings.iterations is None and len(best) == count and max(best) - min(best) < least

    def _tell(self, u: Array, scores: Array) -> None:
        self.strategy.tell(list(u), list(-scores))
        self.candidates.append(u)
        self.scores.append(scores)
        self.sigma.append(float(self.strategy.sigma))

    def _saved(self) -> Checkpoint:
        if self.checkpoint is None:
            raise CheckpointError("nothing to resume from: the checkpoint's file was not given")
        return Checkpoint.load(self.checkpoint, self.identity)

    def _replay(self, saved: Checkpoint) -> float:
        self.recorded = len(saved.scores)
        for u, scores in zip(saved.candidates, saved.scores, strict=True):
            if len(self.scores) == self.limit:
                break
            if not np.array_equal(np.array(self.strategy.ask()), u):
                said = "this installation of CMA-ES does not reproduce the recorded candidates"
                again = "resume with the versions that wrote it or leave out --resume to start anew"
                raise CheckpointError(f"{self.checkpoint}: {said}; {again}")
            self._tell(u, scores)
        return saved.elapsed_s

    def _save(self, elapsed: float) -> None:
        """Saves the course, if there is a file; never replaces a course as long: a search that is only read stays."""
        if self.checkpoint is None or len(self.scores) <= self.recorded:
            return
        Checkpoint(self.identity, np.array(self.candidates), np.array(self.scores), elapsed).save(self.checkpoint)

    def _choose(self, given: Array) -> tuple[Array, float, float, bool]:
        """The candidate with the best validation, unless the unmodulated motion's is as good but for chance: x, score,
        validation, and whether Ctrl-C cut the validation short."""
        best, own = self._best(float(given[0]))
        x, scores = np.concatenate([self.given, best]), np.concatenate([given, own])
        rng = np.random.default_rng([self.settings.seed, 1])
        start, steps = self.problem.validation(self.choice.episodes, self.choice.duration_s, rng)
        self.validation_steps = steps
        tables = self.problem.tables(x)
        each, hurried = np.full((len(x), start.n), np.nan), False
        try:
            for i, table in enumerate(tables):
                each[i] = self.problem.scores(np.repeat(table[None], start.n, axis=0), start, steps)
        except KeyboardInterrupt:
            hurried = True
        validation = each.mean(axis=1)
        self.validated = int(np.isfinite(validation).sum())
        chosen = int(np.nanargmax(validation)) if self.validated else int(np.argmax(scores))
        if self.validated and not _is_better(each[chosen] - each[0]):
            chosen = 0
        return x[chosen], float(scores[chosen]), float(validation[chosen]), hurried

    def _best(self, baseline: float) -> tuple[Array, Array]:
        """The best candidates of all iterations that score at least the baseline, and their scores."""
        flat, u = np.array(self.scores).ravel(), np.array(self.candidates).reshape(-1, len(self.lower))
        best = np.argsort(-flat, kind="stable")[: self.choice.candidates]
        best = best[flat[best] >= baseline]
        return self.lower + self.span * u[best], flat[best]


def _pycma() -> Any:
    """pycma without the statistics and plots that it loads where it can: half a second of every process's start."""
    spared = [name for name in ("scipy.stats", "matplotlib") if name not in sys.modules]
    sys.modules.update(dict.fromkeys(spared))  # type: ignore[arg-type]
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # pycma warns about optional packages at import
            import cma
    finally:
        for name in spared:
            del sys.modules[name]
    return cma


def _make_strategy(start: Array, step_size: float, settings: CmaSettings) -> Any:
    rng = np.random.default_rng([settings.seed, 0])
    options = {
        "bounds": [0.0, 1.0],
        "popsize": settings.population,
        "seed": np.nan,  # leaves NumPy's global generator alone; the draws come from `randn`
        "randn": lambda *shape: rng.standard_normal(shape),
        "verbose": -9,
        "maxiter": np.inf,
        "tolfun": 0.0,
        "tolx": 0.0,
        "tolflatfitness": np.inf,
        "tolstagnation": np.inf,
    }
    return _pycma().CMAEvolutionStrategy(start, step_size, options)
