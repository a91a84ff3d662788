"""Listing, exporting and checking the motions of a library."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

from tyro.conf import Positional

from fastmimic.base.errors import ConfigError, unknown
from fastmimic.base.files import check_folder
from fastmimic.commands import options as opt
from fastmimic.commands.console import (
    EXIT_SOME_FAILED,
    SLOW_START,
    count_progress,
    note,
    put,
    put_json,
    put_table,
    slow_start,
)
from fastmimic.commands.motion_files import ExportFormat

if TYPE_CHECKING:  # loads the compiler
    from fastmimic.dataset.folder import MotionDataset, Row

LibraryFolder = Annotated[Positional[Path], opt.option("LIBRARY", "Folder of the library.")]
_LISTED: Final = (
    *("id", "name", "robot", "seed", "gait", "footfall", "grade"),
    *("kept", "best", "reward", "reward_robots", "lacks"),
)
"""Columns that a list shows or is filtered by."""


@dataclass(frozen=True, kw_only=True)
class _Choice:
    """The choice of motions in a library."""

    robot: Annotated[str | None, opt.option("NAME")] = None
    """Only of this robot."""
    gait: Annotated[str | None, opt.option("NAME")] = None
    """Only of this gait."""
    grade: Annotated[tuple[str, ...], opt.option("A|B|C|rejected|failed ...")] = ()
    """Only of these grades."""
    all_seeds: opt.Flag = False
    """All seeds instead of the best one of each motion and robot."""

    def chosen(self, rows: "Sequence[Row]") -> "list[Row]":
        """The rows that were asked for."""
        from fastmimic.dataset.records import FAILURE, GRADES, REJECTED

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


@dataclass(frozen=True, kw_only=True)
class ListMotions(_Choice):
    """Lists the motions of a library with their grades."""

    library: LibraryFolder
    superseded: opt.Flag = False
    """List the outdated records instead, with the reason: another recipe, a changed source or robot, or a newer record
    of the same motion."""
    json: opt.JsonFlag = False

    def run(self) -> int:
        from fastmimic.dataset import MotionDataset

        library = MotionDataset.open(self.library)
        if self.superseded:
            return self._superseded(library)
        chosen = self.chosen(library.index(() if self.json else _LISTED))
        if self.json:
            put_json({"motions": chosen})
            return 0
        head = ("id", "name", "robot", "seed", "gait", "grade", "reward", "others", "lacks")
        put_table([head, *(_line(row) for row in chosen)], right=(6, 7))
        put_summary(library)
        plan = library.plan()
        put(*plan.problems)
        for line in plan.unreadable:
            note(f"damaged: {line}")
        return 0

    def _superseded(self, library: "MotionDataset") -> int:
        found = library.gathered().superseded
        if self.json:
            put_json({"superseded": [asdict(old) for old in found]})
            return 0
        lines = [(old.id[:8], old.name, old.robot, str(old.seed), old.why) for old in found]
        put_table([("id", "name", "robot", "seed", "why"), *lines])
        put(f"{len(found)} outdated records; 'fastmimic library verify {library.path} --mend' removes them")
        return 0


@dataclass(frozen=True, kw_only=True)
class Show:
    """Prints the full record of a motion."""

    library: LibraryFolder
    motion: Annotated[Positional[str], opt.option("ID|NAME")]
    """Id or name as in 'library list'; the beginning of an id is enough."""
    json: opt.JsonFlag = False

    def run(self) -> int:
        from fastmimic.dataset import MotionDataset

        library = MotionDataset.open(self.library)
        rows = library.find(self.motion)
        if self.json:
            put_json({"motions": rows})
            return 0
        for i, row in enumerate(rows):
            if i:
                put("")
            known = {name: value for name, value in row.items() if value is not None}
            put_table([(name, f"{v:.6g}" if isinstance(v, float) else str(v)) for name, v in known.items()])
            if row["motion_file"] is not None:
                note(f"to see it: fastmimic view {library.path / row['motion_file']}")
        return 0


@dataclass(frozen=True, kw_only=True)
class LibraryExport(_Choice):
    """Writes the motions of a library for other trainers, as 'fastmimic export' does, with a table of them."""

    library: LibraryFolder
    to: Annotated[Path, opt.option("FOLDER")]
    """Folder to write."""
    format: ExportFormat = "mjlab"
    fps: Annotated[float, opt.option("HZ")] = 50.0
    """Frames per second."""

    def run(self) -> int:
        from fastmimic.dataset import MotionDataset
        from fastmimic.dataset.folder import NEEDED, export_library

        library = MotionDataset.open(self.library)
        columns = (*NEEDED, "kept", "best")
        chosen = [row for row in self.chosen(library.index(columns)) if row["motion_file"] is not None]
        if not self.grade:
            chosen = [row for row in chosen if row["kept"]]
        if not chosen:
            raise ConfigError(f"{self.library}: no motion of it fits what was asked for; see 'fastmimic library list'")
        check_folder(self.to)
        with count_progress("exporting") as progress:
            index = export_library(library, chosen, self.to, self.format, fps=self.fps, progress=progress)
        put(f"{len(chosen)} motions in {self.to}, listed in {index.name}")
        for licence in sorted({row["licence"] or "not stated" for row in chosen}):
            put(f"licence of the recordings: {licence}")
        return 0


@dataclass(frozen=True, kw_only=True)
class Verify:
    """Reads everything in a library and lists what is damaged; with --rerun also runs some motions again.

    The exit status is 3 if something is wrong.
    """

    library: LibraryFolder
    rerun: Annotated[int, opt.option("N")] = 0
    """Run the nominal episodes of N random motions again and compare them with the records."""
    mend: opt.Flag = False
    """Rewrite the index and remove orphaned files and damaged records, which the next build makes again. Refused while
    a build is running."""

    def run(self) -> int:
        from fastmimic.dataset import MotionDataset
        from fastmimic.dataset.repair import check, mend, rerun

        if self.rerun < 0:
            raise ConfigError(f"--rerun must not be negative, found {self.rerun}")
        library = MotionDataset.open(self.library)
        removed = 0
        with count_progress("reading") as progress:
            if self.mend:
                health, removed = mend(library, progress)
            else:
                health = check(library, progress)
        put(f"{health.records} records, {len(health.damaged)} damaged, {len(health.foreign)} orphaned files")
        put(*(f"damaged: {line}" for line in health.damaged))
        if health.outdated:
            put("the index is out of date")
        differing: list[str] = []
        if self.rerun:
            with slow_start(SLOW_START), count_progress("running") as progress:
                differing, done = rerun(library, self.rerun, progress)
            put(f"{done} motions run again, {len(differing)} with a different reward")
            put(*(f"differs: {line}" for line in differing))
        if self.mend:
            put(f"removed {removed} files; index of {len(library.index(('id',)))} records written")
            return EXIT_SOME_FAILED if differing or health.unreadable else 0
        return 0 if health.sound and not differing else EXIT_SOME_FAILED


def put_summary(library: "MotionDataset") -> None:
    """Prints the number of records by grade, by version if there are several, and those outside the index."""
    from fastmimic.dataset.records import FAILURE, GRADES, REJECTED

    rows = library.index(("id", "grade", "fastmimic_version"))
    counted = Counter(row["grade"] for row in rows)
    said = ", ".join(f"{counted[name]} {name}" for name in (*GRADES, REJECTED, FAILURE) if counted[name])
    put(f"{len(rows)} records: {said}" if rows else "no records")
    versions = Counter(row["fastmimic_version"] for row in rows if row["fastmimic_version"] is not None)
    if len(versions) > 1:
        made = ", ".join(f"{count} by {version}" for version, count in sorted(versions.items()))
        put(f"made by several versions of FastMimic ({made}): 'verify --rerun' checks whether the figures still hold")
    others = library.record_ids().difference(row["id"] for row in rows)
    if others:
        put(f"{len(others)} more records are not in the index: 'list --superseded' lists the reasons")


def _line(row: "Row") -> tuple[str, ...]:
    gait = row["gait"] if row["footfall"] in (None, row["gait"]) else f"{row['gait']} ({row['footfall']})"
    rewards = ("" if row[name] is None else f"{row[name]:.3f}" for name in ("reward", "reward_robots"))
    about = (row["id"][:8], row["name"], row["robot"], str(row["seed"]))
    return (*about, gait or "", row["grade"], *rewards, row["lacks"] or "")
