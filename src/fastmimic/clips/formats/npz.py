"""Recognises FastMimic's own robot motions, which `Motion.load` reads."""

import io
import zipfile
from pathlib import Path
from typing import BinaryIO, Final, NoReturn

from fastmimic.base.errors import ClipError
from fastmimic.clips.formats.format import Format

_ZIP_MAGIC: Final = (b"PK\x03\x04", b"PK\x05\x06")


def is_robot_motion(path: str | Path) -> bool:
    """Whether a file is an `.npz`, or a damaged one; False if there is none."""
    try:
        with open(path, "rb") as file:
            return _detect(file)
    except (OSError, ValueError):  # ValueError: a NUL in the path
        return False


def _detect(file: BinaryIO) -> bool:
    if file.read(len(_ZIP_MAGIC[0])) not in _ZIP_MAGIC:
        return False
    try:
        with zipfile.ZipFile(file) as archive:
            return any(name.endswith(".npy") for name in archive.namelist())
    except (zipfile.BadZipFile, ValueError, OSError, NotImplementedError):
        return True  # damaged: `Motion.load` reports how


def _parse(data: bytes) -> NoReturn:
    raise ClipError("this is a robot motion (.npz), not a clip: nothing to retarget")


FORMAT: Final = Format(
    "npz",
    "FastMimic robot motion (.npz)",
    (".npz",),
    lambda content: _detect(io.BytesIO(content.data)),
    _parse,
    takes=(),
    binary=True,
)
