"""BuildRequest a library: look through the sources, do the jobs that are not done, write the index."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import closing
from dataclasses import asdict, dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from random import Random
from typing import TYPE_CHECKING, Any, Final

from fastmimic.base.errors import ConfigError, LibraryError, OutputError, WorkerError
from fastmimic.dataset.build_settings import BuildSettings
from fastmimic.dataset.excerpts import Survey, look_of, remove_survey, save_survey, survey
from fastmimic.dataset.finished_jobs import FinishedJobs
from fastmimic.dataset.folder import DamagedError, MotionDataset, Row
from fastmimic.dataset.index import Gathered, require_pyarrow
from fastmimic.dataset.jobs import Job, give_up, now, perform, robot_digest
from fastmimic.dataset.lock import building as locked
from fastmimic.dataset.records import FAILED, Record, load_record, save_record
from fastmimic.dataset.sources import DatasetSource
from fastmimic.dataset.warm_start import Neighbours
from fastmimic.executors import Executor, Report
from fastmimic.robot import Robot, load_robot

if TYPE_CHECKING:
    import pyarrow

CONFIDENCE: Final = 0.5
INDEX_EVERY: Final = 200
INDEX_SHARE: Final = 0.1
"""The index is written anew while a build goes on after so many records, and so large a share of all that are there:
it is made of all records, and would take most of the time of a large library otherwise."""


@dataclass(frozen=True, eq=False)
class BuildRequest:
    """What to build.

    Attributes:
        sources: of the motions.
        recipe: how they are made.
        robots: built-in names, or paths of MJCFs.
        seeds: searches for each piece and robot, with CMA-ES seeds 0 to seeds − 1.
        confidence: from which a cycle found in a take counts.
        discrete: whether movement in takes that does not repeat is imitated, too.
        warm: a library whose results searches begin from; None to begin from the unmodulated motion.
        folders: that the sources were found in, by their whole paths: what was found in files that are not there any
            more is forgotten.
    """

    sources: Sequence[DatasetSource]
    recipe: BuildSettings
    robots: Sequence[str]
    seeds: int = 1
    confidence: float = CONFIDENCE
    discrete: bool = False
    warm: MotionDataset | None = None
    folders: Sequence[Path] = ()

    def __post_init__(self) -> None:
        if not self.robots:
            raise ConfigError("a library needs at least one robot")
        if self.seeds < 1:
            raise ConfigError(f"seeds must be at least 1, found {self.seeds}")
        if not 0.0 <= self.confidence <= 1.0:
            raise ConfigError(f"the confidence is within 0 and 1, found {self.confidence}")


@dataclass(frozen=True)
class BuildStep:
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
        table: its index, as Arrow has it.
        surveys: of the sources that were asked for.
        ids: of the records of the jobs that they make.
        done: how many of them were done now; the others were there.
        left_out: robot motions that are none of the robots', a line each.
    """

    library: MotionDataset
    table: "pyarrow.Table"
    surveys: list[Survey]
    ids: frozenset[str]
    done: int
    left_out: list[str]

    @property
    def jobs(self) -> int:
        """How many jobs the sources make."""
        return len(self.ids)

    @cached_property
    def rows(self) -> list[Row]:
        """Those of the index, with what other builds have made."""
        rows: list[Row] = self.table.to_pylist()
        return rows

    @cached_property
    def failures(self) -> list[str]:
        """What of this build could not be done, a line each: source or motion, and why."""
        found = [survey.problem for survey in self.surveys if survey.failed is not None and survey.problem is not None]
        rows = self.table.select(["id", "status", "name", "robot", "seed", "reason"]).to_pylist()
        return found + [describe_failure(row) for row in rows if row["id"] in self.ids and row["status"] == FAILED]


def build_dataset(
    building: BuildRequest,
    out: str | Path,
    executor: Executor,
    *,
    update: bool = False,
    progress: Callable[[BuildStep], None] | None = None,
) -> Built:
    """Builds a library, or does what is missing in one.

    Args:
        building: what.
        out: its folder; with a cluster, one that all machines see under the same path, as the sources.
        executor: where.
        update: whether a library of another recipe may be made anew; its motions stay in the folder until removed. All
            sources are looked through again, too.
        progress: called with every step.

    Raises:
        LibraryError: the folder holds a library of another recipe, or one that is being mended, or Arrow is not
            installed.
        ConfigError: there is no such robot.
        OutputError: the folder cannot be written to, such as a full disk. What is finished is kept.
        KeyboardInterrupt: Ctrl-C; likewise.
    """
    require_pyarrow()
    began = now()
    library = MotionDataset(Path(out).resolve())
    robots = {name: load_robot(name) for name in dict.fromkeys(building.robots)}
    neighbours = None if building.warm is None else Neighbours.of(building.warm)
    with locked(library.path):
        return _build(building, library, robots, neighbours, executor, update, began, progress)


def _build(
    building: BuildRequest,
    library: MotionDataset,
    robots: Mapping[str, Robot],
    neighbours: Neighbours | None,
    executor: Executor,
    update: bool,
    began: str,
    progress: Callable[[BuildStep], None] | None,
) -> Built:
    _begin(library, building.recipe, update)
    digests = {name: robot_digest(robot) for name, robot in robots.items()}
    for name, digest in digests.items():
        library.save_robot(_place(name), digest)
    tell = progress if progress is not None else lambda step: None
    surveys = _look(building, library, executor, tell, again=update)
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
    seen = FinishedJobs(library.path)
    try:
        done = _make(jobs, library, seen, executor, tell)
    except BaseException:
        library.write_index(settled=False)
        seen.save()
        raise
    ids = frozenset(job.id for job in jobs)
    table = _settle(library, ids).table
    seen.save()
    names = {robot.name for robot in robots.values()}
    others = [p for s in surveys for p in s.pieces if p.robot is not None and p.robot not in names]
    left_out = [f"{piece.source}: already a motion of the {piece.robot}" for piece in others]
    return Built(library, table, surveys, ids, done, left_out)


def describe_failure(record: Mapping[str, Any]) -> str:
    """Of which motion, and why."""
    return f"{record['name']} on {record['robot']} seed {record['seed']}: {record['reason']}"


def _settle(library: MotionDataset, ids: frozenset[str]) -> Gathered:
    """Writes the index of a build that ends. Records of its own that others, which began otherwise, have come after
    become the last ones."""
    found = library.write_index()
    earlier = [old.id for old in found.superseded if old.id in ids and old.instead is not None]
    for record in filter(None, (load_record(library.path, identity) for identity in earlier)):
        save_record(library.path, record | {"finished": now()})
    return library.write_index() if earlier else found


def _begin(library: MotionDataset, recipe: BuildSettings, update: bool) -> None:
    there, was = None, {}
    try:
        there = library.recipe_digest()
        was = library.settings()
    except DamagedError:
        if not (update or library.holds(recipe.digest)):
            raise
    except LibraryError:
        if not update:
            raise
    if there is not None and there != recipe.digest and not update:
        said = ", ".join(f"{name} was {was[name]}" for name, value in asdict(recipe).items() if was[name] != value)
        raise LibraryError(
            f"{library.path}: holds a library made otherwise ({said or 'another controller'}); --update makes it anew,"
            " or choose another --out"
        )
    if there != recipe.digest:
        library.save_recipe(recipe)


def _place(robot: str) -> str:
    """A robot as any process finds it: files by their whole path."""
    path = Path(robot)
    return str(path.resolve()) if path.is_file() else robot.lower()


def _look(
    building: BuildRequest,
    library: MotionDataset,
    executor: Executor,
    tell: Callable[[BuildStep], None],
    *,
    again: bool,
) -> list[Survey]:
    """Looks through the sources, but for those that are as they were; what is found is kept in the library, and
    returned in the order of the sources."""
    sources = list(building.sources)
    known = {survey.source: survey for survey in library.surveys()}
    found: dict[int, Survey] = {}
    for i, source in enumerate(sources):
        old = None if again else known.get(source)
        if old is None or old.looked is None:
            continue
        if old.looked == look_of(source, building.confidence, building.discrete):
            found[i] = old
    missing = [i for i in range(len(sources)) if i not in found]
    tell(BuildStep("looking", len(found), len(sources), len(found) / len(sources) if sources else 1.0))
    looking = partial(_survey, confidence=building.confidence, discrete=building.discrete)
    with closing(executor.run(looking, [sources[i] for i in missing])) as outcomes:
        for outcome in outcomes:
            if isinstance(outcome.error, OutputError):
                raise outcome.error
            at = missing[outcome.index]
            found[at] = outcome.result or Survey(sources[at], failed=str(outcome.error))
            save_survey(library.path, found[at])
            tell(BuildStep("looking", len(found), len(sources), len(found) / len(sources), survey=found[at]))
    _forget(library, building, known.values())
    return [found[i] for i in range(len(sources))]


def _forget(library: MotionDataset, building: BuildRequest, known: Iterable[Survey]) -> None:
    """Forgets what was found in the same parts of the same files when they were read otherwise: at another rate, with
    another licence. Of the folders that are built of, also what is not there any more, and what could not be read and
    is not asked for any more."""
    sources = building.sources
    keys, parts = {source.key for source in sources}, {(source.place, source.frames) for source in sources}
    for old in known:
        if old.source.key in keys:
            continue
        place = Path(old.source.place)
        within = any(place.is_relative_to(folder) for folder in building.folders)
        if (old.source.place, old.source.frames) in parts or (within and (old.failed or not place.exists())):
            remove_survey(library.path, old)


def _survey(source: DatasetSource, report: Report, *, confidence: float, discrete: bool) -> Survey:
    return survey(source, confidence, discrete)


def _make(
    jobs: Sequence[Job],
    library: MotionDataset,
    seen: FinishedJobs,
    executor: Executor,
    tell: Callable[[BuildStep], None],
) -> int:
    """Does the jobs whose record is not there; how many."""
    missing = [job for job in jobs if not seen.finished(job.id, job.motion_file)]
    # builders that share a folder begin at different ends, and each leaves out what another has done meanwhile
    Random().shuffle(missing)
    total, done = len(jobs), len(jobs) - len(missing)
    begun: dict[int, float] = {}  # the share that is done of each that runs
    over: set[int] = set()
    tell(BuildStep("making", done, total, done / total if total else 1.0))

    def progress(index: int, share: float) -> None:
        if index not in over:  # it may have been told late
            begun[index] = share
        tell(BuildStep("making", done, total, (done + sum(begun.values())) / total))

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
            over.add(outcome.index)
            begun.pop(outcome.index, None)
            if record["status"] != FAILED:
                seen.add(job.id, job.motion_file)
            tell(BuildStep("making", done, total, (done + sum(begun.values())) / total, record=record))
            if since >= every:
                found = library.write_index(settled=False)
                seen.save()
                every, since = max(INDEX_EVERY, round(INDEX_SHARE * found.table.num_rows)), 0
    return len(missing)
