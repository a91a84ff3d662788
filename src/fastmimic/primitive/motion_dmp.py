"""`MotionDmp`: the 24 rhythmic or discrete DMPs of a motion, and the motions that they make, with feet in reach."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fastmimic.base.arrays import Array
from fastmimic.base.errors import MotionError, did_you_mean
from fastmimic.base.jit import inlined, kernel
from fastmimic.motion.motion import Motion
from fastmimic.motion.provenance import DmpRecord
from fastmimic.primitive.coordinates import (
    FEET,
    GROUPS,
    NAMES,
    PlanarTwist,
    phases,
    root_from_coordinates,
    to_coordinates,
    twist_of,
)
from fastmimic.primitive.discrete import DiscreteDmp, DiscreteTerms
from fastmimic.primitive.rhythmic import N_BASIS, RhythmicDmp
from fastmimic.robot.kinematics import leg_forward, leg_inverse
from fastmimic.robot.robot import Robot


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
    if periodic:
        joint_vel = (np.roll(joint_pos, -1, axis=1) - np.roll(joint_pos, 1, axis=1)) * (0.5 * rate_hz)
    else:
        joint_vel = np.asarray(np.gradient(joint_pos, 1.0 / rate_hz, axis=1))
    return FootTable(feet, joint_pos, joint_vel, shift, count)


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
        primitive: the DMPs, dimensions in the order of `names`.
        twist: the planar motion of a cycle, removed before fitting and restored afterwards.
        fit_rms: root-mean-square fit error of each group of dimensions; the name ends with the unit.
    """

    fitted: Motion
    robot: Robot
    primitive: RhythmicDmp | DiscreteDmp
    twist: PlanarTwist
    fit_rms: dict[str, float]

    @classmethod
    def fit(cls, motion: Motion, robot: Robot, n_basis: int = N_BASIS) -> "MotionDmp":
        """Raises `MotionError`: the trunk points straight up or down, or a motion without a cycle exceeds `MAX_S`."""
        twist = twist_of(motion)
        samples = to_coordinates(motion, twist)
        primitive: RhythmicDmp | DiscreteDmp
        if motion.cycle is not None:
            primitive = RhythmicDmp.fit(samples, motion.period_s, n_basis)
            error = primitive.position(phases(motion.n_samples)) - samples
        else:
            primitive = DiscreteDmp.fit(samples, motion.period_s - motion.dt, n_basis)
            error = primitive.position(motion.n_samples) - samples
        rms = {name: float(np.sqrt(np.mean(error[:, group] ** 2))) for name, group in GROUPS.items()}
        return cls(motion, robot, primitive, twist, rms)

    @property
    def names(self) -> tuple[str, ...]:
        """The 24 dimensions: `root_x`, …, `RL_foot_z`."""
        return NAMES

    @property
    def goal(self) -> Array:
        """A copy of the fitted baselines or goals g, (24,): m, rad, m/s, rad/s."""
        return self.primitive.goal.copy()

    @property
    def amplitude(self) -> Array:
        """Amplitudes a (24,) of the unmodulated motion: ones."""
        return np.ones(len(NAMES))

    def index(self, name: str) -> int:
        """Position of a dimension in `names`; `MotionError` if there is none."""
        if name not in NAMES:
            raise MotionError(f"no DMP is called '{name}'{did_you_mean(name, NAMES)}")
        return NAMES.index(name)

    def motion(self, goal: Array | None = None, amplitude: Array | None = None) -> Motion:
        """The motion with baselines or goals g (24,) and amplitudes a (24,); None keeps the fitted g or a = 1.

        Joints come from inverse kinematics, contacts and demonstration from the fitted motion. Feet out of reach are
        brought back and counted in `provenance.dmp`. Raises `MotionError` for a parameter array of another shape, or
        with a value that is not finite.
        """
        goal = _parameters("goal", self.goal if goal is None else goal, (len(NAMES),))
        amplitude = _parameters("amplitude", self.amplitude if amplitude is None else amplitude, (len(NAMES),))
        y = self._course(goal, amplitude)
        position, quat, lin_vel, ang_vel = self._root(y)
        table = self._foot_table(y[None, :, FEET])
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
        goal = _parameters("goal", goal, (n, len(NAMES)))[:, None, FEET]
        amplitude = _parameters("amplitude", amplitude, (n, len(NAMES)))[:, None, FEET]
        return self._foot_table(self._course(goal, amplitude, FEET))

    def root(self, goal: Array, amplitude: Array) -> tuple[Array, Array, Array, Array]:
        """Root of a candidate with g (24,) and a (24,): world position (t, 3), quaternion (t, 4), linear and angular
        velocity (t, 3), SI units. Raises `MotionError`: arrays of another shape, or with a value that is not finite."""
        goal = _parameters("goal", goal, (len(NAMES),))
        amplitude = _parameters("amplitude", amplitude, (len(NAMES),))
        return self._root(self._course(goal, amplitude))

    def _root(self, y: Array) -> tuple[Array, Array, Array, Array]:
        position, quat, lin_vel, ang_vel = root_from_coordinates(y, self.twist, self.fitted.period_s)
        if quat[0] @ self.fitted.root_quat_wxyz[0] < 0:  # the same sign of the quaternion
            quat = -quat
        return position, quat, lin_vel, ang_vel

    def _foot_table(self, feet: Array) -> FootTable:
        periodic = self.fitted.cycle is not None
        return foot_table(self.robot, feet.reshape(len(feet), -1, 4, 3), self.fitted.rate_hz, periodic)

    def _course(self, goal: Array, amplitude: Array, dimensions: slice = slice(None)) -> Array:
        """Dimensions (..., t, d) of the path, modulated by (..., 1 or t, d)."""
        if isinstance(self._linear, DiscreteTerms):
            rest, pull, shape = self._linear
            return rest[:, dimensions] + pull * goal + amplitude * shape[:, dimensions]
        return goal + amplitude * self._linear[:, dimensions]

    @cached_property
    def _linear(self) -> Array | DiscreteTerms:
        """The responses in which the samples are linear; s (t, 24) for a cycle."""
        if isinstance(self.primitive, DiscreteDmp):
            return self.primitive.course(self.fitted.n_samples)
        return self.primitive.shape(phases(self.fitted.n_samples))

    def _record(self, goal: Array, amplitude: Array, table: FootTable) -> DmpRecord:
        return DmpRecord(
            n_basis=self.primitive.n_basis,
            basis_width_min_max=(float(self.primitive.widths.min()), float(self.primitive.widths.max())),
            alpha=self.primitive.alpha,
            fit_rms=dict(self.fit_rms),
            names=NAMES,
            goal=tuple(goal.tolist()),
            amplitude=tuple(amplitude.tolist()),
            fitted_goal=tuple(self.primitive.goal.tolist()),
            foot_samples_out_of_reach=tuple(table.n_shifted[0].tolist()),
            foot_shift_to_reach_m=tuple(table.shift_m[0].tolist()),
            primitive=None if self.fitted.cycle is not None else "discrete",
        )


def _parameters(name: str, values: Array, shape: tuple[int, ...]) -> Array:
    array = np.array(values, dtype=np.float64)
    if array.shape != shape:
        raise MotionError(f"{name} has shape {array.shape}; expected {shape}")
    if not np.all(np.isfinite(array)):
        raise MotionError(f"{name} holds a value that is not finite")
    return array
