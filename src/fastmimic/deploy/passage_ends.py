"""The ends of a passage as cycles: the stride with which it begins, and the one with which it ends, so that it can be
entered from standing and left as a cycle is."""

from dataclasses import replace
from typing import Final

import numpy as np

from fastmimic.base.rotations import rotate_planar, yaw_from_quat
from fastmimic.motion.motion import Motion

LEAST_S: Final = 1.0  # of a passage with room for a stride at either end
_STRIDES_S: Final = (0.3, 1.5)  # shortest and longest stride
_NEARLY: Final = 1.3
_ARRAYS: Final = (
    *("root_pos_w", "root_quat_wxyz", "root_lin_vel_w", "root_ang_vel_w"),
    *("joint_pos", "joint_vel", "foot_pos_b", "contact"),
)
_RESTS_S: Final = 0.2  # standing on all feet for so long is rest


def first_stride(motion: Motion) -> tuple[Motion, int]:
    """The beginning of a passage as a cycle, and the sample at which it begins: until joints and contacts are about as
    near to those at its start as they come; its first pose, if it begins at rest."""
    rest = round(_RESTS_S * motion.rate_hz)
    if motion.contact[:rest].all():
        return _as_cycle(motion, 0, rest), 0
    return _as_cycle(motion, 0, _stride(motion, 0, 1)), 0


def last_stride(motion: Motion) -> tuple[Motion, int]:
    """Likewise its end."""
    rest, last = round(_RESTS_S * motion.rate_hz), motion.n_samples - 1
    if motion.contact[-rest:].all():
        return _as_cycle(motion, last - rest, rest), last - rest
    n = _stride(motion, last, -1)
    return _as_cycle(motion, last - n, n), last - n


def _stride(motion: Motion, start: int, way: int) -> int:
    """Samples from `start`, forwards or backwards, to the first pose that is nearly as near to it as any."""
    least, most = (round(s * motion.rate_hz) for s in _STRIDES_S)
    most = min(most, motion.n_samples - 1)
    at = start + way * np.arange(min(least, most), most + 1)
    apart = np.linalg.norm(motion.joint_pos[at] - motion.joint_pos[start], axis=1)
    apart += (motion.contact[at] != motion.contact[start]).sum(axis=1)
    return int(abs(at[int(np.argmax(apart <= _NEARLY * apart.min()))] - start))


def _as_cycle(motion: Motion, first: int, n: int) -> Motion:
    """Samples of a passage as one period."""
    part = slice(first, first + n)
    yaw = yaw_from_quat(motion.root_quat_wxyz[[first, first + n]])
    moved = motion.root_pos_w[first + n, :2] - motion.root_pos_w[first, :2]
    cycle = np.array([*rotate_planar(-yaw[0], moved), np.angle(np.exp(1j * (yaw[1] - yaw[0])))])
    arrays = {name: getattr(motion, name)[part] for name in _ARRAYS}
    return replace(motion, **arrays, cycle=cycle, demonstration=None, animal=None)
