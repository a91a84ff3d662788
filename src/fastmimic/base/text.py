"""Values as text: plain JSON values, numbers, CSV and Markdown tables."""

import csv
import dataclasses
import io
import math
from collections.abc import Iterable, Mapping, Sequence
from os import PathLike
from typing import Any, Final

import numpy as np

NONE: Final = "–"  # in a table, for no value


def plain(value: Any) -> Any:
    """The value in JSON types: NumPy values, tuples, dataclasses and paths converted; NaN and infinity become None."""
    if isinstance(value, np.generic | np.ndarray):
        value = value.tolist()
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        value = dataclasses.asdict(value)
    if isinstance(value, Mapping):
        return {key: plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, PathLike):
        return str(value)
    return None if isinstance(value, float) and not math.isfinite(value) else value


def number(value: float | None, digits: int = 3, factor: float = 1.0) -> str:
    """A number with `digits` decimals, multiplied by `factor`; a dash for None and NaN."""
    return NONE if value is None or math.isnan(value) else f"{factor * value:.{digits}f}"


def csv_text(columns: Sequence[str], rows: Iterable[Mapping[str, Any]]) -> str:
    """A header and one line a row; None and absent values are empty, columns not named are left out."""
    out = io.StringIO()
    writer = csv.DictWriter(out, columns, extrasaction="ignore", lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return out.getvalue()


def markdown_table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    """The lines of a Markdown table."""
    return [f"| {' | '.join(line)} |" for line in (header, ["---"] * len(header), *rows)]
