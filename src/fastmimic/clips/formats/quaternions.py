"""Quaternions of motion files, in the order x, y, z, w."""

from collections.abc import Callable
from typing import Final

import numpy as np
from numpy.typing import NDArray

from fastmimic.base.errors import ClipError
from fastmimic.base.rotations import quat_continuous

NORM_TOLERANCE: Final = 2e-3  # rounding to three decimals changes a unit quaternion's norm by up to 1e-3


def unit_wxyz_from_xyzw(xyzw: NDArray[np.float64], where: Callable[[int], str]) -> NDArray[np.float64]:
    """Unit quaternions (t, 4) in the order w, x, y, z, without sign flips, from `xyzw` (t, 4). `where` gives a frame's
    position in the file, for messages. Raises `ClipError` for a norm that is not 1."""
    norm = np.linalg.norm(xyzw, axis=1)
    wrong = np.flatnonzero(np.abs(norm - 1) > NORM_TOLERANCE)
    if len(wrong):
        frame = int(wrong[0])
        raise ClipError(f"{where(frame)}: the root quaternion (x, y, z, w) has norm {norm[frame]:.4g}; expected 1")
    return quat_continuous((xyzw / norm[:, None])[:, [3, 0, 1, 2]])
