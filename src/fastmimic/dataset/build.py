"""Builds a library: surveys the sources, runs the remaining jobs, writes the index."""

import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import closing
from dataclasses import asdict, dataclass
from functools import cached_property, partial
from pathlib import Path
from random import Random
from typing import Any, Final

from fastmimic.base.arrays import fingerprint
from fastmimic.base.configuration import check, parameter
from fastmimic.base.errors import ConfigError, LibraryError, OutputError, WorkerError
from fastmimic.base.files import remove_file, write_text
from fastmimic.dataset.excerpts import Cut, DatasetSource, Survey, look_of, survey, survey_file
from fastmimic.dataset.folder import BuildSettings, DamagedError, MotionDataset, working
from fastmimic.dataset.index import FAILED, Record, load_record, require_pyarrow
from fastmimic.dataset.jobs import Job, give_up, now, perform
from fastmimic.executors import Executor, Report
from fastmimic.robot import Robot, load_robot

CONFIDENCE: Final = 0.5
INDEX_EVERY: Final = 200
INDEX_SHARE: Final = 0.1
"""A running build writes the index, which reads every record, after so many new ones, if they are so large a share."""


@dataclass(frozen=True, eq=False)
class BuildRequest:
    """What to build.

    Attributes:
        robots: built-in names, or paths of MJCFs.
        seeds: searches for each excerpt and robot, with CMA-ES seeds 0 to seeds − 1.
        confidence: least confidence of a cycle found in a take.
        cut: what to imitate of takes.
        folders: absolute paths of the sources' folders; excerpts of files no longer in them are forgotten.
    """

    sources: Sequence[DatasetSource]
    recipe: BuildSettings
    robots: Sequence[str]
    seeds: int = parameter(1, low=1)
    confidence: float = parameter(CONFIDENCE, high=1.0)
    cut: Cut = "cycles"
    folders: Sequence[Path] = ()

    def __post_init__(self) -> None:
        if not self.robots:
            raise ConfigError("a library needs at least one robot")
        check(self, "")


@dataclass(frozen=True)
class BuildStep:
    """Progress of a build, with the record or survey that was just finished, if any."""

    what: str  # 'looking' through sources, or 'making' motions
    done: int
    total: int
    share: float  # of all work of that kind, in [0, 1]
    record: Record | None = None
    survey: Survey | None = None


@dataclass(frozen=True)
class Built:
    """Result of a build."""

    library: MotionDataset
    table: Any  # the library's index, an Arrow table, including results of other builds
    surveys: list[Survey]
    ids: frozenset[str]  # of the records of the requested sources' jobs
    done: int  # number of jobs done now; the others were finished before
    left_out: list[str]  # robot motions for none of the robots, one line each

    @property
    def jobs(self) -> int:
        return len(self.ids)

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
    tell = progress if progress is not None else lambda step: None
    with working(library.path, alone=False):
        return _Builder(building, library, executor, tell).build(robots, update=update, began=began)


def describe_failure(record: Mapping[str, Any]) -> str:
    return f"{record['name']} on {record['robot']} seed {record['seed']}: {record['reason']}"


@dataclass(frozen=True)
class _Builder:
    """A build: what is asked for, where it goes, where its jobs run, and who hears of its progress."""

    request: BuildRequest
    library: MotionDataset
    executor: Executor
    tell: Callable[[BuildStep], None]

    def build(self, robots: Mapping[str, Robot], *, update: bool, began: str) -> Built:
        library, request = self.library, self.request
        _begin(library, request.recipe, update)
        digests = {name: fingerprint(robot.content) for name, robot in robots.items()}
        for name, digest in digests.items():
            library.save_robot(_place(name), digest)
        surveys = self._look(again=update)
        jobs = [
            Job(piece, _place(name), digests[name], seed, request.recipe, library.path, began=began)
            for survey in surveys
            for piece in survey.pieces
            for name, robot in robots.items()
            if piece.robot in (None, robot.name)
            for seed in range(request.seeds)
        ]
        jobs = list({job.id: job for job in jobs}.values())
        try:
            done = self._make(jobs)
        except BaseException:
            library.write_index(settled=False)
            raise
        ids = frozenset(job.id for job in jobs)
        table = library.write_index().table
        names = {robot.name for robot in robots.values()}
        others = [p for s in surveys for p in s.pieces if p.robot is not None and p.robot not in names]
        left_out = [f"{piece.source}: already a motion of the {piece.robot}" for piece in others]
        return Built(library, table, surveys, ids, done, left_out)

    def _look(self, *, again: bool) -> list[Survey]:
        """Surveys the sources that changed, saves the surveys, and returns all in the order of the sources."""
        request, sources = self.request, list(self.request.sources)
        known = {survey.source: survey for survey in self.library.surveys()[0]}
        found: dict[int, Survey] = {}
        for i, source in enumerate([] if again else sources):
            old = known.get(source)
            if old and old.looked and old.looked == look_of(source, request.confidence, request.cut):
                found[i] = old

        def tell(survey: Survey | None = None) -> None:
            share = len(found) / len(sources) if sources else 1.0
            self.tell(BuildStep("looking", len(found), len(sources), share, survey=survey))

        missing = [i for i in range(len(sources)) if i not in found]
        tell()
        looking = partial(_survey, confidence=request.confidence, cut=request.cut)
        with closing(self.executor.run(looking, [sources[i] for i in missing])) as outcomes:
            for outcome in outcomes:
                if isinstance(outcome.error, OutputError):
                    raise outcome.error
                at = missing[outcome.index]
                found[at] = outcome.result or Survey(sources[at], failed=str(outcome.error))
                text = json.dumps(asdict(found[at]), indent=1, allow_nan=False)
                write_text(survey_file(self.library.path, found[at].source), text)
                tell(found[at])
        self._forget(known.values())
        return [found[i] for i in range(len(sources))]

    def _forget(self, known: Iterable[Survey]) -> None:
        """Forgets surveys of the same parts of files that were read with other settings (rate, licence); for the
        build's folders also those of removed files, and failures of sources not requested now."""
        sources = self.request.sources
        keys, parts = {source.key for source in sources}, {(source.place, source.frames) for source in sources}
        for old in known:
            if old.source.key in keys:
                continue
            place = Path(old.source.place)
            within = any(place.is_relative_to(folder) for folder in self.request.folders)
            if (old.source.place, old.source.frames) in parts or (within and (old.failed or not place.exists())):
                remove_file(survey_file(self.library.path, old.source))

    def _make(self, jobs: Sequence[Job]) -> int:
        """Does the jobs that are not finished; returns their number."""
        known = (load_record(self.library.path, job.id) for job in jobs)
        missing = [job for job, record in zip(jobs, known, strict=True) if record is None or record["status"] == FAILED]
        # in random order, so that builders in the same folder do different jobs; each skips those of the others
        Random().shuffle(missing)
        total, done = len(jobs), len(jobs) - len(missing)
        begun: dict[int, float] = {}  # finished share of each running job

        def tell(record: Record | None = None) -> None:
            share = (done + sum(begun.values())) / total if total else 1.0
            self.tell(BuildStep("making", done, total, share, record=record))

        def progress(index: int, share: float) -> None:
            begun[index] = share
            tell()

        tell()
        since, every = 0, INDEX_EVERY
        with closing(self.executor.run(perform, missing, progress)) as outcomes:
            for outcome in outcomes:
                job = missing[outcome.index]
                if outcome.error is not None and not isinstance(outcome.error, WorkerError):
                    raise outcome.error
                record = outcome.result if outcome.error is None else give_up(job, outcome.error)
                done, since = done + 1, since + 1
                begun.pop(outcome.index, None)
                tell(record)
                if since >= every:
                    found = self.library.write_index(settled=False)
                    every, since = max(INDEX_EVERY, round(INDEX_SHARE * found.table.num_rows)), 0
        return len(missing)


def _begin(library: MotionDataset, recipe: BuildSettings, update: bool) -> None:
    there, was = None, {}
    try:
        there, was = library.recipe_digest(), library.settings()
    except LibraryError as error:
        repaired = isinstance(error, DamagedError) and library.holds(recipe.digest)
        if not (update or repaired):
            raise
    if there is not None and there != recipe.digest and not update:
        other = [name for name, value in recipe.as_dict().items() if was.get(name) != value]
        said = ", ".join(f"{name} was {was.get(name)}" for name in other) or "another controller"
        made = f"{library.path}: holds a library made otherwise ({said})"
        raise LibraryError(f"{made}; --update makes it anew, or choose another --out")
    if there != recipe.digest:
        library.save_recipe(recipe)


def _place(robot: str) -> str:
    """A robot's name or absolute path, valid in any process."""
    path = Path(robot)
    return str(path.resolve()) if path.is_file() else robot.lower()


def _survey(source: DatasetSource, report: Report, *, confidence: float, cut: Cut) -> Survey:
    return survey(source, confidence, cut)
