"""Building a library: look through the sources, do the jobs that are not done, write the index."""

from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from random import Random
from typing import Final

from fastmimic.errors import ConfigError, LibraryError, OutputError, WorkerError
from fastmimic.executors import Executor, Report
from fastmimic.files import check_folder
from fastmimic.library.folder import Library, Row, require_pyarrow
from fastmimic.library.jobs import Job, give_up, now, perform, robot_digest
from fastmimic.library.pieces import Survey, remove_survey, save_survey, survey
from fastmimic.library.recipe import Recipe
from fastmimic.library.records import FAILED, Record, load_record
from fastmimic.library.sources import Source
from fastmimic.library.warm_start import Neighbours
from fastmimic.robot import load_robot

CONFIDENCE: Final = 0.5
INDEX_EVERY: Final = 200
INDEX_SHARE: Final = 0.1
"""The index is written anew while a build goes on after so many records, and so large a share of all that are there:
it is made of all records, and would take most of the time of a large library otherwise."""


@dataclass(frozen=True, eq=False)
class Building:
    """What to build.

    Attributes:
        sources: of the motions.
        recipe: how they are made.
        robots: built-in names, or paths of MJCFs.
        seeds: searches for each piece and robot, with CMA-ES seeds 0 to seeds − 1.
        confidence: from which a cycle found in a take counts.
        discrete: whether movement in takes that does not repeat is imitated, too.
        warm: a library whose results searches begin from; None to begin from the unmodulated motion.
    """

    sources: Sequence[Source]
    recipe: Recipe
    robots: Sequence[str]
    seeds: int = 1
    confidence: float = CONFIDENCE
    discrete: bool = False
    warm: Library | None = None

    def __post_init__(self) -> None:
        if not self.robots:
            raise ConfigError("a library needs at least one robot")
        if self.seeds < 1:
            raise ConfigError(f"seeds must be at least 1, found {self.seeds}")
        if not 0.0 <= self.confidence <= 1.0:
            raise ConfigError(f"the confidence is within 0 and 1, found {self.confidence}")


@dataclass(frozen=True)
class Step:
    """How far a build is.

    Attributes:
        what: 'looking' through sources, or 'making' motions.
        done, total: how many of them.
        share: of all work of that kind, in [0, 1].
        record: the one that was just finished, if one was.
        survey: likewise.
    """

    what: str
    done: int
    total: int
    share: float
    record: Record | None = None
    survey: Survey | None = None


@dataclass(frozen=True)
class Built:
    """What came of a build.

    Attributes:
        library: the library.
        rows: of its index.
        surveys: of the sources that were asked for.
        ids: of the records of the jobs that they make.
        done: how many of them were done now; the others were there.
        left_out: robot motions that are none of the robots', a line each.
    """

    library: Library
    rows: list[Row]
    surveys: list[Survey]
    ids: frozenset[str]
    done: int
    left_out: list[str]

    @property
    def jobs(self) -> int:
        """How many jobs the sources make."""
        return len(self.ids)

    @property
    def failures(self) -> list[str]:
        """What of this build could not be done, a line each: source or motion, and why."""
        found = [survey.problem for survey in self.surveys if survey.failed is not None and survey.problem is not None]
        rows = [row for row in self.rows if row["id"] in self.ids and row["status"] == FAILED]
        return found + [f"{row['name']} on {row['robot']} seed {row['seed']}: {row['reason']}" for row in rows]


def build(
    building: Building,
    out: str | Path,
    executor: Executor,
    *,
    update: bool = False,
    progress: Callable[[Step], None] | None = None,
) -> Built:
    """Builds a library, or does what is missing in one.

    Args:
        building: what.
        out: its folder; with a cluster, one that all machines see under the same path, as the sources.
        executor: where.
        update: whether a library of another recipe may be made anew; its motions stay in the folder until removed.
        progress: called with every step.

    Raises:
        LibraryError: the folder holds a library of another recipe, or Arrow is not installed.
        ConfigError: there is no such robot.
        OutputError: the folder cannot be written to, such as a full disk. What is finished is kept.
        KeyboardInterrupt: Ctrl-C; likewise.
    """
    require_pyarrow()
    began = now()
    library = Library(Path(out).resolve())
    robots = {name: load_robot(name) for name in dict.fromkeys(building.robots)}
    neighbours = None if building.warm is None else Neighbours.of(building.warm)
    _begin(library, building.recipe, update)
    digests = {name: robot_digest(robot) for name, robot in robots.items()}
    for name, digest in digests.items():
        library.save_robot(_place(name), digest)
    tell = progress if progress is not None else lambda step: None
    surveys = _look(building, library, executor, tell)
    jobs = [
        Job(piece, _place(name), digests[name], seed, building.recipe, library.path, began=began)
        for survey in surveys
        for piece in survey.pieces
        for name, robot in robots.items()
        if piece.robot in (None, robot.name)
        for seed in range(building.seeds)
    ]
    if neighbours is not None:
        jobs = [replace(job, warm=neighbours.nearest(job.piece, job.robot)) for job in jobs]
    jobs = list({job.id: job for job in jobs}.values())
    try:
        done = _make(jobs, library, executor, tell)
    except BaseException:
        library.write_index(settled=False)
        raise
    rows = library.write_index()
    names = {robot.name for robot in robots.values()}
    others = [p for s in surveys for p in s.pieces if p.robot is not None and p.robot not in names]
    left_out = [f"{piece.source}: already a motion of the {piece.robot}" for piece in others]
    return Built(library, rows, surveys, frozenset(job.id for job in jobs), done, left_out)


def _begin(library: Library, recipe: Recipe, update: bool) -> None:
    try:
        there = library.recipe_digest()
        was = library.settings()
    except LibraryError:
        if not update:
            raise
        there, was = None, {}
    if there is not None and there != recipe.digest and not update:
        said = ", ".join(f"{name} was {was[name]}" for name, value in asdict(recipe).items() if was[name] != value)
        raise LibraryError(
            f"{library.path}: holds a library made otherwise ({said or 'another controller'}); --update makes it anew,"
            " or choose another --out"
        )
    check_folder(library.path)
    if there != recipe.digest:
        library.save_recipe(recipe)


def _place(robot: str) -> str:
    """A robot as any process finds it: files by their whole path."""
    path = Path(robot)
    return str(path.resolve()) if path.is_file() else robot.lower()


def _look(building: Building, library: Library, executor: Executor, tell: Callable[[Step], None]) -> list[Survey]:
    """Looks through all sources; what is found is kept in the library, and returned in the order of the sources."""
    sources = list(building.sources)
    found: dict[int, Survey] = {}
    tell(Step("looking", 0, len(sources), 0.0))
    looking = partial(_survey, confidence=building.confidence, discrete=building.discrete)
    with closing(executor.run(looking, sources)) as outcomes:
        for outcome in outcomes:
            if isinstance(outcome.error, OutputError):
                raise outcome.error
            source = sources[outcome.index]
            found[outcome.index] = outcome.result or Survey(source, failed=str(outcome.error))
            save_survey(library.path, found[outcome.index])
            share = len(found) / len(sources)
            tell(Step("looking", len(found), len(sources), share, survey=found[outcome.index]))
    _supersede(library, sources)
    return [found[i] for i in range(len(sources))]


def _supersede(library: Library, sources: Sequence[Source]) -> None:
    """Forgets what was found in the same parts of the same files when they were read otherwise: at another rate, with
    another licence."""
    keys, parts = {source.key for source in sources}, {(source.place, source.frames) for source in sources}
    for old in library.surveys():
        if (old.source.place, old.source.frames) in parts and old.source.key not in keys:
            remove_survey(library.path, old)


def _survey(source: Source, report: Report, *, confidence: float, discrete: bool) -> Survey:
    return survey(source, confidence, discrete)


def _make(jobs: Sequence[Job], library: Library, executor: Executor, tell: Callable[[Step], None]) -> int:
    """Does the jobs whose record is not there; how many."""
    missing = [job for job in jobs if not _finished(job)]
    # builders that share a folder begin at different ends, and each leaves out what another has done meanwhile
    Random().shuffle(missing)
    total, done = len(jobs), len(jobs) - len(missing)
    shares: dict[int, float] = {}
    tell(Step("making", done, total, done / total if total else 1.0))

    def progress(index: int, share: float) -> None:
        shares[index] = share
        tell(Step("making", done, total, (total - len(missing) + sum(shares.values())) / total))

    since, every = 0, INDEX_EVERY
    with closing(executor.run(perform, missing, progress)) as outcomes:
        for outcome in outcomes:
            job = missing[outcome.index]
            if isinstance(outcome.error, WorkerError):
                record: Record = give_up(job, outcome.error)
            elif outcome.error is not None:
                raise outcome.error
            else:
                record = outcome.result
            done, since = done + 1, since + 1
            shares[outcome.index] = 1.0
            share = (total - len(missing) + sum(shares.values())) / total
            tell(Step("making", done, total, share, record=record))
            if since >= every:
                every = max(INDEX_EVERY, round(INDEX_SHARE * len(library.write_index(settled=False))))
                since = 0
    return len(missing)


def _finished(job: Job) -> bool:
    record = load_record(job.folder, job.id)
    return record is not None and record["status"] != FAILED
