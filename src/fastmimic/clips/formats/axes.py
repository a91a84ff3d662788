"""From a file's axes and unit to the world's, z up and metres, by the animal: its hips are above its toes, its left is
on the left, and no leg is as long as three metres."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from fastmimic.base.arrays import Array
from fastmimic.base.errors import ClipError

_TO_Z_UP: Final[Mapping[str, tuple[tuple[int, int, int], tuple[int, int, int]]]] = {
    "y": ((2, 0, 1), (1, 1, 1)),
    "z": ((0, 1, 2), (1, 1, 1)),
    "x": ((1, 2, 0), (1, 1, 1)),
    "-y": ((2, 0, 1), (1, -1, -1)),
    "-z": ((0, 1, 2), (1, -1, -1)),
    "-x": ((1, 2, 0), (1, -1, -1)),
}
"""Columns and signs that make an axis of the file the vertical one, without a reflection."""
UP_AXES: Final = tuple(_TO_Z_UP)
_MIN_UPRIGHT: Final = 0.5  # least vertical share of the mean toe → hip vector; 0.95 in takes in which the dog also sits
_UNITS: Final = ((3000.0, 0.0, "pixels"), (300.0, 1e-3, "millimetres"), (3.0, 1e-2, "centimetres"))
"""Units other than metres, with the least distance from toes to hips in the file's numbers (no leg is 3 m)."""

_STEP_S: Final = 0.4  # within which a toe that walks stands for a moment
_FLAT: Final = 0.3  # largest thickness of the ground as a share of its width, for a plane to be fitted
_LEAST_TILT_RAD: Final = np.radians(3.0)


@dataclass(frozen=True)
class FileAxes:
    """`up` is the file's vertical axis, with its sign; `unit` is `factor` metres; `tilt` (3, 3) is what levels the
    ground; `notes` are for the user."""

    up: str
    unit: str
    factor: float
    tilt: Array | None = None
    notes: tuple[str, ...] = ()

    def to_world(self, points: Array) -> Array:
        """Points (..., 3) in the world, m."""
        columns, signs = _TO_Z_UP[self.up]
        turned = self.factor * np.ascontiguousarray(points[..., columns]) * np.array(signs)
        return turned if self.tilt is None else turned @ self.tilt.T


def find_axes(points: Array, rate_hz: float, up: str | None, unit_m: float | None, is_level: bool) -> FileAxes:
    """The axes and unit of the ten points (t, 10, 3) in a file, all finite. `up` and `unit_m` are known unless None;
    if not `is_level`, the axes are a camera's, and the ground is found under the standing toes. Raises `ClipError`: not
    upright, or larger than any animal."""
    notes = []
    if up is None:
        vector = _toe_to_hip(points)
        axis = int(np.argmax(np.abs(vector[[2, 1, 0]])))
        up = ("" if vector[2 - axis] > 0 else "-") + "zyx"[axis]
        notes.append(f"{up} is up: the hips lie above the toes along it")
    factor, unit = (unit_m, "the unit that it names") if unit_m is not None else _unit(points)
    axes = FileAxes(up, unit, factor)
    tilt = None if is_level else _levelling(axes.to_world(points), rate_hz)
    if tilt is not None:
        degrees = np.degrees(np.arccos(np.clip(tilt[2, 2], -1.0, 1.0)))
        notes.append(f"the ground under the standing toes is tilted by {degrees:.0f}° in the file: levelled")
    axes = FileAxes(up, unit, factor, tilt, tuple(notes))
    _check_upright(axes.to_world(points), up)
    return axes


def _unit(points: Array) -> tuple[float, str]:
    legs = float(np.mean(np.linalg.norm(points[:, 2:6] - points[:, 6:10], axis=-1)))
    for least, factor, name in _UNITS:
        if legs > least:
            if not factor:
                raise ClipError(
                    f"the legs are {legs:.0f} units long, more than any animal's in millimetres; pixels have no unit of"
                    " length: triangulate in that of the calibration board"
                )
            return factor, name
    return 1.0, "metres"


def _toe_to_hip(points: Array) -> Array:
    """Mean vector from the toes to the hips, (3,)."""
    return np.asarray(np.mean(points[:, 2:6] - points[:, 6:10], axis=(0, 1)))


def _levelling(points: Array, rate_hz: float) -> Array | None:
    """The rotation (3, 3) that makes level the ground under the standing toes; None if it nearly is. Across a straight
    path, where a plane is too narrow, the hips lie above the toes."""
    from scipy.ndimage import minimum_filter1d

    toes = points[:, 6:10]
    speed = np.linalg.norm(np.gradient(toes, axis=0), axis=2)
    standing = toes[speed <= minimum_filter1d(speed, 2 * round(_STEP_S * rate_hz / 2) + 1, axis=0)]
    _, spread, directions = np.linalg.svd(standing - standing.mean(axis=0), full_matrices=False)
    above = _toe_to_hip(points)
    along = directions[0]
    normal = directions[2] if spread[2] < _FLAT * spread[1] else above - (above @ along) * along
    normal = normal * np.sign(normal @ above) / np.linalg.norm(normal)
    if np.arccos(np.clip(normal[2], -1.0, 1.0)) < _LEAST_TILT_RAD:
        return None
    from scipy.spatial.transform import Rotation

    axis = np.cross(normal, [0.0, 0.0, 1.0])
    angle = np.arctan2(np.linalg.norm(axis), normal[2])
    return np.asarray(Rotation.from_rotvec(angle * axis / np.linalg.norm(axis)).as_matrix())


def _check_upright(points: Array, up: str) -> None:
    vector = _toe_to_hip(points)
    if not vector[2] >= _MIN_UPRIGHT * np.linalg.norm(vector) > 0:
        raise ClipError(
            f"the hips do not lie above the toes along {up} (mean offset {vector[2]:.3g} m of"
            f" {np.linalg.norm(vector):.3g} m); the vertical axis must be one of the file's"
        )


def check_right_handed(points: Array) -> None:
    """Raises `ClipError` for a mirrored file, which would swap left and right turns."""
    forward = points[:, 1] - points[:, 0]
    left = np.cross([0.0, 0.0, 1.0], forward)
    width = points[:, [3, 5]].sum(axis=1) - points[:, [2, 4]].sum(axis=1)
    if np.mean(np.sum(left * width, axis=-1)) < 0:
        raise ClipError(
            "the left hips lie on the right of the spine: the coordinates are left-handed or the"
            " points swapped; expected right-handed x, y, z"
        )
