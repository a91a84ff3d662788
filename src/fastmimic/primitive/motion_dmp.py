"""`MotionDmp`: the 24 rhythmic or discrete DMPs of a motion, and the motions that they make, with feet in reach.

The 24 fitted coordinates are root pose, root velocity and feet, each periodic if the motion is. Planar root motion is
relative to the constant-twist motion of the cycle, in its moving frame, or to the start of a motion without a cycle.
Roll and pitch are ZYX Euler angles, R = Rz(yaw) Ry(pitch) Rx(roll). Feet are in the body frame.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fastmimic.base.arrays import Array
from fastmimic.base.conventions import LEGS
from fastmimic.base.errors import MotionError, did_you_mean
from fastmimic.base.jit import inlined, kernel
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
from fastmimic.motion.provenance import DmpRecord
from fastmimic.primitive.discrete import DiscreteDmp
from fastmimic.primitive.rhythmic import ALPHA, RhythmicDmp, Terms
from fastmimic.robot.kinematics import leg_forward, leg_inverse
from fastmimic.robot.robot import Robot


@dataclass(frozen=True, eq=False)
class PlanarTwist:
    """X(φ) = X₀ · exp(φ/2π · log(dx, dy, dyaw)): the planar motion of a cycle, spread evenly over its phase.

    A cyclic motion expressed in X(φ) is periodic for any turn; relative to a straight drift it would jump at the wrap.
    Near whole turns (|dyaw| > 3π/2) the twist is about a remote centre or does not exist. Whole turns are then left out
    of the frame's rotation and counted in `whole_turns`."""

    origin: Array  # (x, y, yaw) of X₀, world, m and rad
    log: Array  # (3,) logarithm of the displacement, moving frame, m, m and rad a cycle
    whole_turns: float = 0.0  # of the body about itself, left out of `log`, rad a cycle

    @classmethod
    def from_cycle(cls, origin: Array, cycle: Array) -> "PlanarTwist":
        """From the pose (x, y, yaw) at phase 0 and the displacement (dx, dy, dyaw) in its frame."""
        turns = 2 * np.pi * np.round(cycle[2] / (2 * np.pi)) if abs(cycle[2]) > 1.5 * np.pi else 0.0
        return cls(origin, planar_log(np.array([*cycle[:2], cycle[2] - turns])), float(turns))

    def pose(self, phase: Array) -> tuple[Array, Array]:
        """World position (..., 2) and unwrapped heading (...) of X at phases (...)."""
        local, angle = planar_exp(self.log, np.asarray(phase, dtype=np.float64) / (2 * np.pi))
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
        said = f"motion '{motion.name}' pitches to {np.degrees(pitch[sample]):.0f}° at sample {sample}"
        raise MotionError(f"{said}; DMPs need it within ±{np.degrees(_MAX_PITCH):.0f}°")
    out = np.empty((motion.n_samples, len(NAMES)))
    out[:, 0:2] = rotate_planar(-heading, motion.root_pos_w[:, :2] - origin)
    out[:, 2] = motion.root_pos_w[:, 2]
    out[:, 3], out[:, 4] = np.unwrap(roll), pitch
    out[:, 5] = np.unwrap(yaw - heading - twist.whole_turns * phase / (2 * np.pi))
    out[:, 6:8] = rotate_planar(-heading, motion.root_lin_vel_w[:, :2])
    out[:, 6:8] -= _frame_velocity(twist, out[:, 0:2], motion.period_s)
    out[:, 8] = motion.root_lin_vel_w[:, 2]
    out[:, 9:11] = rotate_planar(-heading, motion.root_ang_vel_w[:, :2])
    out[:, 11] = motion.root_ang_vel_w[:, 2] - (twist.log[2] + twist.whole_turns) / motion.period_s
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
    turn_rate = y[:, 11] + (twist.log[2] + twist.whole_turns) / period_s
    ang_vel = np.column_stack([rotate_planar(heading, y[:, 9:11]), turn_rate])
    return position, quat, lin_vel, ang_vel


def _frame_velocity(twist: PlanarTwist, offset: Array, period_s: float) -> Array:
    """Velocity (t, 2) of the moving frame's points at `offset` (t, 2), in that frame."""
    velocity = twist.log / period_s
    return velocity[:2] + velocity[2] * np.column_stack([-offset[:, 1], offset[:, 0]])


def _quat_from_euler(roll: Array, pitch: Array, yaw: Array) -> Array:
    zero = np.zeros_like(roll)
    about_x = np.stack([np.cos(roll / 2), np.sin(roll / 2), zero, zero], axis=-1)
    about_y = np.stack([np.cos(pitch / 2), zero, np.sin(pitch / 2), zero], axis=-1)
    return quat_multiply(quat_from_yaw(yaw), quat_multiply(about_y, about_x))


class FootTable(NamedTuple):
    """Feet and joints of n courses of t samples. Feet (n, t, 4, 3) are within reach, body frame, m; joints (n, t, 12)
    within their ranges, rad, with central differences as velocity, rad/s. `shift_m` and `n_shifted` (n, 4) are each
    foot's largest shift, m, and the number of its samples moved by more than 0.01 mm."""

    foot_pos_b: Array
    joint_pos: Array
    joint_vel: Array
    shift_m: Array
    n_shifted: NDArray[np.int64]


def foot_table(robot: Robot, foot_pos_b: Array, rate_hz: float, periodic: bool = True) -> FootTable:
    """Joints of n courses of foot positions `foot_pos_b` (n, t, 4, 3), body frame, m, in one compiled call. A foot out
    of reach (leg too short, or knee at its limit) moves to the nearest point in reach on the line from the hip; if
    abduction or hip are at their limits, to the foot position of the limited joints."""
    feet = np.array(foot_pos_b, dtype=np.float64, order="C")
    n, t = feet.shape[:2]
    joint_pos = np.empty((n, t, 12))
    shift, count = np.zeros((n, 4)), np.zeros((n, 4), dtype=np.int64)
    limits = np.stack([robot.joint_lower, robot.joint_upper])
    _reach(robot.geometry, limits, feet, joint_pos, shift, count)
    return FootTable(feet, joint_pos, rate_of(joint_pos, rate_hz, periodic), shift, count)


def rate_of(values: Array, rate_hz: float, periodic: bool) -> Array:
    """Central differences in time, per second, of n courses (n, t, k)."""
    if periodic:
        return (np.roll(values, -1, axis=1) - np.roll(values, 1, axis=1)) * (0.5 * rate_hz)
    return np.asarray(np.gradient(values, 1.0 / rate_hz, axis=1))


@inlined
def _limited(value: float, lower: float, upper: float) -> float:
    return lower if value < lower else (upper if value > upper else value)


@inlined
def _hip_to_foot_angle(g: Array, knee: float) -> float:
    """Angle from the thigh to the line hip → foot, in the leg's plane."""
    lt, lc = np.hypot(g[6], g[7]), np.hypot(g[8], g[9])
    bend = knee - np.arctan2(-g[6], -g[7]) + np.arctan2(-g[8], -g[9])
    return np.arctan2(lc * np.sin(bend), lt + lc * np.cos(bend))


@kernel
def _reach(rows: Array, limits: Array, feet: Array, q: Array, shift: Array, count: NDArray[np.int64]) -> None:
    """Joints `q` of `feet`, which are changed in place where out of reach."""
    lower, upper = limits[0], limits[1]
    for n in range(feet.shape[0]):
        for t in range(feet.shape[1]):
            for leg in range(4):
                g, j = rows[leg], 3 * leg
                p = feet[n, t, leg]
                a, h, k, ok = leg_inverse(g, p[0], p[1], p[2])
                knee = _limited(k, lower[j + 2], upper[j + 2])
                if knee != k:  # keep the direction from hip to foot
                    h += _hip_to_foot_angle(g, k) - _hip_to_foot_angle(g, knee)
                q[n, t, j] = _limited(a, lower[j], upper[j])
                q[n, t, j + 1] = _limited(h, lower[j + 1], upper[j + 1])
                q[n, t, j + 2] = knee
                if not ok or knee != k or q[n, t, j] != a or q[n, t, j + 1] != h:
                    x, y, z = leg_forward(g, q[n, t, j], q[n, t, j + 1], knee)
                    moved = np.sqrt((x - p[0]) ** 2 + (y - p[1]) ** 2 + (z - p[2]) ** 2)
                    p[0], p[1], p[2] = x, y, z
                    shift[n, leg] = max(shift[n, leg], moved)
                    count[n, leg] += moved > 1e-5


@dataclass(frozen=True, eq=False)
class MotionDmp:
    """DMPs fitted to a motion: root pose 6, root velocity 6, feet in the body frame 12.

    Those of a cycle are rhythmic. Others are discrete: they come to rest at g, a scales the path, the start is kept.

    Attributes:
        fitted, robot: the fitted motion and its robot.
        primitive: the DMPs, dimensions in the order of `NAMES`.
        twist: the planar motion of a cycle, removed before fitting and restored afterwards.
        fit_rms: root-mean-square fit error of each group of dimensions; the name ends with the unit.
    """

    fitted: Motion
    robot: Robot
    primitive: RhythmicDmp | DiscreteDmp
    twist: PlanarTwist
    fit_rms: dict[str, float]

    @classmethod
    def fit(cls, motion: Motion, robot: Robot, n_basis: int | None = None) -> "MotionDmp":
        """Raises `MotionError`: the trunk points straight up or down, or a motion without a cycle exceeds `MAX_S`."""
        twist = twist_of(motion)
        samples = to_coordinates(motion, twist)
        primitive: RhythmicDmp | DiscreteDmp
        if motion.cycle is not None:
            primitive = RhythmicDmp.fit(samples, motion.period_s, n_basis)
        else:
            primitive = DiscreteDmp.fit(samples, motion.period_s - motion.dt, n_basis)
        rest, pull, shape = primitive.course(motion.n_samples)
        error = rest + pull * primitive.goal + shape - samples
        rms = {name: float(np.sqrt(np.mean(error[:, group] ** 2))) for name, group in GROUPS.items()}
        return cls(motion, robot, primitive, twist, rms)

    @property
    def goal(self) -> Array:
        """A copy of the fitted baselines or goals g, (24,): m, rad, m/s, rad/s."""
        return self.primitive.goal.copy()

    @property
    def amplitude(self) -> Array:
        """Amplitudes a (24,) of the unmodulated motion: ones."""
        return np.ones(len(NAMES))

    def index(self, name: str) -> int:
        """Position of a dimension in `NAMES`; `MotionError` if there is none."""
        if name not in NAMES:
            raise MotionError(f"no DMP is called '{name}'{did_you_mean(name, NAMES)}")
        return NAMES.index(name)

    def motion(self, goal: Array | None = None, amplitude: Array | None = None) -> Motion:
        """The motion with baselines or goals g (24,) and amplitudes a (24,); None keeps the fitted g or a = 1.

        Joints come from inverse kinematics, contacts and demonstration from the fitted motion. Feet out of reach are
        brought back and counted in `provenance.dmp`. Raises `MotionError` for another shape or a value not finite.
        """
        goal = _finite("goal", self.goal if goal is None else goal)
        amplitude = _finite("amplitude", self.amplitude if amplitude is None else amplitude)
        position, quat, lin_vel, ang_vel = self.root(goal, amplitude)
        table = self.foot_table(goal[None], amplitude[None])
        return Motion(
            rate_hz=self.fitted.rate_hz,
            root_pos_w=position,
            root_quat_wxyz=quat,
            joint_pos=table.joint_pos[0],
            joint_vel=table.joint_vel[0],
            foot_pos_b=table.foot_pos_b[0],
            contact=self.fitted.contact,
            root_lin_vel_w=lin_vel,
            root_ang_vel_w=ang_vel,
            cycle=self.fitted.cycle,
            provenance=replace(self.fitted.provenance, dmp=self._record(goal, amplitude, table)),
            demonstration=self.fitted.target,
        )

    def foot_table(self, goal: Array, amplitude: Array) -> FootTable:
        """Feet and joints of n candidates with baselines g (n, 24) and amplitudes a (n, 24), as `motion` computes them.
        Raises `MotionError`: arrays of another shape, or with a value that is not finite."""
        n = len(np.atleast_2d(goal))
        goal, amplitude = _finite("goal", goal, n), _finite("amplitude", amplitude, n)
        feet = self._course(goal[:, None, FEET], amplitude[:, None, FEET], FEET).reshape(n, -1, 4, 3)
        return foot_table(self.robot, feet, self.fitted.rate_hz, self.fitted.cycle is not None)

    def root(self, goal: Array, amplitude: Array) -> tuple[Array, Array, Array, Array]:
        """Root of a candidate with g (24,) and a (24,): world position (t, 3), quaternion (t, 4), linear and angular
        velocity (t, 3), SI units. Raises `MotionError`: arrays of another shape, or with a value that is not finite."""
        y = self._course(_finite("goal", goal), _finite("amplitude", amplitude))
        position, quat, lin_vel, ang_vel = root_from_coordinates(y, self.twist, self.fitted.period_s)
        if quat[0] @ self.fitted.root_quat_wxyz[0] < 0:  # the same sign of the quaternion
            quat = -quat
        return position, quat, lin_vel, ang_vel

    def _course(self, goal: Array, amplitude: Array, dimensions: slice = slice(None)) -> Array:
        """Dimensions (..., t, d) of the path, modulated by (..., 1 or t, d)."""
        rest, pull, shape = self._terms
        return rest[:, dimensions] + pull * goal + amplitude * shape[:, dimensions]

    @cached_property
    def _terms(self) -> Terms:
        return self.primitive.course(self.fitted.n_samples)

    def _record(self, goal: Array, amplitude: Array, table: FootTable) -> DmpRecord:
        return DmpRecord(
            n_basis=self.primitive.n_basis,
            alpha=ALPHA,
            fit_rms=dict(self.fit_rms),
            names=NAMES,
            goal=tuple(goal.tolist()),
            amplitude=tuple(amplitude.tolist()),
            fitted_goal=tuple(self.primitive.goal.tolist()),
            foot_samples_out_of_reach=tuple(table.n_shifted[0].tolist()),
            foot_shift_to_reach_m=tuple(table.shift_m[0].tolist()),
            primitive=None if self.fitted.cycle is not None else "discrete",
        )


def _finite(name: str, values: Array, *candidates: int) -> Array:
    """A copy of the parameters (24,), or of each candidate's."""
    array, shape = np.array(values, dtype=np.float64), (*candidates, len(NAMES))
    if array.shape != shape:
        raise MotionError(f"{name} has shape {array.shape}; expected {shape}")
    if not np.all(np.isfinite(array)):
        raise MotionError(f"{name} holds a value that is not finite")
    return array
