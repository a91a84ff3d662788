"""Keypoints as a table with a header: three columns a point, NAME_x, NAME_y, NAME_z, in any order of points. Tracking
programs export such tables, also from C3D. `NAME.x`, `NAME:X` and `NAME x` are the same. A column `time` gives the
frame rate; `frame` is ignored."""

import re
from collections.abc import Sequence
from typing import Final

import numpy as np

from fastmimic.base.errors import ClipError
from fastmimic.clips.clip import POINT_NAMES, Clip
from fastmimic.clips.formats.format import Content, Format
from fastmimic.clips.formats.points import PointMap, choose, clip_of
from fastmimic.clips.formats.text_table import check_frames, check_rate, read_table, to_array

_COLUMN: Final = re.compile(r"(.+?)[\s._:/\-]([xyz])", re.IGNORECASE)
_TIMES: Final = ("time", "time_s", "t")
_UNEVEN: Final = 0.02  # share of a frame's duration


def parse(text: str, *, fps: float | None = None, up: str | None = None, point_map: PointMap | None = None) -> Clip:
    """Reads the text of such a table; `fps` is from the column `time` if None. Without `point_map` the ten points are
    those of the common names, or of AI4Animation's dog; without `up`, the hips are above the toes. Raises `ClipError`:
    malformed (says which line and column), no rate, no such points, or not an upright, right-handed animal."""
    table = read_table(text)
    assert table.header is not None
    header = [name.strip().strip('"') for name in table.header]
    values = to_array(table.rows, len(header), lambda column: header[column], "keypoints by name")
    check_frames(len(values))
    points = _points(header)
    chosen, title = choose(list(points), point_map)
    assumed = [] if title is None else [f"points are named as {title}"]
    hz = _rate(header, values) if fps is None else float(fps)
    check_rate(hz)
    body = np.stack([values[:, columns] for columns in points.values()], axis=1)
    return clip_of(body, chosen, hz, up=up, assumed=assumed)


def _points(header: Sequence[str]) -> dict[str, list[int]]:
    """Columns x, y and z of each complete point, in file order."""
    found: dict[str, dict[str, int]] = {}
    for column, name in enumerate(header):
        match = _COLUMN.fullmatch(name.strip().strip('"'))
        if match is not None:
            found.setdefault(match[1].strip(), {})[match[2].lower()] = column
    return {name: [axes[a] for a in "xyz"] for name, axes in found.items() if len(axes) == 3}


def _rate(header: Sequence[str], values: np.ndarray) -> float:
    for column, name in enumerate(header):
        if name.lower() in _TIMES:
            steps = np.diff(values[:, column])
            step = float(np.median(steps))
            if not step > 0 or np.abs(steps - step).max() > _UNEVEN * step:
                raise ClipError(f"the column '{name}' does not rise by equal steps; give the frame rate (--fps)")
            return 1.0 / step
    raise ClipError("there is no column 'time'; give the frame rate (--fps)")


def _detect(content: Content) -> bool:
    header = content.table.header
    return header is not None and len(_points(header)) >= len(POINT_NAMES)


FORMAT: Final = Format(
    name="points",
    about="keypoints by name, a header with NAME_x, NAME_y, NAME_z of ten points",
    suffixes=(".csv",),
    detect=_detect,
    parse=parse,
    takes=("fps", "up", "point_map"),
)
