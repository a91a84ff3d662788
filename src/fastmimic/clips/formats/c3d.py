"""C3D, the markers of motion capture (c3d.org): labels, unit and rate are in the file; a marker that was not seen has a
negative residual. ezc3d reads it, in a process of its own: damaged files make it crash or search for ever."""

import struct
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

import numpy as np

from fastmimic.base.errors import ClipError
from fastmimic.clips.formats.format import Content
from fastmimic.clips.formats.tracked_points import Tracks, library, tracks_format

_KEY: Final = 0x50  # second byte of every C3D
_BLOCK: Final = 512
_SGI: Final = 86  # the processor with other byte order, in the first block of parameters
_UNITS: Final = {"mm": 1e-3, "cm": 1e-2, "m": 1.0}
_LONGEST_S: Final = 60.0  # of reading


def read(data: bytes) -> Tracks:
    """Reads such a file. Raises `ClipError`: no ezc3d, damaged, or without markers."""
    library("ezc3d")
    with TemporaryDirectory() as folder:
        source, found = Path(folder) / "take.c3d", Path(folder) / "take.npz"
        source.write_bytes(data)
        script = Path(__file__).with_name("c3d_process.py")
        command = [sys.executable, "-P", str(script), str(source), str(found)]
        subprocess.run(command, check=True, capture_output=True, timeout=_LONGEST_S)
        with np.load(found) as file:
            points, residuals, labels = file["points"], file["residuals"], file["labels"]
            unit, rate = str(file["unit"]), float(file["rate"])
    n_markers, n_frames = points.shape[1:]
    order = ">HH" if data[(data[0] - 1) * _BLOCK + 3] == _SGI else "<HH"
    first, last = struct.unpack_from(order, data, 6)
    if n_frames < last - first + 1:  # ezc3d reads as many as there are
        raise ClipError(f"the file says that it has {last - first + 1} frames; it has {n_frames}: it may be truncated")
    positions = np.where(residuals < 0, np.nan, points).transpose(2, 1, 0)
    names = [str(label).rpartition(":")[2].strip() for label in labels[:n_markers]]
    return Tracks(names, positions, rate, unit_m=_UNITS.get(unit.strip().lower()))


def _detect(content: Content) -> bool:
    data = content.data
    return not content.text and len(data) > 1 and data[1] == _KEY and 1 < data[0] < len(data) // _BLOCK + 2


FORMAT: Final = tracks_format("c3d", "markers of motion capture (.c3d)", (".c3d",), _detect, read, binary=True)
