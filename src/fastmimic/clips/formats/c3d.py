"""C3D, the markers of motion capture (c3d.org): labels, unit and rate are in the file; a marker that was not seen has a
negative residual. Read with ezc3d."""

import struct
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

import numpy as np

from fastmimic.base.errors import ClipError
from fastmimic.clips.formats.format import Content
from fastmimic.clips.formats.tracked_points import Tracks, library, tracks_format

_KEY: Final = 0x50  # second byte of every C3D
_BLOCK: Final = 512
_HEADER: Final = struct.Struct("<BBHHHHHfH")
_UNITS: Final = {"mm": 1e-3, "cm": 1e-2, "m": 1.0}


def read(data: bytes) -> Tracks:
    """Reads such a file. Raises `ClipError`: no ezc3d, damaged, or without markers."""
    ezc3d = library("ezc3d")
    _check_length(data)
    with TemporaryDirectory() as folder:
        path = Path(folder) / "take.c3d"  # ezc3d reads from a path alone
        path.write_bytes(data)
        try:
            file = ezc3d.c3d(str(path))
        except (OSError, RuntimeError, ValueError, IndexError) as error:
            raise ClipError(f"a C3D file that is damaged ({error})") from None
    about, markers = file["parameters"]["POINT"], file["data"]
    positions = markers["points"][:3].transpose(2, 1, 0)
    if not positions.size:
        raise ClipError("a C3D file without markers")
    unseen = markers["meta_points"]["residuals"][0].T < 0
    labels = [label for key in ("LABELS", "LABELS2") if key in about for label in about[key]["value"]]
    names = [label.rpartition(":")[2].strip() for label in labels[: positions.shape[1]]]
    unit = about["UNITS"]["value"][0].strip().lower() if about["UNITS"]["value"] else ""
    rate = float(about["RATE"]["value"][0])
    return Tracks(names, np.where(unseen[..., None], np.nan, positions), rate, unit_m=_UNITS.get(unit))


def _check_length(data: bytes) -> None:
    """Raises `ClipError` for a file without all of its frames, in some of which ezc3d 1.7 would search for ever."""
    if len(data) >= _HEADER.size:
        _, _, points, analog, first, last, _, scale, block = _HEADER.unpack_from(data)
        size = 4 if scale < 0 else 2
        if len(data) >= (block - 1) * _BLOCK + (last - first + 1) * (4 * points + analog) * size:
            return
    raise ClipError("a C3D file that ends too early: it may be truncated")


def _detect(content: Content) -> bool:
    data = content.data
    return not content.text and len(data) > 1 and data[1] == _KEY and 1 < data[0] < len(data) // _BLOCK + 2


FORMAT: Final = tracks_format("c3d", "markers of motion capture (.c3d)", (".c3d",), _detect, read, binary=True)
