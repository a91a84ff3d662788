"""A library on disk: its settings and files, reading and export.

    library.json            recipe: settings of its motions
    index.parquet           a row for each record, graded
    records/ID.json         a record
    motions/NAME-ID.npz     its motion
    sources/KEY.json        survey of a source
    robots/KEY.json         digest of a robot's description
    work/                   checkpoints; without them, jobs cannot resume
    .lock                   locked by who builds or repairs there now

Files are named by content and written atomically, so that any number of builders may share a folder, and the next one
repeats the work of a killed one. Every builder ends by making the index from the records, which hold all its data.
"""

import json
import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import Any, Final, TypeVar

import msgspec

from fastmimic.base.arrays import fingerprint
from fastmimic.base.configuration import check, parameter
from fastmimic.base.errors import ConfigError, LibraryError, OutputError, check_positive, did_you_mean
from fastmimic.base.files import check_folder, from_json, replace_file, write_text
from fastmimic.base.text import csv_text
from fastmimic.control.config import CONFIGS, controller_config
from fastmimic.dataset.excerpts import SOURCES, Excerpt, Survey
from fastmimic.dataset.index import COLUMNS, GRADED, RECORDS, Gathered, Membership, gather, read_record, require_pyarrow
from fastmimic.imitation.methods import METHODS, RL
from fastmimic.motion.export import DEFAULT_FPS, EXPORTS, export_motion
from fastmimic.motion.motion import Motion
from fastmimic.optimize.cma_es import CmaSettings
from fastmimic.optimize.parameters import FinalChoice, SearchSettings
from fastmimic.optimize.problem import Objective
from fastmimic.robot import load_robot
from fastmimic.runs.work_folder import lock
from fastmimic.simulation.conditions import other_ranges

SETTINGS: Final = "library.json"
INDEX: Final = "index.parquet"
ROBOTS: Final = "robots"
LOCK: Final = ".lock"
FORMAT_VERSION: Final = 1

LISTED: Final = "motions.csv"
_EXPORTED: Final = (
    *("file", "name", "robot", "seed", "gait", "footfall", "grade", "reward_mean", "period_s", "speed_m_per_s"),
    *("yaw_rate_rad_per_s", "source", "licence", "credit", "id"),
)
NEEDED: Final = (*_EXPORTED[1:], "robot_file", "motion_file", "lacks")  # columns of the index that an export needs

Row = dict[str, Any]


class DamagedError(LibraryError):
    """The recipe of a library cannot be read."""


@dataclass(frozen=True)
class BuildSettings(SearchSettings):
    """Settings of all jobs of a library.

    Attributes:
        config: name of the controller's parameters, or their file.
        duration_s: length of the search's episodes, s.
        evaluation_s: length of the evaluation's episodes, s.
        perturbed: number of evaluation episodes from perturbed starts.
        others: number of other robots in the evaluation, with floors, loads and motors from the usual ranges.
        second_simulator: whether to evaluate in `SECOND_SIMULATOR`, if it knows the robot.
        choice: how a search chooses its result.
    """

    method: str = "mbc-dmp"
    config: str = "default"
    duration_s: float = 5.0
    iterations: int | None = None
    population: int = 10
    evaluation_s: float = 10.0
    perturbed: int = parameter(8, low=1)
    others: int = parameter(16)
    second_simulator: bool = True
    choice: FinalChoice = FinalChoice()

    def __post_init__(self) -> None:
        if METHODS[self.method].name == RL:
            raise ConfigError("a library's motions are made by a model-based method; a policy is not one motion")
        controller_config(self.config)
        if self.config not in CONFIGS:  # an absolute path, valid in any process
            object.__setattr__(self, "config", str(Path(self.config).resolve()))
        CmaSettings(self.iterations, self.population)
        Objective(self.duration_s)
        check(self, "")
        check_positive(self.evaluation_s, "the length of an episode")

    @cached_property
    def digest(self) -> str:
        """16 hexadecimal digits of all settings, including the content of a parameter file."""
        config = self.config if self.config in CONFIGS else "a file"
        said = {**self.as_dict(), "config": config, "over": {r.name: [r.lower, r.upper] for r in other_ranges()}}
        return fingerprint({**self._search(), **said})

    @cached_property
    def search_digest(self) -> str:
        """Digest of a search's settings without its length: a longer search resumes a shorter one's checkpoint."""
        return fingerprint(self._search())

    def _search(self) -> dict[str, Any]:
        method = METHODS[self.method]
        return {
            "method": method.name,
            "parameters": method.parameters,
            "controller": method.configure(controller_config(self.config)).as_dict(),
            "objective": asdict(Objective(self.duration_s)),
            "population": self.population,
        }


@dataclass(frozen=True)
class MotionDataset:
    """The folder (`path`) of a library."""

    path: Path

    @classmethod
    def open(cls, path: str | Path) -> "MotionDataset":
        """Opens a library; `plan` reports damage. Raises `LibraryError` if there is none, or one of another format."""
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
        try:
            return msgspec.convert(said, BuildSettings) if said else None
        except msgspec.ValidationError as error:
            raise LibraryError(f"{self.path / SETTINGS}: not a recipe ({error})") from None

    def settings(self) -> dict[str, Any]:
        """The recipe as saved, empty if there is none; raises `LibraryError` if it cannot be read."""
        return dict(self._saved().get("recipe", {}))

    def recipe_digest(self) -> str | None:
        """The recipe's digest as saved, whatever changed in files since; raises `LibraryError` if it is unreadable."""
        return self._saved().get("digest")

    def _saved(self) -> dict[str, Any]:
        path = self.path / SETTINGS
        try:
            said: dict[str, Any] = from_json(path.read_text(encoding="utf-8"))
            if said["format_version"] != FORMAT_VERSION:
                found = f"{path}: format version {said['format_version']}"
                raise LibraryError(f"{found}; this release reads version {FORMAT_VERSION}")
            missing = ({"digest", *BuildSettings.__dataclass_fields__} ^ {"digest", *said["recipe"]}) - {"choice"}
            if missing or not isinstance(said["digest"], str):
                raise ValueError(f"not a recipe: {', '.join(sorted(missing)) or 'digest'}")
        except FileNotFoundError:
            return {}
        except (OSError, ValueError, TypeError, KeyError) as error:
            raise DamagedError(f"{path}: cannot be read ({error}); the next build like it repairs it") from None
        return said

    def save_recipe(self, recipe: BuildSettings) -> None:
        said = {"format_version": FORMAT_VERSION, "digest": recipe.digest, "recipe": recipe.as_dict()}
        write_text(self.path / SETTINGS, json.dumps(said, indent=1))

    def save_robot(self, robot: str, digest: str) -> None:
        """Saves the digest of a robot's description; raises `OutputError` if it cannot."""
        key = fingerprint(robot.encode())[:12]
        write_text(self.path / ROBOTS / f"{key}.json", json.dumps({"robot": robot, "digest": digest}, indent=1))

    def surveys(self) -> tuple[list[Survey], list[str]]:
        """The surveys of its sources, by source name, and a line for each damaged one."""
        found, unreadable = _load(self.path / SOURCES, Survey, "of its source")
        return sorted(found, key=lambda survey: (survey.source.name, survey.source.key)), unreadable

    def plan(self) -> Membership:
        """Which records belong to it; raises `LibraryError` for another format."""
        surveys, sources = self.surveys()
        robots, unreadable = _load(self.path / ROBOTS, _UsedRobot, "for its robot")
        try:
            recipe = self.recipe_digest()
        except DamagedError as error:
            recipe, unreadable = None, [str(error).removeprefix(f"{self.path}/"), *unreadable]
        pieces: dict[str, list[Excerpt]] = {}
        for survey in surveys:
            for piece in survey.pieces:
                pieces.setdefault(piece.digest, []).append(piece)
        problems = tuple(survey.problem for survey in surveys if survey.problem is not None)
        digests = {robot.robot: robot.digest for robot in robots}
        return Membership(recipe, digests, pieces, (*unreadable, *sources), not sources, problems)

    def holds(self, recipe: str) -> bool:
        """Whether it has no records, or one of the recipe with that digest."""
        paths = list((self.path / RECORDS).glob("*.json"))
        return not paths or any(record is not None and record["recipe"] == recipe for record in map(read_record, paths))

    def gathered(self, plan: Membership | None = None) -> Gathered:
        """All its records, including superseded ones, sorted by `plan`, its present one if None."""
        return gather(self.path, plan if plan is not None else self.plan())

    def write_index(self, *, settled: bool = True) -> Gathered:
        """Writes and returns the index of the existing records; with `settled`, at the end of a build, again until no
        other builder has finished a record meanwhile. Raises `LibraryError` if Arrow is not installed, `OutputError` if
        the index cannot be written."""
        parquet = require_pyarrow()
        while True:
            there = self._state()
            found = self.gathered()
            replace_file(self.path / INDEX, partial(parquet.write_table, found.table))
            if not settled or self._state() == there:
                return found

    def index(self, columns: Sequence[str] = ()) -> list[Row]:
        """Rows of the index, with all columns by default; raises `LibraryError` if it is missing or damaged."""
        return list(self.index_table(columns).to_pylist())

    def index_table(self, columns: Sequence[str] = ()) -> Any:
        """The index as an Arrow table; raises as `index`."""
        parquet = require_pyarrow()
        path = self.path / INDEX
        if not path.is_file():
            raise LibraryError(f"{path}: no index yet; 'fastmimic library build' makes it when it ends")
        try:
            there = parquet.read_schema(path).names
            table = parquet.read_table(path, columns=[name for name in columns if name in there] or None)
        except (OSError, ValueError) as error:
            damage = str(error).splitlines()[0]
            raise LibraryError(
                f"{path}: damaged ({damage}); 'fastmimic library verify --mend' makes it again"
            ) from None
        missing = [name for name in (columns or (*COLUMNS, *GRADED)) if name not in table.column_names]
        if missing:
            raise LibraryError(f"{path}: no column '{missing[0]}'; 'fastmimic library verify --mend' makes it again")
        return table

    def find(self, name: str) -> list[Row]:
        """Rows with this name, or an id that begins with it; raises `LibraryError` with the closest names for none."""
        table = self.index_table()
        rows = table.select(["id", "name"]).to_pylist()
        found = [i for i, row in enumerate(rows) if row["name"] == name]
        found = found or [i for i, row in enumerate(rows) if row["id"].startswith(name)]
        if not found:
            hint = did_you_mean(name, {row["name"] for row in rows})
            raise LibraryError(f"{self.path}: no motion '{name}'{hint} ('fastmimic library list {self.path}')")
        return list(table.take(found).to_pylist())

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


@contextmanager
def working(folder: Path, *, alone: bool) -> Iterator[None]:
    """Keeps repairs out of a library while it is built, by any number of builders, or all others out during a repair,
    which works `alone`. Raises `LibraryError` if those work there, `OutputError` if the folder cannot be written to."""
    check_folder(folder)
    try:
        handle = os.open(folder / LOCK, os.O_RDWR | os.O_CREAT, 0o666)  # network file systems lock files, not folders
    except OSError as error:
        raise OutputError(f"{folder / LOCK}: cannot be written ({error.strerror or error})") from None
    try:
        if not lock(handle, shared=not alone):
            if alone and lock(handle, shared=True):
                said = "is being built now, and would lose what that has begun"
                raise LibraryError(f"{folder}: {said}; repair it when that has ended")
            raise LibraryError(f"{folder}: is being repaired now; try again when that has ended")
        yield
    finally:
        os.close(handle)


@dataclass(frozen=True)
class _UsedRobot:
    robot: str
    digest: str


_Kind = TypeVar("_Kind")


def _load(folder: Path, kind: type[_Kind], which: str) -> tuple[list[_Kind], list[str]]:
    """What is in the files of a folder, and the unreadable ones, one line each; the next build `which` repairs them."""
    found, unreadable = [], []
    for path in sorted(folder.glob("*.json")):
        try:
            found.append(msgspec.json.decode(path.read_bytes(), type=kind))
        except FileNotFoundError:  # another builder has removed it meanwhile
            continue
        except (OSError, ValueError, RecursionError) as error:
            unreadable.append(f"{folder.name}/{path.name}: cannot be read ({error}); the next build {which} repairs it")
    return found, unreadable


def export_library(
    library: MotionDataset,
    rows: Sequence[Row],
    folder: str | Path,
    form: str,
    *,
    fps: float = DEFAULT_FPS,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> Path:
    """Writes motions as `fastmimic.motion.export` does, and a table of them; returns the table's file. The rows of the
    index have the columns `NEEDED`, and each a motion; `form` is one of `EXPORTS`. Calls `progress` with (files done,
    files in all). Raises `FastMimicError` for a folder within the library, an unknown format, a damaged motion, or a
    file that cannot be written."""
    if Path(folder).resolve().is_relative_to(library.path.resolve()):
        said = "is in the library, whose own motions would be overwritten"
        raise LibraryError(f"{folder}: {said}; choose another folder")
    listed = []
    for i, row in enumerate(rows):
        motion = library.motion(row)
        name = Path(row["motion_file"]).with_suffix(EXPORTS.get(form, "")).name
        export_motion(motion, load_robot(row["robot_file"] or row["robot"]), Path(folder) / name, form, fps=fps)
        listed.append({**row, "file": name})
        progress(i + 1, len(rows))
    path = Path(folder) / LISTED
    write_text(path, csv_text(_EXPORTED, listed))
    return path
