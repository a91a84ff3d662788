"""The index of a library: all records that belong to it, graded, as a table.

Records stay when their inputs change. A record belongs to a library if it has its recipe, an excerpt of a source, and
the robot's present description; among those that differ only in their start, the last one belongs. Records are read one
by one into columns: as Python objects, a hundred thousand would take a gigabyte.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from sys import intern
from typing import TYPE_CHECKING, Any, Final

from fastmimic.base.errors import LibraryError
from fastmimic.dataset.excerpts import Excerpt
from fastmimic.dataset.records import COLUMNS, KEPT, RANKS, RECORDS, Record, grade, read_record

if TYPE_CHECKING:
    import pyarrow

Search = tuple[str, str, int, str, str]  # the same for records that differ only in their start

GRADED: Final = {"grade": str, "lacks": str, "kept": bool, "best": bool}
"""Further columns of the index: grade, the reason it is not better, whether the motion is kept, and whether it is the
best of its excerpt and robot."""
_CHUNK: Final = 2048


def require_pyarrow() -> Any:
    """Arrow's Parquet module; raises `LibraryError` with instructions if it is not installed."""
    try:
        import pyarrow.parquet
    except ImportError:
        raise LibraryError("Parquet files need Arrow: pip install 'fastmimic[library]'") from None
    return pyarrow.parquet


@dataclass(frozen=True)
class Superseded:
    """A record that no longer belongs to the library, `why`, and the later record of the same search, if any
    (`instead`)."""

    id: str
    name: str
    robot: str
    seed: int
    why: str
    instead: str | None = None


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

    table: "pyarrow.Table"  # those that belong to it, with `COLUMNS` and `GRADED`, sorted by name, robot, seed and id
    superseded: list[Superseded]  # the others
    torn: list[str]  # names of files without a whole record


@dataclass(frozen=True, slots=True)
class _Brief:
    """The part of a record that sorting and the choice among several need; the greatest `rank` is the best."""

    search: Search
    finished: str
    order: tuple[str, str, int, str]
    rank: tuple[int, float]
    kept: bool

    @classmethod
    def of(cls, row: Record, reached: str) -> "_Brief":
        robot, digest, recipe = (intern(said) for said in (robot_of(row), row["robot_digest"], row["recipe"]))
        search = (row["piece"], robot, row["seed"], digest, recipe)
        order = (row["name"], row["robot"], row["seed"], row["id"])
        rank = (RANKS.index(reached), row["reward_mean_perturbed"] or 0.0)
        return cls(search, row["finished"] or "", order, rank, reached in KEPT)


def gather(folder: Path, plan: Membership) -> Gathered:
    """Reads all records of a library, and grades those that belong to it; raises `LibraryError` without Arrow."""
    require_pyarrow()
    import pyarrow

    kinds = {name: kind for name, kind in (COLUMNS | GRADED).items() if name != "best"}  # which is known at the end
    types = {str: pyarrow.string(), int: pyarrow.int64(), float: pyarrow.float64(), bool: pyarrow.bool_()}
    schema = pyarrow.schema([(name, types[kind]) for name, kind in kinds.items()])
    briefs: list[_Brief] = []
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
                briefs.append(_Brief.of(row, reached))
                row |= {"grade": reached, "lacks": lacks or None, "kept": reached in KEPT}
                yield {name: None if row[name] is None else kind(row[name]) for name, kind in kinds.items()}

    found, batches = belonging(), []
    while chunk := list(islice(found, _CHUNK)):
        batches.append(pyarrow.RecordBatch.from_pylist(chunk, schema=schema))
    rows, best = _chosen(briefs, superseded)
    table = pyarrow.Table.from_batches(batches, schema=schema).take(pyarrow.array(rows, pyarrow.int64()))
    return Gathered(table.append_column("best", pyarrow.array(best, pyarrow.bool_())), superseded, torn)


def _chosen(briefs: Sequence[_Brief], superseded: list[Superseded]) -> tuple[list[int], list[bool]]:
    """The last of each search, as sorted indices, and whether each is the best of its excerpt and robot; adds the
    others to `superseded`."""
    last: dict[Search, int] = {}
    for i, brief in enumerate(briefs):
        there = last.setdefault(brief.search, i)
        if (brief.finished, brief.order[3]) > (briefs[there].finished, briefs[there].order[3]):
            last[brief.search] = i
    for i, brief in enumerate(briefs):
        if (instead := last[brief.search]) != i:
            name, _, seed, identity = brief.order
            later = briefs[instead].order[3]
            why = f"begun otherwise; instead of it there is {later}"
            superseded.append(Superseded(identity, name, brief.search[1], seed, why, later))
    best: dict[tuple[str, str], int] = {}
    for i in sorted(last.values()):  # by id
        there = best.setdefault(briefs[i].search[:2], i)
        if briefs[i].rank > briefs[there].rank:
            best[briefs[i].search[:2]] = i
    rows = sorted(last.values(), key=lambda i: briefs[i].order)
    chosen = set(best.values())
    return rows, [i in chosen and briefs[i].kept for i in rows]
