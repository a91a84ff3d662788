"""Builds a library: surveys the sources, runs the remaining jobs, writes the index."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
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
"""A running build writes the index after `INDEX_EVERY` new records, if these are so large a share of all; writing the
index reads every record."""


@dataclass(frozen=True, eq=False)
class BuildRequest:
    """What to build.

    Attributes:
        robots: built-in names, or paths of MJCFs.
        seeds: searches for each excerpt and robot, with CMA-ES seeds 0 to seeds − 1.
        confidence: least confidence of a cycle found in a take.
        discrete: whether to imitate movement in takes that does not repeat, too.
        warm: a library with the motions that searches begin from; None to begin from the unmodulated motion.
        folders: absolute paths of the sources' folders; excerpts of files no longer in them are forgotten.
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
    """Progress of a build.

    Attributes:
        what: 'looking' through sources, or 'making' motions.
        share: of all work of that kind, in [0, 1].
        record, survey: the one that was just finished, if any.
    """

    what: str
    done: int
    total: int
    share: float
    record: Record | None = None
    survey: Survey | None = None


@dataclass(frozen=True)
class Built:
    """Result of a build.

    Attributes:
        table: the library's index, an Arrow table.
        ids: of the records of the requested sources' jobs.
        done: number of jobs done now; the others were finished before.
        left_out: robot motions for none of the robots, one line each.
    """

    library: MotionDataset
    table: "pyarrow.Table"
    surveys: list[Survey]
    ids: frozenset[str]
    done: int
    left_out: list[str]

    @property
    def jobs(self) -> int:
        """Number of jobs from the sources."""
        return len(self.ids)

    @cached_property
    def rows(self) -> list[Row]:
        """Rows of the index, including results of other builds."""
        rows: list[Row] = self.table.to_pylist()
        return rows

    @cached_property
    def failures(self) -> list[str]:
        """Failures of this build, one line each: source or motion, and the reason."""
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
    """Builds a library, or completes an existing one.

    Args:
        out: its folder; a cluster needs it, and the sources, under the same path on all machines.
        update: whether to allow another recipe than the library's, and survey all sources again. Motions of the earlier
            recipe stay in the folder until removed.

    Raises `LibraryError` for another recipe, during a repair or without Arrow, `ConfigError` for an unknown robot, and
    `OutputError` if the folder cannot be written to. Finished records survive that and Ctrl-C.
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
    """The motion and the reason of the failure."""
    return f"{record['name']} on {record['robot']} seed {record['seed']}: {record['reason']}"


def _settle(library: MotionDataset, ids: frozenset[str]) -> Gathered:
    """Writes the final index; makes the build's own records the latest among those that differ only in their start."""
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
        said = ", ".join(
            f"{name} was {was.get(name)}" for name, value in recipe.as_dict().items() if was.get(name) != value
        )
        raise LibraryError(
            f"{library.path}: holds a library made otherwise ({said or 'another controller'}); --update makes it anew,"
            " or choose another --out"
        )
    if there != recipe.digest:
        library.save_recipe(recipe)


def _place(robot: str) -> str:
    """A robot's name or absolute path, valid in any process."""
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
    """Surveys the sources that changed, saves the surveys, and returns all in the order of the sources."""
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
    """Forgets surveys of the same parts of files that were read with other settings (rate, licence); for the build's
    folders also those of removed files, and failures of sources not requested now."""
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
    missing = [job for job in jobs if not seen.finished(job.id, job.motion_file)]
    # in random order, so that builders in the same folder do different jobs; each skips those of the others
    Random().shuffle(missing)
    total, done = len(jobs), len(jobs) - len(missing)
    begun: dict[int, float] = {}  # finished share of each running job
    over: set[int] = set()
    tell(BuildStep("making", done, total, done / total if total else 1.0))

    def progress(index: int, share: float) -> None:
        if index not in over:  # the report may come late
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
