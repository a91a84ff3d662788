"""`fastmimic library`: datasets of motions that a robot can execute; building, listing, exporting, checking them."""

from collections import Counter, defaultdict
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

from tyro.conf import OmitArgPrefixes, OmitSubcommandPrefixes, Positional, subcommand

from fastmimic.base.errors import ConfigError, FastMimicError, unknown
from fastmimic.base.files import check_folder
from fastmimic.base.progress import count_progress, note, share_progress, slow_start, tenths
from fastmimic.clips.catalogue import parse_frames
from fastmimic.commands import options as opt
from fastmimic.commands.console import EXIT_SOME_FAILED, put, put_json, put_table
from fastmimic.commands.motion_files import ExportFormat
from fastmimic.executors import make_executor
from fastmimic.simulation.simulators import SECOND_SIMULATOR, SIMULATORS

if TYPE_CHECKING:  # loads the compiler
    from fastmimic.dataset.build import BuildRequest, BuildStep
    from fastmimic.dataset.excerpts import Cut
    from fastmimic.dataset.folder import MotionDataset, Row

LibraryFolder = Annotated[Positional[Path], opt.option("LIBRARY", "Folder of the library.")]
_FIGURES: Final = ("reward_animal", "reward_mean", "reward_mean_robots", "success_perturbed", "mpjpe_mm")
_LISTED: Final = (*("id", "name", "robot", "seed", "gait", "footfall", "grade"), *("kept", "best", "lacks", *_FIGURES))
"""Columns that a list shows or is filtered by."""


@opt.command
class Build:
    """Builds a library of motions from folders, lists, files and names: finds the cycles in long takes, retargets and
    optimises them, tests each motion from perturbed starts, on other robots and in a second simulator, grades it, and
    keeps a record."""

    sources: Annotated[Positional[tuple[str, ...]], opt.option("FOLDER|LIST|MOTION ...")]
    out: Annotated[Path, opt.option("LIBRARY")]
    robots: Annotated[tuple[str, ...], opt.shared("NAME|FILE ...", "robot")] = (opt.DEFAULT_ROBOT,)
    seeds: int = 1
    method: opt.MethodName = "mbc-dmp"
    config: opt.ConfigName = "default"
    duration: Annotated[float, opt.option("S")] = 5.0
    trial: Annotated[float, opt.option("S")] = 10.0
    perturbed: int = 8
    others: int = 16
    no_second_simulator: opt.Flag = False
    confidence: Annotated[float, opt.option("SHARE")] = 0.5
    discrete: opt.Flag = False
    whole: opt.Flag = False
    frames: Annotated[str | None, opt.option("A:B")] = None
    exclude: Annotated[tuple[str, ...], opt.option("PATTERN ...")] = ()
    licence: Annotated[str | None, opt.option("TEXT")] = None
    credit: Annotated[str | None, opt.option("TEXT")] = None
    executor: Annotated[str, opt.option("local|ray")] = "local"
    address: Annotated[str | None, opt.option("HOST:PORT")] = None
    workers: opt.Workers = None
    update: opt.Flag = False
    search: opt.Searching

    def run(self) -> int:
        from fastmimic.dataset import build_dataset

        building = self._building()
        executor = make_executor(self.executor, workers=self.workers, address=self.address)
        counts = {"source": len(building.sources), "robot": len(building.robots), "seed": building.seeds}
        said = ", ".join(f"{n} {what}{'s' * (n != 1)}" for what, n in counts.items()) + f", in {self.out}"
        with _progress(said) as progress:
            built = build_dataset(building, self.out, executor, update=self.update, progress=progress)
        put(f"{built.jobs} motions, {built.done} of them new")
        put_summary(built.library)
        for line in built.left_out:
            note(f"skipped: {line}")
        failed = len(built.failures)
        if failed:
            put(f"{failed} failed: 'fastmimic library list {self.out} --grade failed' lists them with the reason")
        put(f"library in {self.out}")
        return EXIT_SOME_FAILED if failed else 0

    def _building(self) -> "BuildRequest":
        from fastmimic.dataset import BuildRequest, BuildSettings, find_sources

        if self.discrete and self.whole:
            either = "a take is run whole (--whole) or cut into its movements (--discrete)"
            raise ConfigError(f"{either}: drop one of the two")
        if not self.sources:
            raise ConfigError("no sources given; name folders, lists, clips or motions")
        sources = []
        for place in self.sources:
            sources += find_sources(place, exclude=self.exclude, licence=self.licence, credit=self.credit)
        if self.frames is not None:
            sources = [replace(source, frames=parse_frames(self.frames, "--frames")) for source in sources]
        second = SIMULATORS[SECOND_SIMULATOR]
        if not (self.no_second_simulator or second.installed) and any(map(second.knows, self.robots)):
            note(f"{second.name} is not installed: motions are not tested in a second simulator")
        tried = not self.no_second_simulator and second.installed
        lengths = {"duration_s": self.duration, "evaluation_s": self.trial}
        recipe = opt.apply(BuildSettings, self, self.search, second_simulator=tried, **lengths)
        folders = [path.resolve() for place in self.sources if (path := Path(place)).is_dir()]
        cut: Cut = "whole" if self.whole else "segments" if self.discrete else "cycles"
        return BuildRequest(sources, recipe, self.robots, self.seeds, self.confidence, cut, folders)


@opt.command
class _Choice:
    """The choice of motions in a library."""

    robot: Annotated[str | None, opt.option("NAME")] = None
    gait: Annotated[str | None, opt.option("NAME")] = None
    grade: Annotated[tuple[str, ...], opt.option("A|B|C|rejected|failed ...")] = ()
    all_seeds: opt.Flag = False

    def chosen(self, rows: "Sequence[Row]") -> "list[Row]":
        from fastmimic.dataset.index import FAILURE, GRADES, REJECTED

        known = (*GRADES, REJECTED, FAILURE)
        for name in self.grade:
            if name not in known:
                raise unknown("grade", name, known)
        for column, given in (("robot", self.robot), ("gait", self.gait)):
            there = sorted({row[column] for row in rows if row[column] is not None})
            if given is not None and given not in there:
                raise ConfigError(f"no motion of {column} '{given}' in this library; there are {', '.join(there)}")
        return [
            row
            for row in rows
            if self.robot in (None, row["robot"])
            and self.gait in (None, row["gait"])
            and (not self.grade or row["grade"] in self.grade)
            and (self.all_seeds or row["best"] or not row["kept"])
        ]


@opt.command
class ListMotions(_Choice):
    """Lists the motions of a library with their grades."""

    library: LibraryFolder
    superseded: opt.Flag = False
    json: opt.JsonFlag = False

    def run(self) -> None:
        from fastmimic.dataset import MotionDataset

        library = MotionDataset.open(self.library)
        if self.superseded:
            return self._superseded(library)
        chosen = self.chosen(library.index(() if self.json else _LISTED))
        if self.json:
            return put_json({"motions": chosen})
        head = ("id", "name", "robot", "seed", "gait", "grade", "animal", "reward", "others", "success", "mpjpe, mm")
        put_table([(*head, "lacks"), *(_line(row) for row in chosen)], right=range(6, 11))
        put_summary(library)
        plan = library.plan()
        put(*plan.problems)
        for line in plan.unreadable:
            note(f"damaged: {line}")

    def _superseded(self, library: "MotionDataset") -> None:
        found = library.gathered().superseded
        if self.json:
            return put_json({"superseded": [asdict(old) for old in found]})
        lines = [(old.id[:8], old.name, old.robot, str(old.seed), old.why) for old in found]
        put_table([("id", "name", "robot", "seed", "why"), *lines])
        put(f"{len(found)} outdated records; 'fastmimic library verify {library.path} --mend' removes them")


@opt.command
class Show:
    """Prints the full record of a motion."""

    library: LibraryFolder
    motion: Annotated[Positional[str], opt.option("ID|NAME")]
    json: opt.JsonFlag = False

    def run(self) -> None:
        from fastmimic.dataset import MotionDataset

        library = MotionDataset.open(self.library)
        rows = library.find(self.motion)
        if self.json:
            return put_json({"motions": rows})
        for i, row in enumerate(rows):
            if i:
                put("")
            known = {name: value for name, value in row.items() if value is not None}
            put_table([(name, f"{v:.6g}" if isinstance(v, float) else str(v)) for name, v in known.items()])
            if row["motion_file"] is not None:
                note(f"to see it: fastmimic view {library.path / row['motion_file']}")


@opt.command
class LibraryExport(_Choice):
    """Writes the motions of a library for other trainers, as 'fastmimic export' does, with a table of them."""

    library: LibraryFolder
    to: Annotated[Path, opt.option("FOLDER")]
    format: ExportFormat = "mjlab"
    fps: Annotated[float, opt.option("HZ")] = 50.0

    def run(self) -> None:
        from fastmimic.dataset import MotionDataset
        from fastmimic.dataset.folder import NEEDED, export_library

        library = MotionDataset.open(self.library)
        rows = self.chosen(library.index((*NEEDED, "kept", "best")))
        chosen = [row for row in rows if row["motion_file"] is not None and (self.grade or row["kept"])]
        if not chosen:
            raise ConfigError(f"{self.library}: no motion of it fits what was asked for; see 'fastmimic library list'")
        check_folder(self.to)
        with count_progress("exporting") as progress:
            index = export_library(library, chosen, self.to, self.format, fps=self.fps, progress=progress)
        put(f"{len(chosen)} motions in {self.to}, listed in {index.name}")
        for licence in sorted({row["licence"] or "not stated" for row in chosen}):
            put(f"licence of the recordings: {licence}")


@opt.command
class Verify:
    """Reads everything in a library and lists what is damaged; with --rerun also runs some motions again."""

    library: LibraryFolder
    rerun: Annotated[int, opt.option("N")] = 0
    mend: opt.Flag = False

    def run(self) -> int:
        from fastmimic.dataset import MotionDataset
        from fastmimic.dataset.repair import check, repair, rerun

        if self.rerun < 0:
            raise ConfigError(f"--rerun must not be negative, found {self.rerun}")
        library = MotionDataset.open(self.library)
        with count_progress("reading") as progress:
            health, removed = repair(library, progress) if self.mend else (check(library, progress), 0)
        put(f"{health.records} records, {len(health.damaged)} damaged, {len(health.foreign)} orphaned files")
        put(*(f"damaged: {line}" for line in health.damaged))
        if health.outdated:
            put("the index is out of date")
        differing: list[str] = []
        if self.rerun:
            with slow_start(), count_progress("running") as progress:
                differing, done = rerun(library, self.rerun, progress)
            put(f"{done} motions run again, {len(differing)} with a different reward")
            put(*(f"differs: {line}" for line in differing))
        if self.mend:
            put(f"removed {removed} files; index of {len(library.index(('id',)))} records written")
            return EXIT_SOME_FAILED if differing or health.unreadable else 0
        return 0 if health.sound and not differing else EXIT_SOME_FAILED


@opt.command
class Libraries:
    """Builds, lists and checks libraries: datasets of motions that a robot can execute."""

    action: OmitArgPrefixes[
        OmitSubcommandPrefixes[
            Annotated[Build, subcommand("build")]
            | Annotated[ListMotions, subcommand("list")]
            | Annotated[Show, subcommand("show")]
            | Annotated[LibraryExport, subcommand("export")]
            | Annotated[Verify, subcommand("verify")]
        ]
    ]

    def run(self) -> int | None:
        return self.action.run()


@contextmanager
def _progress(said: str) -> "Iterator[Callable[[BuildStep], None]]":
    """Prints what is built, each finished motion and failure, and how to continue; on a terminal also a bar."""
    from fastmimic.dataset.build import describe_failure
    from fastmimic.dataset.index import FAILED, grade

    started_building = False
    due: defaultdict[str, Callable[[int, int], bool]] = defaultdict(tenths)  # by what is done
    with slow_start() as started, share_progress("building") as tell:

        def report(step: "BuildStep") -> None:
            nonlocal started_building
            if not started_building:
                note(said)
                started_building = True
            if step.survey is not None and step.survey.failed is not None:
                note(f"failed: {step.survey.problem}")
            if step.record is not None and step.record["status"] == FAILED:
                note(f"failed: {describe_failure(step.record)}")
            elif step.record is not None:
                started()
                r = step.record
                what = f"reward {r['reward_mean']:.3f}, {grade(r)[0]}"
                note(f"{step.done}/{step.total} {r['name']} on {r['robot']} seed {r['seed']}: {what}")
            what = f"{step.what} {step.done}/{step.total}"
            tell(step.share, what, f"{what}, {step.share:.0%}" if due[step.what](round(100 * step.share), 100) else "")

        try:
            yield report
        except (KeyboardInterrupt, FastMimicError):
            if started_building:
                note("finished motions are kept; the same command continues")
            raise


def put_summary(library: "MotionDataset") -> None:
    """Prints the number of records by grade, by version if there are several, and those outside the index."""
    from fastmimic.dataset.index import FAILURE, GRADES, RECORDS, REJECTED

    rows = library.index(("id", "grade", "fastmimic_version"))
    counted = Counter(row["grade"] for row in rows)
    said = ", ".join(f"{counted[name]} {name}" for name in (*GRADES, REJECTED, FAILURE) if counted[name])
    put(f"{len(rows)} records: {said}" if rows else "no records")
    versions = Counter(row["fastmimic_version"] for row in rows if row["fastmimic_version"] is not None)
    if len(versions) > 1:
        made = ", ".join(f"{count} by {version}" for version, count in sorted(versions.items()))
        put(f"made by several versions of FastMimic ({made}): 'verify --rerun' checks whether the figures still hold")
    records = {path.stem for path in (library.path / RECORDS).glob("*.json")}
    others = records.difference(row["id"] for row in rows)
    if others:
        put(f"{len(others)} more records are not in the index: 'list --superseded' lists the reasons")


def _line(row: "Row") -> tuple[str, ...]:
    gait = row["gait"] if row["footfall"] in (None, row["gait"]) else f"{row['gait']} ({row['footfall']})"
    forms = {"success_perturbed": ".0%", "mpjpe_mm": ".0f"}
    figures = ("" if row[name] is None else format(row[name], forms.get(name, ".3f")) for name in _FIGURES)
    about = (row["id"][:8], row["name"], row["robot"], str(row["seed"]))
    return (*about, gait or "", row["grade"], *figures, row["lacks"] or "")
