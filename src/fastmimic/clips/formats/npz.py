"""FastMimic's own robot motions, which are recognised here and read by `Motion.load`."""

import io
import zipfile
from typing import Final, NoReturn

from fastmimic.base.errors import ClipError
from fastmimic.clips.formats.format import Content, Format

_ZIP_MAGIC: Final = (b"PK\x03\x04", b"PK\x05\x06")


def _detect(content: Content) -> bool:
    if not content.data.startswith(_ZIP_MAGIC):
        return False
    try:
        with zipfile.ZipFile(io.BytesIO(content.data)) as archive:
            return any(name.endswith(".npy") for name in archive.namelist())
    except (zipfile.BadZipFile, ValueError, OSError, NotImplementedError):
        return True  # damaged: `Motion.load` says how


def _parse(data: bytes) -> NoReturn:
    raise ClipError("this is a robot motion (.npz), not a clip: nothing to retarget")


FORMAT: Final = Format("npz", "FastMimic robot motion (.npz)", (".npz",), _detect, _parse, takes=(), binary=True)
