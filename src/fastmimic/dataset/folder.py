"""A library on disk.

    library.json            recipe: settings of its motions
    index.parquet           a row for each record, graded
    records/ID.json         a record
    motions/NAME-ID.npz     its motion
    sources/KEY.json        survey of a source
    robots/KEY.json         digest of a robot's description
    work/                   checkpoints; without them, jobs cannot resume

Files are named by content and written atomically, so that any number of builders may share a folder, and the next one
repeats the work of a killed one. Every builder ends by making the index from the records, which hold all its data.
"""

import json
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from fastmimic.base.errors import LibraryError, did_you_mean
from fastmimic.base.files import replace_file, write_text
from fastmimic.dataset.build_settings import BuildSettings
from fastmimic.dataset.excerpts import SOURCES, Excerpt, Survey, load_surveys
from fastmimic.dataset.index import GRADED, Gathered, gather, require_pyarrow
from fastmimic.dataset.membership import ROBOTS, Membership, load_robots, save_robot
from fastmimic.dataset.records import COLUMNS, COSTS, MOTIONS, RECORDS, Record, damage, read_record
from fastmimic.motion.motion import Motion
from fastmimic.optimize.final_choice import FinalChoice

if TYPE_CHECKING:
    import pyarrow

SETTINGS: Final = "library.json"
INDEX: Final = "index.parquet"
FORMAT_VERSION: Final = 1

Row = dict[str, Any]


class DamagedError(LibraryError):
    """The recipe of a library cannot be read."""


@dataclass(frozen=True)
class MotionDataset:
    """The folder (`path`) of a library."""

    path: Path

    @classmethod
    def open(cls, path: str | Path) -> "MotionDataset":
        """Opens an existing library; `plan` reports damage. Raises `LibraryError` if there is none, or it has another
        format."""
        library = cls(Path(path))
        if not (library.path / SETTINGS).is_file():
            raise LibraryError(f"{path}: no library there; 'fastmimic library build SOURCES --out {path}' makes one")
        with suppress(DamagedError):
            library.recipe_digest()  # checks the format
        return library

    def recipe(self) -> BuildSettings | None:
        """The settings of its motions; None if it is not begun. Raises `LibraryError` if they cannot be read,
        `ConfigError` if the controller's parameter file is missing."""
        said = self.settings()
        return BuildSettings(**said | {"choice": FinalChoice(**said.get("choice", {}))}) if said else None

    def settings(self) -> dict[str, Any]:
        """The recipe as saved, empty if there is none; raises `LibraryError` if it cannot be read."""
        said = self._settings()
        return {} if said is None else dict(said["recipe"])

    def recipe_digest(self) -> str | None:
        """The saved digest of the recipe, even if a configuration file changed since; raises `LibraryError` if it
        cannot be read."""
        said = self._settings()
        return None if said is None else said["digest"]

    def _settings(self) -> dict[str, Any] | None:
        path = self.path / SETTINGS
        try:
            said: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
            if said["format_version"] != FORMAT_VERSION:
                raise LibraryError(
                    f"{path}: format version {said['format_version']}; this release reads version {FORMAT_VERSION}"
                )
            missing = ({"digest", *BuildSettings.__dataclass_fields__} ^ {"digest", *said["recipe"]}) - {"choice"}
            if missing or not isinstance(said["digest"], str):
                raise ValueError(f"not a recipe: {', '.join(sorted(missing)) or 'digest'}")
        except FileNotFoundError:
            return None
        except (OSError, ValueError, TypeError, KeyError) as error:
            raise DamagedError(f"{path}: cannot be read ({error}); the next build like it mends it") from None
        return said

    def save_recipe(self, recipe: BuildSettings) -> None:
        text = json.dumps(
            {"format_version": FORMAT_VERSION, "digest": recipe.digest, "recipe": recipe.as_dict()}, indent=1
        )
        write_text(self.path / SETTINGS, text)

    def save_robot(self, robot: str, digest: str) -> None:
        save_robot(self.path, robot, digest)

    def surveys(self) -> list[Survey]:
        """The surveys of its sources, without damaged ones."""
        return load_surveys(self.path)[0]

    def plan(self) -> Membership:
        """Which records belong to it; raises `LibraryError` for another format."""
        surveys, sources = load_surveys(self.path)
        robots, unreadable = load_robots(self.path)
        try:
            recipe = self.recipe_digest()
        except DamagedError as error:
            recipe, unreadable = None, [str(error).removeprefix(f"{self.path}/"), *unreadable]
        pieces: dict[str, list[Excerpt]] = {}
        for survey in surveys:
            for piece in survey.pieces:
                pieces.setdefault(piece.digest, []).append(piece)
        problems = tuple(survey.problem for survey in surveys if survey.problem is not None)
        return Membership(recipe, robots, pieces, (*unreadable, *sources), not sources, problems)

    def record_ids(self) -> set[str]:
        """Ids of all existing records, whether they belong to it or not."""
        return {path.stem for path in (self.path / RECORDS).glob("*.json")}

    def holds(self, recipe: str) -> bool:
        """Whether it has no records, or one of the recipe with that digest."""
        paths = list((self.path / RECORDS).glob("*.json"))
        return not paths or any(record is not None and record["recipe"] == recipe for record in map(read_record, paths))

    def gathered(self) -> Gathered:
        """All its records, including superseded ones."""
        return gather(self.path, self.plan())

    def write_index(self, *, settled: bool = True) -> Gathered:
        """Writes and returns the index of the existing records.

        With `settled`, repeats this until no other builder has finished a record meanwhile; for use at the end of a
        build. Raises `LibraryError` if Arrow is not installed, `OutputError` if the index cannot be written.
        """
        parquet = require_pyarrow()
        while True:
            there = self._state()
            found = self.gathered()
            replace_file(self.path / INDEX, partial(parquet.write_table, found.table))
            if not settled or self._state() == there:
                return found

    def index(self, columns: Sequence[str] = ()) -> list[Row]:
        """Rows of the index, with all columns if `columns` is empty; raises `LibraryError` if it is missing or
        damaged."""
        rows: list[Row] = self.index_table(columns).to_pylist()
        return rows

    def index_table(self, columns: Sequence[str] = ()) -> "pyarrow.Table":
        """The index as an Arrow table; raises as `index`."""
        parquet = require_pyarrow()
        path = self.path / INDEX
        if not path.is_file():
            raise LibraryError(f"{path}: no index yet; 'fastmimic library build' makes it when it ends")
        try:
            there = parquet.read_schema(path).names
            table = parquet.read_table(path, columns=[name for name in columns if name in there] or None)
        except (OSError, ValueError) as error:
            raise LibraryError(
                f"{path}: damaged ({str(error).splitlines()[0]}); 'fastmimic library verify --mend' makes it anew"
            ) from None
        missing = [name for name in (columns or (*COLUMNS, *GRADED)) if name not in table.column_names]
        if missing:
            raise LibraryError(f"{path}: no column '{missing[0]}'; 'fastmimic library verify --mend' makes it anew")
        return table

    def find(self, name: str) -> list[Row]:
        """Rows with this name, or with an id that begins with it; otherwise raises `LibraryError` with the closest
        names."""
        table = self.index_table()
        rows = table.select(["id", "name"]).to_pylist()
        found = [i for i, row in enumerate(rows) if row["name"] == name]
        found = found or [i for i, row in enumerate(rows) if row["id"].startswith(name)]
        if not found:
            raise LibraryError(
                f"{self.path}: no motion '{name}'{did_you_mean(name, {row['name'] for row in rows})}"
                f" ('fastmimic library list {self.path}')"
            )
        chosen: list[Row] = table.take(found).to_pylist()
        return chosen

    def motion(self, row: Row) -> Motion:
        """The motion of a row; raises `LibraryError` if the job failed, `MotionError` if the file is damaged."""
        if row["motion_file"] is None:
            raise LibraryError(f"'{row['name']}' on {row['robot']} has no motion: {row['lacks']}")
        return Motion.load(self.path / row["motion_file"])

    def _state(self) -> set[tuple[str, int]]:
        found = set()
        for path in (self.path / RECORDS).glob("*.json"):
            with suppress(FileNotFoundError):
                found.add((path.name, path.stat().st_mtime_ns))
        return found


@dataclass(frozen=True)
class DatasetHealth:
    """Result of `check`.

    Attributes:
        damaged: defects, one line each; a new build repairs them.
        useless: files of damaged records, relative to the library.
        foreign: files of no record that belongs to the library: of earlier recipes, changed sources, or killed
            builders.
        unreadable: the lines of `damaged` about the recipe, sources and robots.
        outdated: whether the index does not match the records.
    """

    records: int
    damaged: tuple[str, ...]
    useless: tuple[str, ...]
    foreign: tuple[str, ...]
    unreadable: tuple[str, ...]
    outdated: bool

    @property
    def sound(self) -> bool:
        """Whether there is no defect."""
        return not self.damaged and not self.outdated


def check(library: MotionDataset, progress: Callable[[int, int], None] | None = None) -> DatasetHealth:
    """Reads every file of a library and reports defects; calls `progress` with (files done, files in all)."""
    there = {f"{MOTIONS}/{path.name}" for path in (library.path / MOTIONS).glob("*")}
    plan = library.plan()
    found = gather(library.path, plan)
    damaged = [*plan.unreadable, *(f"{RECORDS}/{name}: not a whole record" for name in found.torn)]
    useless = [f"{RECORDS}/{name}" for name in found.torn]
    motions = found.column("motion_file")
    columns = (found.column(name) for name in ("id", "status", "motion_sha256"))
    for i, (identity, status, sha, motion) in enumerate(zip(*columns, motions, strict=True)):
        wrong = damage(library.path, {"motion_file": motion, "motion_sha256": sha, "status": status})
        if wrong is not None:
            damaged.append(f"{identity}: {wrong}")
            useless += [f"{RECORDS}/{identity}.json", *([motion] if motion is not None else [])]
        if progress is not None:
            progress(i + 1, len(motions))
    foreign = {*there.difference(motions), *(f"{RECORDS}/{old.id}.json" for old in found.superseded)}
    foreign |= {
        str(path.relative_to(library.path))
        for pattern in (f".{INDEX}.*", f".{SETTINGS}.*", *(f"{name}/.*.json.*" for name in (RECORDS, SOURCES, ROBOTS)))
        for path in library.path.glob(pattern)  # a killed `fastmimic.base.files.replace_file` left it
    }
    records = len(motions) + len(found.superseded) + len(found.torn)
    return DatasetHealth(
        records, tuple(damaged), tuple(useless), tuple(sorted(foreign)), plan.unreadable, _outdated(library, found)
    )


def _outdated(library: MotionDataset, found: Gathered) -> bool:
    try:
        return not found.table.equals(library.index_table().select(found.table.column_names))
    except LibraryError:
        return True


def reproducible(record: Record) -> Record:
    """The part of a record that every repetition reproduces, at any time and on any machine."""
    return {name: value for name, value in record.items() if name not in COSTS}
