"""The records of motions (description, source, figures, and the motion's file), their grades, and the index of a
library: all records that belong to it, graded, as a table.

Records keep only figures; grades are computed on demand by one table, so that other thresholds need no new run. Records
stay when their inputs change. A record belongs to a library if it has its recipe, an excerpt of a source, and the
robot's present description; among those that differ only in their start, the last one belongs. Records are read one by
one into columns: as Python objects, a hundred thousand would take a gigabyte.
"""

import hashlib
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any, Final

from fastmimic.base.errors import LibraryError
from fastmimic.base.files import from_json, packaged, write_text
from fastmimic.base.machine import optional
from fastmimic.dataset.excerpts import Excerpt

Record = dict[str, Any]

RECORDS: Final = "records"
MOTIONS: Final = "motions"

DONE: Final = "done"
FAILED: Final = "failed"

_TYPES: Final = {"text": str, "whole": int, "number": float, "truth": bool}
_GROUPS: Final = {
    group: {name: _TYPES[kind] for name, kind in columns.items()}
    for group, columns in packaged("fastmimic.dataset", "columns.json", dict[str, dict[str, str]]).items()
}
FIGURES: Final = _GROUPS["figures"]
"""Columns of a finished motion; figures of episodes have the names of `Metrics`, of the nominal episode where a name
says no more. `limits_exceeded` is from `fastmimic.episode.feasibility.reasons`."""
COSTS: Final = _GROUPS["costs"]  # differ between repetitions
COLUMNS: Final[dict[str, type]] = {**_GROUPS["identity"], **FIGURES, **COSTS}
"""Name → type. A record has a value or None in each. `source` is a record's place, `piece` the digest of the excerpt's
content, `robot_file` a user's MJCF, `robot_digest` that of the robot's description, `reason` that of a failure."""
_KINDS: Final[dict[type, Any]] = {str: str, int: int, float: (int, float), bool: (bool, int, float)}  # as JSON has them
_NEEDED: Final = ("name", "piece", "robot", "robot_digest", "seed", "recipe", "status")


def sha256(path: Path) -> str:
    """Digest of a file's content; raises `OSError`."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def record_file(folder: Path, identity: str) -> Path:
    """A record's file in a library."""
    return folder / RECORDS / f"{identity}.json"


def save_record(folder: Path, record: Mapping[str, Any]) -> None:
    """Writes a record, after its motion; raises `OutputError` if it cannot."""
    write_text(record_file(folder, record["id"]), json.dumps(record, indent=1, allow_nan=False))


def load_record(folder: Path, identity: str) -> Record | None:
    """A record, or None unless it and its motion are intact. A new build repairs damaged or changed ones."""
    return None if (found := read_record(record_file(folder, identity))) is None or damage(folder, found) else found


def read_record(path: Path) -> Record | None:
    """The record in a file; None if there is none."""
    try:
        found = from_json(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    if not isinstance(found, dict) or found.keys() != COLUMNS.keys() or found.get("id") != path.stem:
        return None
    whole = all(value is None or isinstance(value, _KINDS[COLUMNS[name]]) for name, value in found.items())
    return found if whole and all(found[name] is not None for name in _NEEDED) else None


def damage(folder: Path, record: Mapping[str, Any]) -> str | None:
    """The defect of a record's motion; None if it is intact."""
    name = record["motion_file"]
    if name is None:
        return None if record["status"] == FAILED else "it names no motion"
    try:
        return None if sha256(folder / name) == record["motion_sha256"] else f"{name} is not what was written"
    except OSError as error:
        return f"{name}: {error.strerror or error}"


REJECTED: Final = "rejected"
FAILURE: Final = "failed"


@dataclass(frozen=True)
class Demand:
    """Inclusive bounds on a figure."""

    figure: str  # of the record; ignored if the record lacks it, because it was not evaluated
    least: float | None = None
    most: float | None = None
    says: str = ""
    numbered: bool = True  # whether a violation states the figure and its bound

    def unmet(self, record: Mapping[str, Any]) -> str | None:
        """The violation in words; None if the record meets the demand."""
        value = record[self.figure]
        if value is None:
            return None
        if self.least is not None and value < self.least:
            return f"{self.says} {value:.3g}, below {self.least:g}"
        if self.most is not None and value > self.most:
            return f"{self.says} {value:.3g}, above {self.most:g}" if self.numbered else self.says
        return None


GRADES: Final = packaged("fastmimic.dataset", "grades.json", dict[str, tuple[Demand, ...]])
"""From the best grade to the lowest; a grade includes the demands of those below it."""
RANKS: Final = (FAILURE, REJECTED, *reversed(GRADES))


def grade(record: Mapping[str, Any]) -> tuple[str, str]:
    """The grade of a record (`GRADES`, `REJECTED` or `FAILURE`), and why it is not better; empty for the best."""
    if record["status"] == FAILED:
        return FAILURE, str(record["reason"])
    reached, lacks = REJECTED, ""
    for name, demands in reversed(GRADES.items()):
        unmet = [said for demand in demands if (said := demand.unmet(record)) is not None]
        if unmet:
            lacks = "; ".join(unmet)
            break
        reached = name
    if reached == REJECTED and record["limits_exceeded"]:
        lacks += f" ({record['limits_exceeded']})"
    return reached, lacks


GRADED: Final = {"grade": str, "lacks": str, "kept": bool, "best": bool}
"""Further columns: the grade, why it is not better, whether the motion is kept, and if it is its excerpt's best."""
_CHUNK: Final = 2048
_CHOSEN_BY: Final = (*("id", "name", "robot", "robot_file", "seed", "piece", "grade", "kept", "reward_mean_perturbed"),)


def require_pyarrow() -> Any:
    """Arrow's Parquet module; raises `LibraryError` with instructions if it is not installed."""
    return optional("pyarrow.parquet", LibraryError("Parquet files need Arrow: pip install 'fastmimic[library]'"))


@dataclass(frozen=True)
class Superseded:
    """A record that no longer belongs to the library, and `why`."""

    id: str
    name: str
    robot: str
    seed: int
    why: str


@dataclass(frozen=True, eq=False)
class Membership:
    """The inputs that decide which records belong to a library."""

    recipe: str | None  # digest of the recipe; None if it cannot be read
    robots: Mapping[str, str]  # digests of robots' descriptions, by name or file
    pieces: Mapping[str, Sequence[Excerpt]]  # excerpts of all sources, by digest
    unreadable: tuple[str, ...]  # damaged files of these, one line each; records that may depend on them are kept
    sources_known: bool  # whether no source's file is damaged
    problems: tuple[str, ...]  # why sources have no excerpts, one line each

    def why_not(self, record: Mapping[str, Any]) -> str | None:
        """Why a record does not belong to the library; None if it does."""
        if self.recipe is not None and record["recipe"] != self.recipe:
            return "made otherwise"
        if self.sources_known and record["piece"] not in self.pieces:
            return "its source has changed or is gone"
        if self.robots.get(robot_of(record), record["robot_digest"]) != record["robot_digest"]:
            return "its robot has changed"
        return None

    def described(self, record: Record) -> Record:
        """The record with the excerpt's present description: the source or licence of the same content may change."""
        there = self.pieces.get(record["piece"])
        if there is None:
            return record
        own = (piece for piece in there if (piece.source.place, piece.name) == (record["source"], record["name"]))
        return record | next(own, there[0]).described


def robot_of(record: Mapping[str, Any]) -> str:
    """A record's robot: its name, or its file."""
    return str(record["robot_file"] or record["robot"])


@dataclass(frozen=True, eq=False)
class Gathered:
    """All records of a library."""

    table: Any  # Arrow's, of those that belong to it: `COLUMNS` and `GRADED`, sorted by name, robot, seed and id
    superseded: list[Superseded]  # the others
    torn: list[str]  # names of files without a whole record


def gather(folder: Path, plan: Membership) -> Gathered:
    """Reads all records of a library, and grades those that belong to it; raises `LibraryError` without Arrow."""
    require_pyarrow()
    import pyarrow

    kinds = {name: kind for name, kind in (COLUMNS | GRADED).items() if name != "best"}  # which is known at the end
    types = {str: pyarrow.string(), int: pyarrow.int64(), float: pyarrow.float64(), bool: pyarrow.bool_()}
    schema = pyarrow.schema([(name, types[kind]) for name, kind in kinds.items()])
    superseded: list[Superseded] = []
    torn: list[str] = []

    def belonging() -> Iterator[dict[str, Any]]:
        for path in sorted((folder / RECORDS).glob("*.json")):
            record = read_record(path)
            if record is None:
                torn.append(path.name)
            elif (why := plan.why_not(record)) is not None:
                superseded.append(Superseded(record["id"], record["name"], robot_of(record), record["seed"], why))
            else:
                row = plan.described(record)
                reached, lacks = grade(row)
                row |= {"grade": reached, "lacks": lacks or None, "kept": reached in GRADES}
                yield {name: None if row[name] is None else kind(row[name]) for name, kind in kinds.items()}

    found, batches = belonging(), []
    while chunk := list(islice(found, _CHUNK)):
        batches.append(pyarrow.RecordBatch.from_pylist(chunk, schema=schema))
    table = pyarrow.Table.from_batches(batches, schema=schema)
    rows, best = _sorted(table.select(_CHOSEN_BY).to_pylist())
    table = table.take(pyarrow.array(rows, pyarrow.int64()))
    return Gathered(table.append_column("best", pyarrow.array(best, pyarrow.bool_())), superseded, torn)


def _sorted(rows: Sequence[Record]) -> tuple[list[int], list[bool]]:
    """Indices of the rows, which are by id, as they are sorted, and whether each is the best of its excerpt and robot;
    of equally good ones the first by id is."""
    by_rank = sorted(
        reversed(range(len(rows))),
        key=lambda i: (RANKS.index(rows[i]["grade"]), rows[i]["reward_mean_perturbed"] or 0.0),
    )
    best = {(rows[i]["piece"], robot_of(rows[i])): i for i in by_rank}
    found = sorted(range(len(rows)), key=lambda i: [rows[i][name] for name in ("name", "robot", "seed", "id")])
    chosen = set(best.values())
    return found, [i in chosen and rows[i]["kept"] for i in found]
