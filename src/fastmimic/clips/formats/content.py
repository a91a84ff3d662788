"""Getting a file's content, and recognising its format by it."""

import io
import zipfile
from collections import Counter
from pathlib import Path
from typing import Final

from fastmimic.base.errors import ClipError
from fastmimic.clips.formats import bvh, csv_motion, keypoints, named_points
from fastmimic.clips.formats.text_table import read_table

EXPECTED: Final = (
    f"expected {keypoints.COLUMNS} columns (dog keypoints), {csv_motion.COLUMNS} columns or a header with"
    " joint names (retargeted motion), a header with NAME_x, NAME_y, NAME_z of ten points, BVH, DeepMimic-style JSON"
    " or a FastMimic .npz"
)
_ZIP_MAGIC: Final = (b"PK\x03\x04", b"PK\x05\x06")
_LINES_READ: Final = 2000
"""Enough for any comment at the top; the rest of a long take is split only once, by its format."""
_LINES_LOOKED_AT: Final = 20


def read_content(path: str | Path) -> str | bytes:
    """The text of a file, or the bytes of a zip archive (which an `.npz` is).

    Raises:
        ClipError: missing, not readable, empty, or binary.
    """
    try:
        data = Path(path).read_bytes()
    except FileNotFoundError:
        raise ClipError("no such file") from None
    except IsADirectoryError:
        raise ClipError("is a folder; expected a motion file") from None
    except (OSError, ValueError) as error:  # ValueError: a NUL in the path
        raise ClipError(f"cannot be read ({getattr(error, 'strerror', None) or error})") from None
    return data if data.startswith(_ZIP_MAGIC) else decode_text(data)


def decode_text(data: bytes) -> str:
    """UTF-8 text with or without a byte-order mark; raises `ClipError` for an empty or binary file."""
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise ClipError(f"a binary file (byte {error.start} is not UTF-8 text); {EXPECTED}") from None
    if "\0" in text:
        raise ClipError(f"a binary file (byte {data.index(0)} is zero); {EXPECTED}")
    if not text.strip():
        raise ClipError(f"the file is empty; {EXPECTED}")
    return text


def detect_content(content: str | bytes) -> str:
    """The name of the format that `content` is in; raises `ClipError` if it is in none."""
    if isinstance(content, bytes):
        return _detect_archive(content)
    if content.lstrip()[:1] in ("{", "["):
        return "deepmimic"
    if content.lstrip().startswith(bvh.KEYWORD):
        return "bvh"
    table = read_table("\n".join(content.split("\n", _LINES_READ)[:_LINES_READ]))
    if table.header is not None and named_points.names_points(table.header):
        return "points"
    if table.header is not None and csv_motion.names_joints(table.header):
        return "csv"
    if not table.rows:
        raise ClipError(f"the file holds no numbers; {EXPECTED}")
    if table.header is not None and not table.header_is_comment:
        shown = ", ".join(table.header[:4]) + (", …" if len(table.header) > 4 else "")
        raise ClipError(f"the first line ({shown[:80]}) is neither numbers nor names of joints or points; {EXPECTED}")
    counts = Counter(len(row.fields) for row in table.rows[:_LINES_LOOKED_AT])
    for columns, name in ((keypoints.COLUMNS, "keypoints"), (csv_motion.COLUMNS, "csv")):
        if counts[columns]:
            return name
    row = table.rows[0]
    raise ClipError(f"line {row.number} has {len(row.fields)} columns; {EXPECTED}")


def _detect_archive(data: bytes) -> str:
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            names = archive.namelist()
    except (zipfile.BadZipFile, ValueError, OSError, NotImplementedError):
        return "npz"  # a damaged one: reading it as a motion says what is wrong
    if any(name.endswith(".npy") for name in names):
        return "npz"
    raise ClipError(f"a zip archive without arrays; {EXPECTED}")
