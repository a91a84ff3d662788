"""The 24 fitted coordinates of a motion: root pose, root velocity and feet, each periodic if the motion is. Planar root
motion is relative to the constant-twist motion of the cycle, in its moving frame, or to the start of a motion without a
cycle. Roll and pitch are ZYX Euler angles, R = Rz(yaw) Ry(pitch) Rx(roll). Feet are in the body frame."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from fastmimic.base.arrays import Array
from fastmimic.base.conventions import LEGS
from fastmimic.base.errors import MotionError
from fastmimic.base.rotations import (
    planar_exp,
    planar_log,
    quat_continuous,
    quat_from_yaw,
    quat_multiply,
    roll_pitch_from_quat,
    rotate_planar,
    yaw_from_quat,
)
from fastmimic.motion.motion import Motion


@dataclass(frozen=True, eq=False)
class PlanarTwist:
    """X(φ) = X₀ · exp(φ/2π · log(dx, dy, dyaw)): the planar motion of a cycle, spread evenly over its phase.

    A cyclic motion expressed in X(φ) is periodic for any turn; relative to a straight drift it would jump at the wrap.
    Near whole turns (|dyaw| > 3π/2) the twist is about a remote centre or does not exist. Whole turns are then left out
    of the frame's rotation and counted in `whole_turns`."""

    origin: Array  # (x, y, yaw) of X₀, world, m and rad
    translation: Array  # (2,) translational part of the logarithm, moving frame, m a cycle
    rotation: float  # rotational part of the logarithm, rad a cycle
    whole_turns: float = 0.0  # of the body about itself, left out of `rotation`, rad a cycle

    @classmethod
    def from_cycle(cls, origin: Array, cycle: Array) -> "PlanarTwist":
        """From the pose (x, y, yaw) at phase 0 and the displacement (dx, dy, dyaw) in its frame."""
        cycle = np.asarray(cycle, dtype=np.float64)
        turns = 2 * np.pi * np.round(cycle[2] / (2 * np.pi)) if abs(cycle[2]) > 1.5 * np.pi else 0.0
        angle = float(cycle[2] - turns)
        translation = planar_log(np.array([*cycle[:2], angle]))[:2]
        return cls(np.array(origin, dtype=np.float64), translation, angle, float(turns))

    def pose(self, phase: Array) -> tuple[Array, Array]:
        """World position (..., 2) and unwrapped heading (...) of X at phases (...)."""
        share = np.asarray(phase, dtype=np.float64) / (2 * np.pi)
        local, angle = planar_exp(np.array([*self.translation, self.rotation]), share)
        return self.origin[:2] + rotate_planar(self.origin[2], local), self.origin[2] + angle


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
