"""Dog motion capture as text: 81 columns, 27 points × (x, y, z) in metres, one frame a line. Peng et al. (2020)
distribute the dog motions of Zhang et al. (2018) like this: y up, right-handed, 60 frames a second."""

from typing import Final

from fastmimic.clips.clip import POINT_NAMES, Clip
from fastmimic.clips.formats.format import Format
from fastmimic.clips.formats.points import clip_of
from fastmimic.clips.formats.text_table import check_frames, check_rate, read_table, to_array
from fastmimic.clips.skeleton import DOG

COLUMNS: Final = 81
DEFAULT_RATE_HZ: Final = 60.0

_POINT_INDEX: Final = {
    "pelvis": 0,
    "neck": 3,
    "FR_hip": 11,
    "FL_hip": 6,
    "RR_hip": 20,
    "RL_hip": 16,
    "FR_toe": 15,
    "FL_toe": 10,
    "RR_toe": 23,
    "RL_toe": 19,
}
"""Indices among the 27 points; left and right follow from the points' positions (up × forward)."""


def parse(text: str, *, fps: float | None = None, up: str | None = None) -> Clip:
    """Reads the text of a keypoint file; `fps` is 60 if None, and `up` the axis along which the hips are above the
    toes. Raises `ClipError`: malformed (says which line and column), or not an upright, right-handed animal."""
    rows = read_table(text).rows
    values = to_array(rows, COLUMNS, _column_name, "dog keypoints")
    check_frames(len(values))
    rate = DEFAULT_RATE_HZ if fps is None else float(fps)
    check_rate(rate)
    chosen = [_POINT_INDEX[name] for name in POINT_NAMES]
    assumed = [] if fps is not None else [f"{rate:g} frames a second: the file does not say"]
    return clip_of(values.reshape(-1, 27, 3), chosen, rate, up=up, assumed=assumed, skeleton=DOG)


def _column_name(column: int) -> str:
    return f"point {column // 3} {'xyz'[column % 3]}"


FORMAT: Final = Format(
    name="keypoints",
    about=f"dog keypoints, {COLUMNS} columns of text",
    suffixes=(".txt",),
    detect=lambda content: COLUMNS in content.columns,
    parse=parse,
    takes=("fps", "up"),
)
