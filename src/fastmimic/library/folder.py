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

import hashlib
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from fastmimic.errors import LibraryError, did_you_mean
from fastmimic.files import replace_file
from fastmimic.library.grades import KEPT, grade, rank
from fastmimic.library.pieces import Piece, Survey, load_surveys
from fastmimic.library.recipe import Recipe
from fastmimic.library.records import COLUMNS, COSTS, MOTIONS, RECORDS, Record, damage, read_record
from fastmimic.motion.motion import Motion

if TYPE_CHECKING:
    import pyarrow

SETTINGS: Final = "library.json"
INDEX: Final = "index.parquet"
ROBOTS: Final = "robots"
FORMAT_VERSION: Final = 1

Row = dict[str, Any]

GRADED: Final = {"grade": str, "lacks": str, "kept": bool, "best": bool}
"""What a row of the index has besides the record: its grade, what it lacks for a better one, whether it is kept, and
whether it is the best of its piece and robot."""


def robot_of(record: Mapping[str, Any]) -> str:
    """Which robot a record is about: its name, or its file."""
    return str(record["robot_file"] or record["robot"])


def require_pyarrow() -> Any:
    """Arrow's module for Parquet; raises `LibraryError` with what to do if it is not installed."""
    try:
        import pyarrow.parquet
    except ImportError:
        raise LibraryError("a library's index needs Arrow: pip install 'fastmimic[library]'") from None
    return pyarrow.parquet


@dataclass(frozen=True)
class Library:
    """A folder with a library.

    Attributes:
        path: the folder.
    """

    path: Path

    @classmethod
    def open(cls, path: str | Path) -> "Library":
        """An existing one.

        Raises:
            LibraryError: there is none, or it is of another format.
        """
        library = cls(Path(path))
        if not (library.path / SETTINGS).is_file():
            raise LibraryError(f"{path}: no library there; 'fastmimic library build SOURCES --out {path}' makes one")
        library.recipe_digest()  # the format is checked
        return library

    def recipe(self) -> Recipe | None:
        """How its motions are made; None if it is not begun.

        Raises:
            LibraryError: it cannot be read.
            ConfigError: the file of the controller's parameters is not there any more.
        """
        said = self.settings()
        return Recipe(**said) if said else None

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
            missing = {"digest", *Recipe.__dataclass_fields__} ^ {"digest", *said["recipe"]}
            if missing or not isinstance(said["digest"], str):
                raise ValueError(f"not a recipe: {', '.join(sorted(missing)) or 'digest'}")
        except FileNotFoundError:
            return None
        except (OSError, ValueError, TypeError, KeyError) as error:
            raise LibraryError(f"{path}: cannot be read ({error}); build with --update to write it anew") from None
        return said

    def save_recipe(self, recipe: Recipe) -> None:
        """Writes it; raises `OutputError` if it cannot."""
        text = json.dumps(
            {"format_version": FORMAT_VERSION, "digest": recipe.digest, "recipe": asdict(recipe)}, indent=1
        )
        replace_file(self.path / SETTINGS, lambda file: file.write(text.encode()))

    def robots(self) -> dict[str, str]:
        """The digests of its robots' descriptions when they were last built for, by name or file.

        Raises:
            LibraryError: a file cannot be read.
        """
        found = {}
        for path in (self.path / ROBOTS).glob("*.json"):
            try:
                said = json.loads(path.read_text(encoding="utf-8"))
                found[str(said["robot"])] = str(said["digest"])
            except (OSError, ValueError, TypeError, KeyError) as error:
                raise LibraryError(f"{path}: cannot be read ({error}); remove it and build again") from None
        return found

    def save_robot(self, robot: str, digest: str) -> None:
        """Keeps the digest of a robot's description; raises `OutputError` if it cannot."""
        text = json.dumps({"robot": robot, "digest": digest}, indent=1)
        key = hashlib.sha256(robot.encode()).hexdigest()[:12]
        replace_file(self.path / ROBOTS / f"{key}.json", lambda file: file.write(text.encode()))

    def surveys(self) -> list[Survey]:
        """What was found in its sources; raises `LibraryError`."""
        return load_surveys(self.path)

    def records(self) -> Iterator[Record]:
        """The records that belong to it now: of its recipe, its robots, and pieces that its sources have.

        A record of an earlier recipe, or of a source or a robot that has changed, stays in the folder and is nobody's.
        What a record says of its piece is as the source has it now: the same content may be found elsewhere, or under
        another licence.

        Raises:
            LibraryError: what it is made of cannot be read.
        """
        recipe = self.recipe_digest()
        robots = self.robots()
        pieces: dict[str, list[Piece]] = {}
        for survey in self.surveys():
            for piece in survey.pieces:
                pieces.setdefault(piece.digest, []).append(piece)
        for path in sorted((self.path / RECORDS).glob("*.json")):
            record = read_record(path)
            if record is None or record["recipe"] != recipe or record["piece"] not in pieces:
                continue
            if robots.get(robot_of(record), record["robot_digest"]) != record["robot_digest"]:
                continue
            there = pieces[record["piece"]]
            own = (piece for piece in there if (piece.source.place, piece.name) == (record["source"], record["name"]))
            yield record | next(own, there[0]).described

    def graded(self) -> list[Row]:
        """The rows of the index, by name, robot and seed."""
        rows = []
        for record in self.records():
            reached, lacks = grade(record)
            rows.append({**record, "grade": reached, "lacks": lacks or None, "kept": reached in KEPT, "best": False})
        best: dict[tuple[str, str], Row] = {}
        for row in rows:
            key = (row["piece"], robot_of(row))
            if key not in best or rank(row) > rank(best[key]):
                best[key] = row
        for row in best.values():
            row["best"] = row["kept"]
        return sorted(rows, key=lambda row: (row["name"], row["robot"], row["seed"], row["id"]))

    def write_index(self, *, settled: bool = True) -> list[Row]:
        """Makes the index of what is there; its rows.

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
            rows = self.graded()
            table = _table(rows)
            replace_file(self.path / INDEX, lambda file, table=table: parquet.write_table(table, file))  # type: ignore[misc]
            if not settled or self._state() == there:
                return rows

    def index(self) -> list[Row]:
        """The rows of the index.

        Raises:
            LibraryError: there is none, or it is damaged.
        """
        parquet = require_pyarrow()
        path = self.path / INDEX
        if not path.is_file():
            raise LibraryError(f"{path}: no index yet; 'fastmimic library build' makes it when it ends")
        try:
            table = parquet.read_table(path)
        except (OSError, ValueError) as error:
            raise LibraryError(
                f"{path}: damaged ({str(error).splitlines()[0]}); 'fastmimic library verify --mend' makes it anew"
            ) from None
        missing = [name for name in (*COLUMNS, *GRADED) if name not in table.column_names]
        if missing:
            raise LibraryError(f"{path}: no column '{missing[0]}'; 'fastmimic library verify --mend' makes it anew")
        rows: list[Row] = table.to_pylist()
        return rows

    def find(self, name: str) -> list[Row]:
        """The rows whose id begins with `name`, or whose name it is.

        Raises:
            LibraryError: there are none; the closest names are listed.
        """
        rows = self.index()
        found = [row for row in rows if row["name"] == name] or [row for row in rows if row["id"].startswith(name)]
        if not found:
            raise LibraryError(
                f"{self.path}: no motion '{name}'{did_you_mean(name, {row['name'] for row in rows})}"
                f" ('fastmimic library list {self.path}')"
            )
        return found

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
class Health:
    """What `check` found.

    Attributes:
        records: how many were looked at.
        damaged: what is wrong, a line each; to build again mends it.
        useless: the files of what is damaged, relative to the library.
        foreign: files that belong to no record: of earlier recipes, changed sources, or killed builders.
        outdated: whether the index is not of these records.
    """

    records: int
    damaged: tuple[str, ...]
    useless: tuple[str, ...]
    foreign: tuple[str, ...]
    outdated: bool

    @property
    def sound(self) -> bool:
        """Whether nothing is wrong."""
        return not self.damaged and not self.outdated


def check(library: Library, progress: Callable[[int, int], None] | None = None) -> Health:
    """Reads everything in a library, and says what is wrong.

    Args:
        library: the library.
        progress: called with (files done, files in all).
    """
    paths = sorted((library.path / RECORDS).glob("*.json"))
    current = {record["id"] for record in library.records()}
    damaged, useless, known = [], [], set()
    for i, path in enumerate(paths):
        record = read_record(path)
        if record is None:
            damaged.append(f"{RECORDS}/{path.name}: not a whole record")
            useless.append(f"{RECORDS}/{path.name}")
        elif record["id"] in current:
            known.add(record["motion_file"])
            wrong = damage(library.path, record)
            if wrong is not None:
                damaged.append(f"{record['id']}: {wrong}")
                useless += [f"{RECORDS}/{path.name}", *([record["motion_file"]] if record["motion_file"] else [])]
        if progress is not None:
            progress(i + 1, len(paths))
    motions = {f"{MOTIONS}/{path.name}" for path in (library.path / MOTIONS).glob("*")}
    foreign = sorted(motions - known) + sorted(
        f"{RECORDS}/{path.name}"
        for path in paths
        if path.stem not in current and f"{RECORDS}/{path.name}" not in useless
    )
    return Health(len(paths), tuple(damaged), tuple(useless), tuple(foreign), _outdated(library))


def _outdated(library: Library) -> bool:
    try:
        rows = library.index()
    except LibraryError:
        return True
    return [_compared(row) for row in rows] != [_compared(row) for row in library.graded()]


def _compared(row: Row) -> Row:
    return {name: row[name] for name in (*COLUMNS, *GRADED)}


def reproducible(record: Record) -> Record:
    """The part of a record that is the same whenever, wherever and by whomever it is made."""
    return {name: value for name, value in record.items() if name not in COSTS}


def _table(rows: Sequence[Row]) -> "pyarrow.Table":
    import pyarrow

    types = {str: pyarrow.string(), int: pyarrow.int64(), float: pyarrow.float64(), bool: pyarrow.bool_()}
    columns = {**COLUMNS, **GRADED}
    schema = pyarrow.schema([(name, types[kind]) for name, kind in columns.items()])
    converted = [
        {name: None if row[name] is None else kind(row[name]) for name, kind in columns.items()} for row in rows
    ]
    return pyarrow.Table.from_pylist(converted, schema=schema)
