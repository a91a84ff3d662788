"""Keypoints as tables of text, one frame a line, in two formats.

- Dog motion capture: 81 columns, 27 points × (x, y, z) in metres. Peng et al. (2020) distribute the dog motions of
  Zhang et al. (2018) like this: y up, right-handed, 60 frames a second.
- Points by name: a header with three columns a point, NAME_x (or `NAME.x`, `NAME:X`, `NAME x`, `NameX`), NAME_y and
  NAME_z, as tracking programs export them, also from C3D; an empty field or NaN is a gap. A column `time` gives the
  frame rate; others are ignored, whatever is in them.
"""

import re
from collections.abc import Sequence
from typing import Final

import numpy as np

from fastmimic.clips.clip import DOG, DOG_KEYPOINTS, Clip
from fastmimic.clips.formats.format import Content
from fastmimic.clips.formats.gaps import Part
from fastmimic.clips.formats.points import Tracks
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
    notes = [] if fps is not None else [f"{DEFAULT_RATE_HZ:g} frames a second: the file does not say"]
    titles = [f"point {k} {axis}" for k in range(DOG.points) for axis in "xyz"]
    values = to_array(rows, COLUMNS, titles.__getitem__, "dog keypoints", gaps=range(COLUMNS), unread=notes)
    names = [str(i) for i in range(DOG.points)]
    tracks = Tracks(names, values.reshape(-1, DOG.points, 3), DEFAULT_RATE_HZ, notes=tuple(notes), skeleton=DOG)
    return tracks.clip(fps=fps, up=up, frames=frames, point_map={name: names[i] for name, i in DOG_KEYPOINTS.items()})


def read_named(text: str) -> Tracks:
    """Reads the text of such a table; raises `ClipError`: malformed (says which line and column)."""
    table = read_table(text)
    assert table.header is not None
    header = [name.strip().strip('"') for name in table.header]
    points = _named_points(header)
    gaps = {column for columns in points.values() for column in columns}
    time = next((column for column, name in enumerate(header) if name.lower() in _TIMES), None)
    unused, unread = set(range(len(header))) - gaps - {time}, list[str]()
    what = "keypoints by name"
    values = to_array(table.rows, len(header), header.__getitem__, what, gaps=gaps, unread=unread, unused=unused)
    positions = np.stack([values[:, columns] for columns in points.values()], axis=1)
    times = None if time is None else (header[time], values[:, time])
    return Tracks(list(points), positions, times=times, notes=tuple(unread))


def names_points(content: Content) -> bool:
    """Whether a text's header has enough points by name."""
    return len(_named_points(content.table.header or ())) >= _FEWEST


def _named_points(header: Sequence[str]) -> dict[str, list[int]]:
    """Columns x, y and z of each complete point, in file order."""
    found: dict[str, dict[str, int]] = {}
    for column, name in enumerate(header):
        match = _COLUMN.fullmatch(name.strip().strip('"'))
        if match is not None:
            found.setdefault(match[1].strip(), {})[(match[2] or match[3]).lower()] = column
    return {name: [axes[a] for a in "xyz"] for name, axes in found.items() if len(axes) == 3}
