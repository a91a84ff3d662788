"""Keypoints as tables of text, one frame a line, in two formats.

- Dog motion capture: 81 columns, 27 points × (x, y, z) in metres. Peng et al. (2020) distribute the dog motions of
  Zhang et al. (2018) like this: y up, right-handed, 60 frames a second.
- Points by name: a header with three columns a point, NAME_x (or `NAME.x`, `NAME:X`, `NAME x`, `NameX`), NAME_y and
  NAME_z, as tracking programs export them, also from C3D; an empty field or NaN is a gap. A column `time` gives the
  frame rate; `frame` is ignored.
"""

import re
from collections.abc import Sequence
from typing import Final

import numpy as np

from fastmimic.clips.clip import DOG, DOG_KEYPOINTS, POINT_NAMES, Clip
from fastmimic.clips.formats.format import Format
from fastmimic.clips.formats.gaps import Part
from fastmimic.clips.formats.points import Tracks, clip_of, tracks_format
from fastmimic.clips.formats.text_table import read_table, to_array

COLUMNS: Final = 81
DEFAULT_RATE_HZ: Final = 60.0

_COLUMN: Final = re.compile(r"(.+?)(?:[\s._:/\-]([xyzXYZ])|(?<=[a-zA-Z])([XYZ]))")
_TIMES: Final = ("time", "time_s", "t")
_FEWEST: Final = 6  # points: the spine's two and four feet


def parse(text: str, *, fps: float | None = None, up: str | None = None, frames: Part | None = None) -> Clip:
    """Reads the text of a keypoint file; `fps` is 60 if None, and `up` the axis along which the hips are above the
    toes. Raises `ClipError`: malformed (says which line and column), or not an upright, right-handed animal."""
    rows = read_table(text).rows
    values = to_array(rows, COLUMNS, lambda c: f"point {c // 3} {'xyz'[c % 3]}", "dog keypoints")
    rate = DEFAULT_RATE_HZ if fps is None else float(fps)
    chosen = [DOG_KEYPOINTS[name] for name in POINT_NAMES]
    assumed = [] if fps is not None else [f"{rate:g} frames a second: the file does not say"]
    return clip_of(values.reshape(-1, 27, 3), chosen, rate, up=up, assumed=assumed, skeleton=DOG, frames=frames)


FORMAT: Final = Format(
    name="keypoints",
    about=f"dog keypoints, {COLUMNS} columns of text",
    suffixes=(".txt",),
    detect=lambda content: COLUMNS in content.columns,
    parse=parse,
    takes=("fps", "up", "frames"),
)


def read_named(text: str) -> Tracks:
    """Reads the text of such a table; raises `ClipError`: malformed (says which line and column)."""
    table = read_table(text)
    assert table.header is not None
    header = [name.strip().strip('"') for name in table.header]
    points = _named_points(header)
    gaps = {column for columns in points.values() for column in columns}
    values = to_array(table.rows, len(header), lambda column: header[column], "keypoints by name", gaps=gaps)
    time = next((column for column, name in enumerate(header) if name.lower() in _TIMES), None)
    positions = np.stack([values[:, columns] for columns in points.values()], axis=1)
    return Tracks(list(points), positions, times=None if time is None else (header[time], values[:, time]))


def _named_points(header: Sequence[str]) -> dict[str, list[int]]:
    """Columns x, y and z of each complete point, in file order."""
    found: dict[str, dict[str, int]] = {}
    for column, name in enumerate(header):
        match = _COLUMN.fullmatch(name.strip().strip('"'))
        if match is not None:
            found.setdefault(match[1].strip(), {})[(match[2] or match[3]).lower()] = column
    return {name: [axes[a] for a in "xyz"] for name, axes in found.items() if len(axes) == 3}


NAMED_FORMAT: Final = tracks_format(
    "points",
    "keypoints by name, a header with NAME_x, NAME_y, NAME_z of ten points, or of six without hips",
    (".csv",),
    lambda content: len(_named_points(content.table.header or ())) >= _FEWEST,
    read_named,
)
