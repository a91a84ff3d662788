"""The 24 fitted coordinates of a motion: root pose, root velocity and feet, each periodic if the motion is. Planar root
motion is relative to the constant-twist motion of the cycle, in its moving frame, or to the start of a motion without a
cycle. Roll and pitch are ZYX Euler angles, R = Rz(yaw) Ry(pitch) Rx(roll). Feet are in the body frame."""

from typing import Final

import numpy as np

from fastmimic.base.arrays import Array
from fastmimic.base.conventions import LEGS
from fastmimic.base.errors import MotionError
from fastmimic.base.rotations import (
    quat_continuous,
    quat_from_yaw,
    quat_multiply,
    roll_pitch_from_quat,
    rotate_planar,
    yaw_from_quat,
)
from fastmimic.motion.motion import Motion
from fastmimic.primitive.twist import PlanarTwist

NAMES: Final = (
    *(f"root_{c}" for c in ("x", "y", "z", "roll", "pitch", "yaw")),
    *(f"root_{c}" for c in ("vx", "vy", "vz", "wx", "wy", "wz")),
    *(f"{leg}_foot_{c}" for leg in LEGS for c in "xyz"),
)
GROUPS: Final = {
    "root_position_m": slice(0, 3),
    "root_orientation_rad": slice(3, 6),
    "root_lin_vel_m_per_s": slice(6, 9),
    "root_ang_vel_rad_per_s": slice(9, 12),
    "foot_position_m": slice(12, 24),
}
FEET: Final = slice(12, 24)
FOOT_Z: Final = (14, 17, 20, 23)  # the dimensions that the paper optimises
_MAX_PITCH: Final = np.radians(85.0)


def phases(n_samples: int) -> Array:
    """Phases (t,) of the samples of one cycle, rad."""
    return 2 * np.pi * np.arange(n_samples) / n_samples


def twist_of(motion: Motion) -> PlanarTwist:
    """Constant-twist motion of a cycle from its first sample; at rest there for a motion without a cycle."""
    origin = np.array([*motion.root_pos_w[0, :2], yaw_from_quat(motion.root_quat_wxyz[0])])
    return PlanarTwist.from_cycle(origin, np.zeros(3) if motion.cycle is None else motion.cycle)


def to_coordinates(motion: Motion, twist: PlanarTwist) -> Array:
    """Coordinates (t, 24) of a motion, in the order of `NAMES`; `MotionError` if the trunk points nearly up or down."""
    phase = phases(motion.n_samples)
    origin, heading = twist.pose(phase)
    (roll, pitch), yaw = roll_pitch_from_quat(motion.root_quat_wxyz), yaw_from_quat(motion.root_quat_wxyz)
    if np.max(np.abs(pitch)) > _MAX_PITCH:
        sample = int(np.argmax(np.abs(pitch)))
        raise MotionError(
            f"motion '{motion.name}' pitches to {np.degrees(pitch[sample]):.0f}° at sample {sample};"
            f" DMPs need it within ±{np.degrees(_MAX_PITCH):.0f}°"
        )
    out = np.empty((motion.n_samples, len(NAMES)))
    out[:, 0:2] = rotate_planar(-heading, motion.root_pos_w[:, :2] - origin)
    out[:, 2] = motion.root_pos_w[:, 2]
    out[:, 3], out[:, 4] = np.unwrap(roll), pitch
    out[:, 5] = np.unwrap(yaw - heading - twist.whole_turns * phase / (2 * np.pi))
    out[:, 6:8] = rotate_planar(-heading, motion.root_lin_vel_w[:, :2])
    out[:, 6:8] -= _frame_velocity(twist, out[:, 0:2], motion.period_s)
    out[:, 8] = motion.root_lin_vel_w[:, 2]
    out[:, 9:11] = rotate_planar(-heading, motion.root_ang_vel_w[:, :2])
    out[:, 11] = motion.root_ang_vel_w[:, 2] - (twist.rotation + twist.whole_turns) / motion.period_s
    out[:, FEET] = motion.foot_pos_b.reshape(-1, 12)
    return out


def root_from_coordinates(coordinates: Array, twist: PlanarTwist, period_s: float) -> tuple[Array, Array, Array, Array]:
    """World position (t, 3), quaternion (t, 4), linear and angular velocity (t, 3) of the root."""
    y = coordinates
    phase = phases(len(y))
    origin, heading = twist.pose(phase)
    position = np.column_stack([origin + rotate_planar(heading, y[:, 0:2]), y[:, 2]])
    yaw = y[:, 5] + heading + twist.whole_turns * phase / (2 * np.pi)
    quat = quat_continuous(_quat_from_euler(y[:, 3], y[:, 4], yaw))
    planar = y[:, 6:8] + _frame_velocity(twist, y[:, 0:2], period_s)
    lin_vel = np.column_stack([rotate_planar(heading, planar), y[:, 8]])
    turn_rate = y[:, 11] + (twist.rotation + twist.whole_turns) / period_s
    ang_vel = np.column_stack([rotate_planar(heading, y[:, 9:11]), turn_rate])
    return position, quat, lin_vel, ang_vel


def _frame_velocity(twist: PlanarTwist, offset: Array, period_s: float) -> Array:
    """Velocity (t, 2) of the moving frame's points at `offset` (t, 2), in that frame."""
    spin = twist.rotation / period_s
    return twist.translation / period_s + spin * np.column_stack([-offset[:, 1], offset[:, 0]])


def _quat_from_euler(roll: Array, pitch: Array, yaw: Array) -> Array:
    zero = np.zeros_like(roll)
    about_x = np.stack([np.cos(roll / 2), np.sin(roll / 2), zero, zero], axis=-1)
    about_y = np.stack([np.cos(pitch / 2), zero, np.sin(pitch / 2), zero], axis=-1)
    return quat_multiply(quat_from_yaw(yaw), quat_multiply(about_y, about_x))
