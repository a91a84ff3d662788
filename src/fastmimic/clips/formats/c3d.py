"""C3D, the markers of motion capture (c3d.org): labels, unit and rate are in the file; a marker that was not seen has a
negative residual. The file is read with the library c3d."""

import io
import warnings
from typing import Final

import numpy as np

from fastmimic.base.errors import ClipError
from fastmimic.clips.formats.format import Content
from fastmimic.clips.formats.tracked_points import Tracks, library, tracks_format

_KEY: Final = 0x50  # second byte of every C3D
_BLOCK: Final = 512
_UNITS: Final = {"mm": 1e-3, "cm": 1e-2, "m": 1.0}


def read(data: bytes) -> Tracks:
    """Reads such a file. Raises `ClipError`: no library, or truncated."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of channels that are not read, and of the end that is checked below
        file = library("c3d").Reader(io.BytesIO(data))
        points = np.array([frame for _, frame, _ in file.read_frames()])
    if len(points) < file.frame_count:
        raise ClipError(f"the file says that it has {file.frame_count} frames; it has {len(points)}: it is truncated")
    labels = [file.get(f"POINT:{name}") for name in ("LABELS", "LABELS2")]
    names = [label.rpartition(":")[2].strip() for part in labels if part is not None for label in part.string_array]
    unit = file.get("POINT:UNITS").string_value.strip().lower()
    positions = np.where(points[..., 3:4] < 0, np.nan, points[..., :3]).astype(float)
    return Tracks(names[: points.shape[1]], positions, float(file.point_rate), unit_m=_UNITS.get(unit))


def _detect(content: Content) -> bool:
    data = content.data
    return not content.text and len(data) > 1 and data[1] == _KEY and 1 < data[0] < len(data) // _BLOCK + 2


FORMAT: Final = tracks_format("c3d", "markers of motion capture (.c3d)", (".c3d",), _detect, read, binary=True)
