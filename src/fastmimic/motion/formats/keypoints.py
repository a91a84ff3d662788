"""Dog motion capture as text: 81 columns, 27 points × (x, y, z) in metres, one frame a line.

The form in which Peng et al. (2020) distribute the dog motions of Zhang et al. (2018): y up, right-handed,
60 frames a second.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from fastmimic.errors import ClipError
from fastmimic.motion.clip import POINT_NAMES, Clip
from fastmimic.motion.formats.table import check_frames, check_rate, read_table, to_array
from fastmimic.motion.skeleton import DOG

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
"""Which of the 27 points is which; left and right as the points lie (up × forward)."""

_TO_Z_UP: Final = {"y": (2, 0, 1), "z": (0, 1, 2)}
_MIN_UPRIGHT: Final = 0.5
"""Least share of the mean toe → hip vector that is vertical: 0.95 in takes in which the dog also sits."""

Array = NDArray[np.float64]


def parse(text: str, *, fps: float | None = None, up: str | None = None) -> Clip:
    """Reads the text of a keypoint file.

    Args:
        text: the file's content.
        fps: frames a second; 60 if None.
        up: 'y' or 'z'; if None, the one along which the hips lie above the toes.

    Raises:
        ClipError: malformed (says which line and column), or not an upright, right-handed animal.
    """
    rows = read_table(text).rows
    values = to_array(rows, COLUMNS, _column_name, "dog keypoints")
    check_frames(len(values))
    rate = DEFAULT_RATE_HZ if fps is None else float(fps)
    check_rate(rate)
    body = values.reshape(-1, 27, 3)
    points = body[:, [_POINT_INDEX[name] for name in POINT_NAMES]]
    assumed = [] if fps is not None else [f"{rate:g} frames a second: the file does not say"]
    if up is None:
        up = _vertical_axis(points)
        assumed.append(f"{up} is up: the hips lie above the toes along it")
    points = np.ascontiguousarray(points[..., _TO_Z_UP[up]])
    _check_upright(points, up)
    _check_right_handed(points)
    height = float(np.mean(points[:, 2:6, 2] - points[:, 6:10, 2]))
    assumed.append(f"coordinates are in metres: hips {height:.2f} m above the toes on average")
    body = np.ascontiguousarray(body[..., _TO_Z_UP[up]])
    return Clip(points_w=points, rate_hz=rate, meta={"assumed": assumed}, body_w=body, skeleton=DOG)


def _column_name(column: int) -> str:
    return f"point {column // 3} {'xyz'[column % 3]}"


def _toe_to_hip(points: Array) -> Array:
    """Mean vector from the toes to the hips, (3,)."""
    return np.asarray(np.mean(points[:, 2:6] - points[:, 6:10], axis=(0, 1)))


def _vertical_axis(points: Array) -> str:
    vector = _toe_to_hip(points)
    return "y" if vector[1] >= vector[2] else "z"


def _check_upright(points: Array, up: str) -> None:
    vector = _toe_to_hip(points)
    if not vector[2] >= _MIN_UPRIGHT * np.linalg.norm(vector) > 0:
        raise ClipError(
            f"the hips do not lie above the toes along {up} (mean offset {vector[2]:.3g} m of"
            f" {np.linalg.norm(vector):.3g} m); the vertical axis must be y or z"
        )


def _check_right_handed(points: Array) -> None:
    """Left × right is lost in a mirrored file, which would swap the turns."""
    forward = points[:, 1] - points[:, 0]
    left = np.cross([0.0, 0.0, 1.0], forward)
    width = points[:, [3, 5]].sum(axis=1) - points[:, [2, 4]].sum(axis=1)
    if np.mean(np.sum(left * width, axis=-1)) < 0:
        raise ClipError(
            "the left hips lie on the right of the spine: the coordinates are left-handed or the"
            " points swapped; expected right-handed x, y, z"
        )
