"""A library on disk.

    library.json            how its motions are made
    index.parquet           a row for each record, graded
    records/ID.json         a record
    motions/NAME-ID.npz     its motion
    sources/KEY.json        what was found in a source
    robots/KEY.json         which description of a robot counts
    work/                   checkpoints; may be removed, and then nothing goes on from them

Everything is named by its content and written whole or not at all, so that any number of builders may work in one
folder, and what one of them was killed over is done again by the next. The index is made of the records whenever a
builder ends; it is never the only place of anything.
"""

import json
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
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

if TYPE_CHECKING:
    import pyarrow

SETTINGS: Final = "library.json"
INDEX: Final = "index.parquet"
FORMAT_VERSION: Final = 1

Row = dict[str, Any]


class DamagedError(LibraryError):
    """A library whose recipe cannot be read."""


@dataclass(frozen=True)
class MotionDataset:
    """A folder with a library.

    Attributes:
        path: the folder.
    """

    path: Path

    @classmethod
    def open(cls, path: str | Path) -> "MotionDataset":
        """An existing one. What of it is damaged, `plan` tells.

        Raises:
            LibraryError: there is none, or it is of another format.
        """
        library = cls(Path(path))
        if not (library.path / SETTINGS).is_file():
            raise LibraryError(f"{path}: no library there; 'fastmimic library build SOURCES --out {path}' makes one")
        with suppress(DamagedError):
            library.recipe_digest()  # the format is checked
        return library

    def recipe(self) -> BuildSettings | None:
        """How its motions are made; None if it is not begun.

        Raises:
            LibraryError: it cannot be read.
            ConfigError: the file of the controller's parameters is not there any more.
        """
        said = self.settings()
        return BuildSettings(**said) if said else None

    def settings(self) -> dict[str, Any]:
        """The recipe as it is written down, empty if there is none; raises `LibraryError` if it cannot be read."""
        said = self._settings()
        return {} if said is None else dict(said["recipe"])

    def recipe_digest(self) -> str | None:
        """Of how its motions are made, at the time when they were, whatever has become of a configuration's file.

        Raises:
            LibraryError: it cannot be read.
        """
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
            missing = {"digest", *BuildSettings.__dataclass_fields__} ^ {"digest", *said["recipe"]}
            if missing or not isinstance(said["digest"], str):
                raise ValueError(f"not a recipe: {', '.join(sorted(missing)) or 'digest'}")
        except FileNotFoundError:
            return None
        except (OSError, ValueError, TypeError, KeyError) as error:
            raise DamagedError(f"{path}: cannot be read ({error}); the next build like it mends it") from None
        return said

    def save_recipe(self, recipe: BuildSettings) -> None:
        """Writes it; raises `OutputError` if it cannot."""
        text = json.dumps(
            {"format_version": FORMAT_VERSION, "digest": recipe.digest, "recipe": asdict(recipe)}, indent=1
        )
        write_text(self.path / SETTINGS, text)

    def save_robot(self, robot: str, digest: str) -> None:
        """Keeps the digest of a robot's description; raises `OutputError` if it cannot."""
        save_robot(self.path, robot, digest)

    def surveys(self) -> list[Survey]:
        """What was found in its sources, but for those whose file is damaged."""
        return load_surveys(self.path)[0]

    def plan(self) -> Membership:
        """What it is to hold; raises `LibraryError` if it is of another format."""
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
        """Of all records that are there, whether they belong to it or not."""
        return {path.stem for path in (self.path / RECORDS).glob("*.json")}

    def holds(self, recipe: str) -> bool:
        """Whether any of its records is of the recipe with that digest, or it has none."""
        paths = list((self.path / RECORDS).glob("*.json"))
        return not paths or any(record is not None and record["recipe"] == recipe for record in map(read_record, paths))

    def gathered(self) -> Gathered:
        """All its records, those that belong to it and those that do not any more."""
        return gather(self.path, self.plan())

    def write_index(self, *, settled: bool = True) -> Gathered:
        """Makes the index of what is there; that.

        Args:
            settled: whether to make it again until no other builder has finished anything meanwhile: for one that ends,
                as another may have ended while this one wrote. While jobs run, there is always something.

        Raises:
            LibraryError: Arrow is not installed.
            OutputError: it cannot be written.
        """
        parquet = require_pyarrow()
        while True:
            there = self._state()
            found = self.gathered()
            replace_file(self.path / INDEX, partial(parquet.write_table, found.table))
            if not settled or self._state() == there:
                return found

    def index(self, columns: Sequence[str] = ()) -> list[Row]:
        """The rows of the index.

        Args:
            columns: those that are wanted; all if empty, which are many for a large library.

        Raises:
            LibraryError: there is none, or it is damaged.
        """
        rows: list[Row] = self.index_table(columns).to_pylist()
        return rows

    def index_table(self, columns: Sequence[str] = ()) -> "pyarrow.Table":
        """The same as Arrow's table; raises as `index`."""
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
        """The rows whose id begins with `name`, or whose name it is.

        Raises:
            LibraryError: there are none; the closest names are listed.
        """
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
        """The motion of a row.

        Raises:
            LibraryError: it could not be made.
            MotionError: its file is damaged.
        """
        if row["motion_file"] is None:
            raise LibraryError(f"'{row['name']}' on {row['robot']} has no motion: {row['lacks']}")
        return Motion.load(self.path / row["motion_file"])

    def _state(self) -> set[tuple[str, int]]:
        """The records' files with their times of writing."""
        found = set()
        for path in (self.path / RECORDS).glob("*.json"):
            with suppress(FileNotFoundError):
                found.add((path.name, path.stat().st_mtime_ns))
        return found


@dataclass(frozen=True)
class DatasetHealth:
    """What `check` found.

    Attributes:
        records: how many were looked at.
        damaged: what is wrong, a line each; to build again mends it.
        useless: the files of damaged records, relative to the library.
        foreign: files of no record that belongs to it: of earlier recipes, changed sources, or killed builders.
        unreadable: the lines of `damaged` about files that say what the library is made of.
        outdated: whether the index is not of these records.
    """

    records: int
    damaged: tuple[str, ...]
    useless: tuple[str, ...]
    foreign: tuple[str, ...]
    unreadable: tuple[str, ...]
    outdated: bool

    @property
    def sound(self) -> bool:
        """Whether nothing is wrong."""
        return not self.damaged and not self.outdated


def check(library: MotionDataset, progress: Callable[[int, int], None] | None = None) -> DatasetHealth:
    """Reads everything in a library, and says what is wrong.

    Args:
        library: the library.
        progress: called with (files done, files in all).
    """
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
        for path in library.path.glob(pattern)  # `fastmimic.base.files.replace_file` was killed
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
    """The part of a record that is the same whenever, wherever and by whomever it is made."""
    return {name: value for name, value in record.items() if name not in COSTS}
