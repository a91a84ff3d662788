"""The index of a library: all records that belong to it, graded, as a table.

Records are read one by one into columns: as Python objects, a hundred thousand would take a gigabyte.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from fastmimic.base.errors import LibraryError
from fastmimic.dataset.grades import KEPT, grade, rank
from fastmimic.dataset.membership import Membership, Search, Superseded, robot_of, search_of
from fastmimic.dataset.records import COLUMNS, RECORDS, read_record

if TYPE_CHECKING:
    import pyarrow

GRADED: Final = {"grade": str, "lacks": str, "kept": bool, "best": bool}
"""Further columns of the index: grade, the reason it is not better, whether the motion is kept, and whether it is the
best of its excerpt and robot."""
_CHUNK: Final = 2048


def require_pyarrow() -> Any:
    """Arrow's Parquet module; raises `LibraryError` with instructions if it is not installed."""
    try:
        import pyarrow.parquet
    except ImportError:
        raise LibraryError("a library's index needs Arrow: pip install 'fastmimic[library]'") from None
    return pyarrow.parquet


@dataclass(frozen=True, eq=False)
class Gathered:
    """All records of a library.

    Attributes:
        table: those that belong to it, with `COLUMNS` and `GRADED`, sorted by name, robot, seed and id.
        superseded: the others.
        torn: names of files without a whole record.
    """

    table: "pyarrow.Table"
    superseded: list[Superseded]
    torn: list[str]

    def column(self, name: str) -> list[Any]:
        """Values of a column of the table."""
        values: list[Any] = self.table.column(name).to_pylist()
        return values


@dataclass(frozen=True, slots=True)
class _Brief:
    """The part of a record that sorting and the choice among several need."""

    search: Search
    finished: str
    order: tuple[str, str, int, str]
    rank: tuple[int, float]
    kept: bool


def gather(folder: Path, plan: Membership) -> Gathered:
    """Reads all records of a library, and grades those that belong to it; raises `LibraryError` without Arrow."""
    require_pyarrow()
    columns, briefs = _Columns(), []
    superseded, torn = [], []
    for path in sorted((folder / RECORDS).glob("*.json")):
        record = read_record(path)
        if record is None:
            torn.append(path.name)
            continue
        why = plan.why_not(record)
        if why is not None:
            superseded.append(Superseded(record["id"], record["name"], robot_of(record), record["seed"], why))
            continue
        row = plan.described(record)
        reached, lacks = grade(row)
        kept = reached in KEPT
        columns.add({**row, "grade": reached, "lacks": lacks or None, "kept": kept})
        order = (row["name"], row["robot"], row["seed"], row["id"])
        briefs.append(_Brief(search_of(row), row["finished"] or "", order, rank(row), kept))
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
    return Gathered(columns.table(rows, [i in chosen and briefs[i].kept for i in rows]), superseded, torn)


class _Columns:
    def __init__(self) -> None:
        import pyarrow

        types = {str: pyarrow.string(), int: pyarrow.int64(), float: pyarrow.float64(), bool: pyarrow.bool_()}
        self._kinds = {**COLUMNS, **GRADED}
        del self._kinds["best"]  # known at the end
        self._schema = pyarrow.schema([(name, types[kind]) for name, kind in self._kinds.items()])
        self._rows: list[dict[str, Any]] = []
        self._batches: list[pyarrow.RecordBatch] = []

    def add(self, row: Mapping[str, Any]) -> None:
        kinds = self._kinds.items()
        self._rows.append({name: None if row[name] is None else kind(row[name]) for name, kind in kinds})
        if len(self._rows) >= _CHUNK:
            self._flush()

    def _flush(self) -> None:
        import pyarrow

        self._batches.append(pyarrow.RecordBatch.from_pylist(self._rows, schema=self._schema))
        self._rows = []

    def table(self, rows: list[int], best: list[bool]) -> "pyarrow.Table":
        """These rows in this order."""
        import pyarrow

        self._flush()
        table = pyarrow.Table.from_batches(self._batches, schema=self._schema)
        return table.take(pyarrow.array(rows, pyarrow.int64())).append_column(
            "best", pyarrow.array(best, pyarrow.bool_())
        )
