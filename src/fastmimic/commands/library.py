"""`fastmimic library`: datasets of motions that a robot can execute."""

import json
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

from tyro.conf import OmitArgPrefixes, OmitSubcommandPrefixes, Positional, arg, subcommand

from fastmimic.base.errors import ConfigError, FastMimicError, did_you_mean
from fastmimic.commands.console import SLOW_START, count_progress, note, put, share_progress, slow_start, table
from fastmimic.commands.options import DEFAULT_ROBOT
from fastmimic.robot import ROBOT_CHOICES

if TYPE_CHECKING:
    from fastmimic.dataset.build import BuildRequest, BuildStep
    from fastmimic.dataset.folder import MotionDataset, Row

EXIT_SOME_FAILED: Final = 3
"""Everything else was done."""
_LISTED: Final = (
    "id",
    "name",
    "robot",
    "seed",
    "gait",
    "footfall",
    "grade",
    "kept",
    "best",
    "reward",
    "reward_robots",
    "lacks",
)
"""The columns that a list shows, or is chosen by."""


@dataclass(frozen=True, kw_only=True)
class Build:
    """Makes a library of everything in a folder, or of a list: finds the cycles in long takes, retargets, optimises,
    tries each motion from perturbed starts, on other robots and in a second simulator, grades it, and keeps a record.

    What is done is not done again, so the same command goes on after Ctrl-C, a crash or a full disk, and does what is
    new after a change. The exit status is 3 if some sources or motions failed; all others are made.
    """

    sources: Annotated[Positional[tuple[str, ...]], arg(metavar="FOLDER|LIST|MOTION ...")]
    """Folders of clips, lists (.csv with a column 'source', or .list with a line each), files, or names of 'fastmimic
    motions'."""
    out: Annotated[Path, arg(metavar="LIBRARY")]
    """The library's folder."""
    robots: Annotated[tuple[str, ...], arg(metavar="NAME|FILE.xml ...", help=f"{ROBOT_CHOICES}.")] = (DEFAULT_ROBOT,)
    seeds: int = 1
    """Searches for each motion and robot."""
    method: Annotated[str, arg(metavar="NAME")] = "mbc-dmp"
    """As in 'fastmimic imitate'."""
    config: Annotated[str, arg(metavar="default|robust|paper|FILE")] = "default"
    """The controller's parameters."""
    iterations: int = 200
    """Generations of CMA-ES."""
    population: int = 10
    """Candidates in each."""
    duration: Annotated[float, arg(metavar="S")] = 5.0
    """Length of the search's episodes."""
    trial: Annotated[float, arg(metavar="S")] = 10.0
    """Length of the episodes that a motion is tried in."""
    perturbed: int = 8
    """How many of them begin perturbed."""
    others: int = 16
    """On how many other robots it is tried: floors, loads and motors drawn from the usual ranges."""
    no_second_simulator: bool = False
    """Do not try it in PyBullet, even if that is installed."""
    confidence: Annotated[float, arg(metavar="SHARE")] = 0.5
    """From which a cycle found in a take is imitated."""
    discrete: bool = False
    """Also imitate movement in takes that does not repeat, such as turns, starts and stops, each done once."""
    warm_start: Annotated[Path | None, arg(metavar="LIBRARY")] = None
    """Begin each search like the most similar motion of a library that is finished."""
    exclude: Annotated[tuple[str, ...], arg(metavar="PATTERN ...")] = ()
    """Files of the folders to leave out, such as '*_raw.txt'."""
    licence: Annotated[str | None, arg(metavar="TEXT")] = None
    """Of sources that do not say."""
    credit: Annotated[str | None, arg(metavar="TEXT")] = None
    """Likewise."""
    executor: Annotated[str, arg(metavar="local|ray")] = "local"
    """Where it runs: processes here, or a Ray cluster that sees sources and library under the same paths."""
    address: Annotated[str | None, arg(metavar="HOST:PORT")] = None
    """Of a running Ray cluster; without, one is started here."""
    workers: Annotated[int | None, arg(metavar="INT")] = None
    """Jobs at a time; by default one for each core. The motions do not depend on it."""
    update: bool = False
    """Make a library anew that was made otherwise."""

    def run(self) -> int:
        """Builds it; returns the exit status."""
        from fastmimic.dataset import build
        from fastmimic.executors import make_executor

        building = self._building()
        executor = make_executor(self.executor, workers=self.workers, address=self.address)
        said = f"{len(building.sources)} sources, {len(building.robots)} robots, {building.seeds} seeds, in {self.out}"
        with _progress(said) as progress:
            built = build(building, self.out, executor, update=self.update, progress=progress)
        put(f"{built.jobs} motions, {built.done} of them made now")
        _summary(built.library)
        for line in built.left_out:
            note(f"left out: {line}")
        failed = len(built.failures)
        if failed:
            put(f"{failed} failed: 'fastmimic library list {self.out} --grade failed' says which, and why")
        put(f"library in {self.out}")
        return EXIT_SOME_FAILED if failed else 0

    def _building(self) -> "BuildRequest":
        from fastmimic.dataset import BuildRequest, BuildSettings, MotionDataset, find_sources

        if not self.sources:
            raise ConfigError("of what? name folders, lists, clips or motions")
        sources = [
            source
            for place in self.sources
            for source in find_sources(place, exclude=self.exclude, licence=self.licence, credit=self.credit)
        ]
        recipe = BuildSettings(
            method=self.method,
            config=self.config,
            duration_s=self.duration,
            iterations=self.iterations,
            population=self.population,
            evaluation_s=self.trial,
            perturbed=self.perturbed,
            others=self.others,
            second_simulator=not self.no_second_simulator and _second_simulator(self.robots),
        )
        warm = None if self.warm_start is None else MotionDataset.open(self.warm_start)
        folders = [path.resolve() for place in self.sources if (path := Path(place)).is_dir()]
        return BuildRequest(sources, recipe, self.robots, self.seeds, self.confidence, self.discrete, warm, folders)


@dataclass(frozen=True, kw_only=True)
class _Choice:
    """Which motions."""

    robot: Annotated[str | None, arg(metavar="NAME")] = None
    """Only of this robot."""
    gait: Annotated[str | None, arg(metavar="NAME")] = None
    """Only of this gait."""
    grade: Annotated[tuple[str, ...], arg(metavar="A|B|C|rejected|failed ...")] = ()
    """Only of these grades."""
    all_seeds: bool = False
    """All seeds, not only the best of each motion and robot."""

    def chosen(self, rows: "Sequence[Row]") -> "list[Row]":
        """Those of the rows that were asked for."""
        from fastmimic.dataset.grades import FAILURE, GRADES, REJECTED

        known = (*GRADES, REJECTED, FAILURE)
        for name in self.grade:
            if name not in known:
                raise ConfigError(f"unknown grade '{name}'; there are {', '.join(known)}{did_you_mean(name, known)}")
        for option, given in (("robot", self.robot), ("gait", self.gait)):
            there = sorted({row[option] for row in rows if row[option] is not None})
            if given is not None and given not in there:
                raise ConfigError(f"no motion of {option} '{given}' in this library; there are {', '.join(there)}")
        return [
            row
            for row in rows
            if self.robot in (None, row["robot"])
            and self.gait in (None, row["gait"])
            and (not self.grade or row["grade"] in self.grade)
            and (self.all_seeds or row["best"] or not row["kept"])
        ]


@dataclass(frozen=True, kw_only=True)
class ListMotions(_Choice):
    """Lists a library's motions with their grades."""

    library: Annotated[Positional[Path], arg(metavar="LIBRARY")]
    """Its folder."""
    superseded: bool = False
    """Instead, the records that do not belong to the library any more, and why: of another recipe, of a source or a
    robot that has changed, or with another one in their place that began otherwise."""
    json: bool = False
    """Print one JSON object with all columns instead of a table."""

    def run(self) -> int:
        """Prints them; returns the exit status."""
        from fastmimic.dataset import MotionDataset

        library = MotionDataset.open(self.library)
        if self.superseded:
            return self._superseded(library)
        chosen = self.chosen(library.index(() if self.json else _LISTED))
        if self.json:
            put(json.dumps({"motions": chosen}))
            return 0
        head = ("id", "name", "robot", "seed", "gait", "grade", "reward", "others", "lacks")
        lines = [head, *(_line(row) for row in chosen)]
        for line in table(lines, right=(6, 7)):
            put(line)
        _summary(library)
        plan = library.plan()
        for line in plan.problems:
            put(line)
        for line in plan.unreadable:
            note(f"damaged: {line}")
        return 0

    def _superseded(self, library: "MotionDataset") -> int:
        found = library.gathered().superseded
        if self.json:
            put(json.dumps({"superseded": [asdict(old) for old in found]}))
            return 0
        lines = [(old.id[:8], old.name, old.robot, str(old.seed), old.why) for old in found]
        for line in table([("id", "name", "robot", "seed", "why"), *lines]):
            put(line)
        put(f"{len(found)} records superseded; 'fastmimic library verify {library.path} --mend' removes them")
        return 0


@dataclass(frozen=True, kw_only=True)
class Show:
    """Prints everything that a library knows of a motion."""

    library: Annotated[Positional[Path], arg(metavar="LIBRARY")]
    """Its folder."""
    motion: Annotated[Positional[str], arg(metavar="ID|NAME")]
    """Which, as 'library list' says; the beginning of an id is enough."""
    json: bool = False
    """Print one JSON object."""

    def run(self) -> int:
        """Prints it; returns the exit status."""
        from fastmimic.dataset import MotionDataset

        library = MotionDataset.open(self.library)
        rows = library.find(self.motion)
        if self.json:
            put(json.dumps({"motions": rows}))
            return 0
        for i, row in enumerate(rows):
            if i:
                put()
            for line in table([(name, _said(value)) for name, value in row.items() if value is not None]):
                put(line)
            if row["motion_file"] is not None:
                note(f"to see it: fastmimic view {library.path / row['motion_file']}")
        return 0


@dataclass(frozen=True, kw_only=True)
class Export(_Choice):
    """Writes a library's motions for other trainers, as 'fastmimic export' does, with a table of what they are."""

    library: Annotated[Positional[Path], arg(metavar="LIBRARY")]
    """Its folder."""
    to: Annotated[Path, arg(metavar="FOLDER")]
    """Where they go."""
    format: Annotated[str, arg(metavar="mjlab|deepmimic|csv")] = "mjlab"
    """What for."""
    fps: Annotated[float, arg(metavar="HZ")] = 50.0
    """Frames a second."""

    def run(self) -> int:
        """Writes them; returns the exit status."""
        from fastmimic.base.files import check_folder
        from fastmimic.dataset import MotionDataset
        from fastmimic.dataset.exporting import NEEDED, export_library

        library = MotionDataset.open(self.library)
        columns = (*NEEDED, "kept", "best")
        chosen = [row for row in self.chosen(library.index(columns)) if row["motion_file"] is not None]
        if not self.grade:
            chosen = [row for row in chosen if row["kept"]]
        if not chosen:
            raise ConfigError(f"{self.library}: no motion of those asked for")
        check_folder(self.to)
        with count_progress("exporting") as progress:
            index = export_library(library, chosen, self.to, self.format, fps=self.fps, progress=progress)
        put(f"{len(chosen)} motions in {self.to}, listed in {index.name}")
        for licence in sorted({row["licence"] or "not stated" for row in chosen}):
            put(f"licence of the recordings: {licence}")
        return 0


@dataclass(frozen=True, kw_only=True)
class Verify:
    """Reads everything in a library and says what is damaged; with --rerun also runs some motions again.

    The exit status is 3 if something is wrong.
    """

    library: Annotated[Positional[Path], arg(metavar="LIBRARY")]
    """Its folder."""
    rerun: Annotated[int, arg(metavar="INT")] = 0
    """Run so many motions' nominal episodes again, drawn at random, and compare them with what is recorded."""
    mend: bool = False
    """Write the index anew, and remove damaged records, which the next build makes again, and files of no record.
    Refused while a build runs there."""

    def run(self) -> int:
        """Does it; returns the exit status."""
        from fastmimic.dataset import MotionDataset
        from fastmimic.dataset.folder import check
        from fastmimic.dataset.repair import mend, rerun

        if self.rerun < 0:
            raise ConfigError(f"--rerun must not be negative, found {self.rerun}")
        library = MotionDataset.open(self.library)
        removed = 0
        with count_progress("reading") as progress:
            if self.mend:
                health, removed = mend(library, progress)
            else:
                health = check(library, progress)
        put(f"{health.records} records, {len(health.damaged)} damaged, {len(health.foreign)} files of none")
        for line in health.damaged:
            put(f"damaged: {line}")
        if health.outdated:
            put("index: not of these records")
        differing: list[str] = []
        if self.rerun:
            with slow_start(SLOW_START), count_progress("running") as progress:
                differing, done = rerun(library, self.rerun, progress)
            put(f"{done} motions run again, {len(differing)} with another reward")
            for line in differing:
                put(f"differs: {line}")
        if self.mend:
            put(f"removed {removed} files; index of {len(library.index(('id',)))} records written")
            return EXIT_SOME_FAILED if differing or health.unreadable else 0
        return 0 if health.sound and not differing else EXIT_SOME_FAILED


@dataclass(frozen=True, kw_only=True)
class Libraries:
    """Builds, lists and checks libraries of motions that a robot can execute."""

    action: OmitArgPrefixes[
        OmitSubcommandPrefixes[
            Annotated[Build, subcommand("build")]
            | Annotated[ListMotions, subcommand(list)]
            | Annotated[Show, subcommand("show")]
            | Annotated[Export, subcommand("export")]
            | Annotated[Verify, subcommand("verify")]
        ]
    ]

    def run(self) -> int:
        """Does it; returns the exit status."""
        return self.action.run()


def _second_simulator(robots: Sequence[str]) -> bool:
    """Whether PyBullet is there, which is of the recipe whatever the robots are; says so once if it is not, and would
    know one of them."""
    from fastmimic.simulation.pybullet_sim import DESCRIPTIONS, require_pybullet

    try:
        require_pybullet()
    except ConfigError:
        if any(name.lower() in DESCRIPTIONS for name in robots):
            note("PyBullet is not installed: motions are not tried in a second simulator")
        return False
    return True


@contextmanager
def _progress(said: str) -> "Iterator[Callable[[BuildStep], None]]":
    """Says what is built once it begins; then a bar on a terminal, and in any case a line for each motion that is
    finished and each source that fails; and how to go on, if it was stopped."""
    from fastmimic.dataset.build import describe_failure
    from fastmimic.dataset.grades import grade
    from fastmimic.dataset.records import FAILED

    begun = False
    with slow_start() as started, share_progress("building") as bar:

        def report(step: "BuildStep") -> None:
            nonlocal begun
            if not begun:
                note(said)
                begun = True
            if step.survey is not None and step.survey.failed is not None:
                note(f"failed: {step.survey.problem}")
            if step.record is not None and step.record["status"] == FAILED:
                note(f"failed: {describe_failure(step.record)}")
            elif step.record is not None:
                started()
                r = step.record
                what = f"reward {r['reward']:.3f}, {grade(r)[0]}"
                note(f"{step.done}/{step.total} {r['name']} on {r['robot']} seed {r['seed']}: {what}")
            if bar is not None:
                bar(step.share, f"{step.what} {step.done}/{step.total}")

        try:
            yield report
        except (KeyboardInterrupt, FastMimicError):
            if begun:
                note("what is finished is kept; the same command goes on")
            raise


def _summary(library: "MotionDataset") -> None:
    """How many of which grade, of which versions if there are several, and how many records besides."""
    from fastmimic.dataset.grades import FAILURE, GRADES, REJECTED

    rows = library.index(("id", "grade", "fastmimic_version"))
    counted = Counter(row["grade"] for row in rows)
    said = ", ".join(f"{counted[name]} {name}" for name in (*GRADES, REJECTED, FAILURE) if counted[name])
    put(f"{len(rows)} records: {said}" if rows else "no records")
    versions = Counter(row["fastmimic_version"] for row in rows if row["fastmimic_version"] is not None)
    if len(versions) > 1:
        made = ", ".join(f"{count} by {version}" for version, count in sorted(versions.items()))
        put(f"made by several versions of FastMimic ({made}): 'verify --rerun' tells whether figures still hold")
    others = library.record_ids().difference(row["id"] for row in rows)
    if others:
        put(f"{len(others)} more records are not in the index: 'list --superseded' says why")


def _line(row: "Row") -> tuple[str, ...]:
    def number(name: str) -> str:
        return "" if row[name] is None else f"{row[name]:.3f}"

    gait = row["gait"] if row["footfall"] in (None, row["gait"]) else f"{row['gait']} ({row['footfall']})"
    return (
        row["id"][:8],
        row["name"],
        row["robot"],
        str(row["seed"]),
        gait or "",
        row["grade"],
        number("reward"),
        number("reward_robots"),
        row["lacks"] or "",
    )


def _said(value: Any) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)
