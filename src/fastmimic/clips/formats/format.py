"""`Format`: a kind of motion file, with detection and parsing; and all of them by name. `Motion.load` reads our own."""

import io
import zipfile
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, BinaryIO, Final, NoReturn

from fastmimic.base.errors import ClipError
from fastmimic.base.registry import Registry
from fastmimic.clips.clip import Clip
from fastmimic.clips.formats.point_names import PointMap
from fastmimic.clips.formats.text_table import Table, read_table
from fastmimic.robot.robot import Robot

_LINES_READ: Final = 2000  # within which a table is looked for, after any comment
FLAT: Final = (
    "these points lie in a picture (x and y, no z): triangulate the views of two calibrated cameras with Anipose,"
    " sleap-anipose or DeepLabCut's 3D mode (deeplabcut.triangulate), and give the file of 3D points"
)
_ROWS_COUNTED: Final = 20
_OTHERS: Final = {"bone_names.npy", "dt.npy"}  # arrays of other formats: AI4AnimationPy's, and trajectories
_ZIP_MAGIC: Final = (b"PK\x03\x04", b"PK\x05\x06")


@dataclass(frozen=True)
class Content:
    """The content of a file."""

    data: bytes

    @classmethod
    def of(cls, path: str | Path) -> "Content":
        """Reads a file; raises `ClipError` if it is missing, a folder or cannot be read."""
        try:
            return cls(Path(path).read_bytes())
        except FileNotFoundError:
            raise ClipError("no such file") from None
        except IsADirectoryError:
            raise ClipError("is a folder; expected a motion file") from None
        except (OSError, ValueError) as error:  # ValueError: a NUL in the path
            raise ClipError(f"cannot be read ({getattr(error, 'strerror', None) or error})") from None

    @cached_property
    def text(self) -> str:
        """The file as UTF-8 text without byte-order mark; empty for a binary file."""
        try:
            text = self.data.decode("utf-8-sig")
        except UnicodeDecodeError:
            return ""
        return "" if "\0" in text else text

    @cached_property
    def start(self) -> str:
        """The text from its first non-blank character."""
        return self.text.lstrip()

    @cached_property
    def members(self) -> set[str]:
        """The names in a zip archive; none of a damaged one, or of another file."""
        return members(io.BytesIO(self.data)) or set()

    @cached_property
    def table(self) -> Table:
        """The first lines of the text as a table."""
        return read_table("\n".join(self.text.split("\n", _LINES_READ)[:_LINES_READ]))

    @property
    def columns(self) -> Counter[int]:
        """Number of first rows for each number of columns; empty if the table has a header."""
        if self.table.header is not None and not self.table.header_is_comment:
            return Counter()
        return Counter(len(row.fields) for row in self.table.rows[:_ROWS_COUNTED])

    def problem(self) -> str:
        """Describes content that no format recognises; raises `ClipError` for points of a picture."""
        if self.data.startswith(_ZIP_MAGIC):
            return "a zip archive without arrays"
        try:
            self.data.decode("utf-8-sig")
        except UnicodeDecodeError as error:
            return f"a binary file (byte {error.start} is not UTF-8 text)"
        if b"\0" in self.data:
            return f"a binary file (byte {self.data.index(0)} is zero)"
        if not self.start:
            return "the file is empty"
        header, rows = self.table.header, self.table.rows
        if not rows:
            return "the file holds no numbers"
        if header is not None and not self.table.header_is_comment:
            ends = {name[-2:].lower() for name in header}
            if any({f"{sign}x", f"{sign}y"} <= ends and f"{sign}z" not in ends for sign in "._"):
                raise ClipError(FLAT)
            shown = ", ".join(header[:4]) + (", …" if len(header) > 4 else "")
            return f"the first line ({shown[:80]}) is neither numbers nor names of joints or points"
        return f"line {rows[0].number} has {len(rows[0].fields)} columns"


@dataclass(frozen=True)
class ReadOptions:
    """A user's options for reading a clip; None for what the file says or shows."""

    robot: Robot | None = None  # of a file of joint angles
    fps: float | None = None
    up: str | None = None  # the vertical axis: "x", "y" or "z", or with its sign "-x", "-y" or "-z"
    scale: float | None = None  # factor from the size in the file to the robot's
    frames: tuple[int, int] | None = None  # (first, end) 0-based, end exclusive
    point_map: "str | Path | PointMap | None" = None  # the file's point for each of the ten, or a JSON file of them
    travel: str | None = None  # what is done with a trunk that does not travel: `fastmimic.clips.travel.with_travel`


@dataclass(frozen=True)
class Format:
    """A kind of motion file. `parse` makes the clip of a text (of the bytes, if `binary`), and raises `ClipError` with
    the position in the file. `takes` are those of `ReadOptions` that `parse` has parameters for: "fps", "up",
    "point_map", "robot", "frames" (a format whose takes may have gaps: to choose the part that is cut)."""

    name: str  # also in `clip.origin.format`
    about: str  # one line for users
    suffixes: tuple[str, ...]  # of file names; only for listing folders
    detect: Callable[[Content], bool]  # whether a file is of this format
    parse: Callable[..., Clip]
    takes: tuple[str, ...] = ("fps",)
    binary: bool = False

    def read(self, content: Content, options: ReadOptions) -> Clip:
        """The clip of a file's content; raises `ClipError` for an option that does not apply."""
        if options.point_map is not None and "point_map" not in self.takes:
            raise ClipError(f"a point map does not apply to {self.about}; leave it out")
        if options.up not in (None, "z") and "up" not in self.takes:
            said = f"{options.up} up does not apply to {self.about}: its trunk orientation is defined with z up"
            raise ClipError(f"{said}; convert the file, or leave the vertical axis out")
        given: dict[str, Any] = {name: getattr(options, name) for name in self.takes}
        return self.parse(content.data if self.binary else content.text, **given)


FORMATS: Final[Registry[Format]] = Registry("motion format", error=ClipError)
"""All formats. The one registered last is tried first, so a user's own takes precedence."""


def suffixes() -> tuple[str, ...]:
    """The suffixes of motion files, in the order of the formats."""
    return tuple(dict.fromkeys(suffix for form in FORMATS.values() for suffix in form.suffixes))


def format_of(content: Content) -> Format:
    """The format of a file; raises `ClipError` that says what was found and what is expected."""
    for form in reversed(list(FORMATS.values())):
        if form.detect(content):
            return form
    raise ClipError(f"{content.problem()}; expected one of: {'; '.join(form.about for form in FORMATS.values())}")


def has(content: Content, starts: tuple[str, ...] = (), arrays: tuple[str, ...] = (), columns: int = 0) -> bool:
    """Whether a table has so many columns, an archive all these arrays, or text or bytes begin so."""
    if columns or arrays:
        return columns in content.columns if columns else {f"{name}.npy" for name in arrays} <= content.members
    return content.start.startswith(starts) or content.data.startswith(tuple(s.encode("latin-1") for s in starts))


def is_motion(content: Content) -> bool:
    """Whether it is an `.npz` of ours, or a damaged one."""
    return holds_motion(io.BytesIO(content.data))


def is_robot_motion(path: str | Path) -> bool:
    """Whether a file is an `.npz` of ours, or a damaged one; False if there is none."""
    try:
        with open(path, "rb") as file:
            return holds_motion(file)
    except (OSError, ValueError):  # ValueError: a NUL in the path
        return False


def holds_motion(file: BinaryIO) -> bool:
    """Whether it is an `.npz` of ours, or a damaged one."""
    if file.read(len(_ZIP_MAGIC[0])) not in _ZIP_MAGIC:
        return False
    names = members(file)
    if names is None:  # damaged: `Motion.load` reports how
        return True
    return any(name.endswith(".npy") for name in names) and not names & _OTHERS


def members(file: BinaryIO) -> set[str] | None:
    """The names in a zip archive; None if it is damaged, or no archive."""
    try:
        with zipfile.ZipFile(file) as archive:
            return set(archive.namelist())
    except (zipfile.BadZipFile, ValueError, OSError, NotImplementedError):
        return None


def refuse(data: bytes) -> NoReturn:
    """Raises `ClipError`: what reads the bytes of a robot motion."""
    raise ClipError("this is a robot motion (.npz), not a clip: nothing to retarget")
