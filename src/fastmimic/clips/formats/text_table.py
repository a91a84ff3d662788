"""Tables of numbers as text: one frame a line, separated by commas, semicolons or white space."""

import csv
from collections.abc import Collection, Sequence
from typing import NamedTuple

import numpy as np

from fastmimic.base.arrays import Array, Flags
from fastmimic.base.conventions import LARGEST, RATE_RANGE_HZ
from fastmimic.base.errors import ClipError, check_positive


class Row(NamedTuple):
    """A line of the file: its 1-based number and its fields."""

    number: int
    fields: list[str]


class Table(NamedTuple):
    """The rows of a text without blank lines and comments (`#`), and the names of its columns if it has a header: a
    first line without numbers, or the last comment before the first row with as many fields (as in `numpy.savetxt`)."""

    header: list[str] | None
    header_is_comment: bool
    rows: list[Row]


def read_table(text: str) -> Table:
    """Splits a text into header and rows without checking the values."""
    header: list[str] | None = None
    comment: list[str] = []
    rows: list[Row] = []
    for number, line in enumerate(text.replace("\r\n", "\n").replace("\r", "\n").split("\n"), start=1):
        if not line or line.isspace():
            continue
        if line.lstrip().startswith("#"):
            if not rows:
                comment = _split(line.lstrip()[1:])
            continue
        fields = _split(line)
        if not rows and header is None and len(fields) > 1 and not any(is_number(field) for field in fields):
            header = fields
        else:
            rows.append(Row(number, fields))
    if header is None and rows and len(comment) == len(rows[0].fields) and not any(map(is_number, comment)):
        return Table(comment, True, rows)
    return Table(header, False, rows)


def _split(line: str) -> list[str]:
    separator = next((mark for mark in ",;" if mark in line), None)
    if '"' in line:
        return next(csv.reader([line], delimiter=separator or " ", skipinitialspace=True))
    return line.split(separator)


def is_number(field: str) -> bool:
    """Whether a field is a number, NaN and infinity included."""
    try:
        float(field)
    except ValueError:
        return False
    return True


def to_array(
    rows: Sequence[Row],
    names: Sequence[str],
    what: str,
    largest: float | Sequence[float] = LARGEST,
    gaps: Collection[int] = (),
    unread: list[str] | None = None,
    unused: Collection[int] = (),
) -> Array:
    """The values of all rows, (rows, columns). `names` are the columns' and `what` is the format, for messages;
    `largest` is the magnitude allowed, in all columns or in each; in the columns `gaps`, a value may be NaN or empty;
    the columns `unused` are not read, and NaN. Raises `ClipError`, with line and column: wrong number of columns, a
    value that is not a finite, sensible number, or too few rows. With a list `unread`, such lines are NaN in `gaps` and
    go on from their neighbours elsewhere, and the list gets a sentence on them; more than half are an error."""
    from scipy.interpolate import interp1d

    columns = len(names)
    values, most = np.full((len(rows), columns), np.nan), np.broadcast_to(largest, columns)
    may_lack = np.isin(np.arange(columns), [*gaps, *unused])
    problems: dict[int, ClipError] = {}
    for i, row in enumerate(rows):
        try:
            values[i] = _numbers(row, names, what, i == len(rows) - 1 and i > 0, most, may_lack, unused)
        except ClipError as error:
            if unread is None:
                raise
            problems[i] = error
    if problems and unread is not None:
        first = next(iter(problems.values()))
        if 2 * len(problems) > len(rows):
            raise first
        said = "1 line that cannot" if len(problems) == 1 else f"{len(problems)} lines that cannot"
        unread.append(f"{said} be read: as missing frames (the first: {first})")
        read = np.setdiff1d(np.arange(len(rows)), list(problems))
        others = np.flatnonzero(~may_lack)
        if len(read) > 1:
            between = interp1d(read, values[read][:, others], axis=0, fill_value="extrapolate")
            values[:, others] = between(np.arange(len(rows)))
    check_frames(len(values))
    return values


def _numbers(
    row: Row, names: Sequence[str], what: str, is_last: bool, largest: Array, may_lack: Flags, unused: Collection[int]
) -> Array:
    number, fields = row
    if len(fields) != len(names):
        last = "; the last line: the file may be truncated" if is_last else ""
        raise ClipError(f"line {number} has {len(fields)} columns; expected {len(names)} ({what}){last}")
    fields = list(fields)
    for c in unused:
        fields[c] = "nan"
    if not all(map(str.strip, fields)):
        fields = ["nan" if may and not field.strip() else field for may, field in zip(may_lack, fields, strict=True)]
    try:
        if "_" in "".join(fields):  # Python reads 1_0 as ten
            raise ValueError
        values = np.array(list(map(float, fields)))
    except ValueError:
        bad = next(c for c, field in enumerate(fields) if "_" in field or not is_number(field))
        where, found = f"line {number}, column {bad + 1} ({names[bad]})", fields[bad].strip()[:20]
        raise ClipError(f"{where}: '{found}' is not a number") from None
    wrong = ~((np.abs(values) <= largest) | (may_lack & np.isnan(values)))
    if wrong.any():
        c = int(np.argmax(wrong))
        problem = "too large" if np.isfinite(values[c]) else "not finite"
        raise ClipError(f"line {number}, column {c + 1} ({names[c]}): {values[c]:g} is {problem}")
    return values


def check_rate(rate_hz: float) -> None:
    """Raises `ClipError` unless a motion can have this frame rate."""
    check_positive(rate_hz, "the frame rate", ClipError, f"{rate_hz:g} Hz")
    if not RATE_RANGE_HZ[0] <= rate_hz <= RATE_RANGE_HZ[1]:
        raise ClipError(f"the frame rate is {rate_hz:g} Hz; expected {RATE_RANGE_HZ[0]:g} to {RATE_RANGE_HZ[1]:g}")


def check_frames(count: int) -> None:
    """Raises `ClipError` if there are too few frames."""
    if count < 2:
        raise ClipError(f"a clip needs at least 2 frames, found {count}")
