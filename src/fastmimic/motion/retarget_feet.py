"""Feet that stand still while they stand, and swing as the animal's did in between."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fastmimic.motion.contacts import Stance, Stances, swings_of
from fastmimic.motion.retarget_cycle import Track, WorldPath
from fastmimic.robot import Robot
from fastmimic.rotations import rotate_planar

Array = NDArray[np.float64]

_DEGREE = 3
_AT_REST = 3
"""Coefficients of a cubic B-spline that fix position, velocity and acceleration at an end."""


@dataclass(frozen=True)
class SwingConfig:
    """How a swing is fitted.

    Attributes:
        knot_s: spacing of the spline's knots; faster motion than it can follow is taken for marker noise.
        stiffness: weight of the spline's third differences against its distance from the animal's path.
        evenness: weight of the spline's horizontal first differences, which favours a steady speed over the animal's own timing.
        min_clearance_m: every swing lifts at least this much.
        linger_s: for so long before touch-down and after lift-off the foot is still near its foothold, and must be in reach.
    """

    knot_s: float = 0.025
    stiffness: float = 1.0
    evenness: float = 0.0
    min_clearance_m: float = 0.02
    linger_s: float = 0.02


@dataclass(frozen=True)
class Reach:
    """What the legs can reach, with the base at its nominal height.

    Attributes:
        hip_height: of the abduction axes above standing feet, m.
        longest, shortest: leg in its plane within the knee's limits, m.
        hips: (4, 2) abduction joint origins in the heading frame, m.
        lateral_offset: (4,) from there to the leg's plane, m.
        abduction: largest inward angle, rad.
    """

    hip_height: float
    longest: float
    shortest: float
    hips: Array
    lateral_offset: Array
    abduction: float

    @classmethod
    def of_robot(cls, robot: Robot, base_height: float, margin_rad: float) -> "Reach":
        """With knees `margin_rad` inside their limits."""
        a, b = robot.thigh_length, robot.calf_length
        knees = np.stack([robot.joint_lower[2::3] + margin_rad, robot.joint_upper[2::3] - margin_rad])
        lengths = np.sqrt(a * a + b * b + 2 * a * b * np.cos(knees))
        return cls(
            hip_height=base_height + float(robot.hip_pos_b[:, 2].mean()) - robot.foot_radius,
            longest=float(lengths.max(axis=0).min()),
            shortest=float(lengths.min(axis=0).max()),
            hips=robot.hip_pos_b[:, :2],
            lateral_offset=np.asarray(robot.lateral_offset),
            abduction=float(np.minimum(-robot.joint_lower[[3, 9]], robot.joint_upper[[0, 6]]).min()) - margin_rad,
        )

    def forward(self, leg: int, lateral: Array, drop: Array) -> Array:
        """How far ahead of its hip a standing foot may be, with `lateral` (k,) from the abduction axis and the hip `drop` (k,) high."""
        square = self.longest**2 - drop**2 - lateral**2 + self.lateral_offset[leg] ** 2
        return np.sqrt(np.maximum(square, 0.0))

    def inward(self, leg: int, drop: Array) -> Array:
        """How far a standing foot may be on the inner side of its abduction axis, (k,) m."""
        a, d = self.abduction, abs(float(self.lateral_offset[leg]))
        along = (drop - d * np.sin(a)) / np.cos(a)
        return np.asarray(along * np.sin(a) - d * np.cos(a))

    def longest_stance(self, speed: float, linger_s: float) -> float:
        """How long a foot can stand at a speed of travel, m/s, before its leg is at the end of its reach, s."""
        sweep = 2 * min(
            float(self.forward(leg, self.lateral_offset[[leg]], np.array([self.hip_height]))[0]) for leg in range(4)
        )
        return sweep / max(speed, 1e-3) - 2 * linger_s

    @property
    def clearance(self) -> float:
        """How high a foot can be lifted under its hip, m."""
        return self.hip_height - self.shortest


def footholds(
    raw_w: Array, track: Track, stances: Stances, reach: Reach, linger: int
) -> list[list[Array]]:
    """Where each foot stands in each of its stances, (2,) in the world, m.

    The mean of the animal's path in stance, weighted towards mid-stance, moved by what it lacks to be within reach
    at both touch-down and lift-off.

    Args:
        raw_w: (n, 4, 3) the animal's foot paths, world, m.
        track: the trunk.
        stances: of each leg.
        reach: of the robot's legs.
        linger: samples before touch-down and after lift-off in which the foothold must be in reach as well.
    """
    sway = np.concatenate([track.root_xy, track.root_z[:, None] - track.root_z.mean()], axis=1)
    trunk, tilt = WorldPath(sway, track), track.tilt
    result = []
    for leg, spans in enumerate(stances):
        path = WorldPath(raw_w[:, leg], track)
        holds = []
        for span in spans:
            index = np.arange(*span)
            hold = _mean_foothold(path.read(index))
            ends = index[[0, -1]] + np.array([-linger, linger])
            if not path.periodic:
                ends = np.clip(ends, 0, path.n - 1)
            heading = track.heading_at(ends)
            root = trunk.read(ends)
            local = rotate_planar(-heading, hold - root[:, :2]) - reach.hips[leg]
            roll, pitch = tilt[ends % path.n].T
            x, y = reach.hips[leg]
            drop = reach.hip_height + root[:, 2] - np.sin(pitch) * x + np.sin(roll) * y
            side = np.sign(reach.lateral_offset[leg])
            sideways = side * max(0.0, float((-reach.inward(leg, drop) - side * local[:, 1]).max()))
            limit = reach.forward(leg, local[:, 1] + sideways, drop)
            lowest, highest = float((-limit - local[:, 0]).max()), float((limit - local[:, 0]).min())
            forward = 0.5 * (lowest + highest) if lowest > highest else float(np.clip(0.0, lowest, highest))
            holds.append(hold + rotate_planar(heading.mean(), np.array([forward, sideways])))
        result.append(holds)
    return result


def plant_feet(
    raw_w: Array,
    track: Track,
    stances: Stances,
    holds: list[list[Array]],
    reach: Reach,
    ground_z: float,
    rate_hz: float,
    config: SwingConfig,
    evenness: Sequence[float] | None = None,
) -> Array:
    """Consistent foot paths: fixed in the world in stance, the animal's path between footholds in swing.

    Args:
        raw_w: (n, 4, 3) the animal's foot paths, world, m; z is the height above the ground.
        track: says how the path of a cycle repeats.
        stances: of each leg.
        holds: from `footholds`.
        reach: limits the clearance.
        ground_z: height of a standing foot's centre, m.
        rate_hz: of the samples.
        config: of the swings.
        evenness: of each leg's swings, in place of the configured one.

    Returns:
        (n, 4, 3) centres of the feet, world, m. Position, velocity and acceleration are continuous; the foot is at rest on the
        ground at every touch-down and lift-off and nowhere below it.
    """
    feet = np.empty_like(raw_w)
    for leg in range(4):
        leg_config = config if evenness is None else replace(config, evenness=evenness[leg])
        path = WorldPath(raw_w[:, leg], track)
        feet[:, leg] = _plant(path, stances[leg], holds[leg], reach.clearance, rate_hz, leg_config)
    feet[..., 2] += ground_z
    return feet


def _plant(
    path: WorldPath,
    stances: list[Stance],
    holds: list[Array],
    highest: float,
    rate_hz: float,
    config: SwingConfig,
) -> Array:
    n = path.n
    out = WorldPath(path.samples, path.track)
    for stance, hold in zip(stances, holds, strict=True):
        out.write(np.arange(*stance), np.tile([*hold, 0.0], (stance.duration, 1)))
    for lift_off, touch_down in swings_of(stances, n, path.periodic):
        from_rest = bool(stances) and (path.periodic or lift_off > 0)
        to_rest = bool(stances) and (path.periodic or touch_down < n)
        index = np.arange(lift_off - from_rest, touch_down + to_rest)  # with the samples at rest on both sides
        held, raw = out.read(index), path.read(index)
        clearance = min(max(float(raw[:, 2].max()), config.min_clearance_m), highest)
        ends = held[0] if from_rest else None, held[-1] if to_rest else None
        swing = _swing(raw, *ends, clearance, rate_hz, config)
        inner = slice(int(from_rest), len(index) - int(to_rest))
        out.write(index[inner], swing[inner])
    return out.samples


def _mean_foothold(raw: Array) -> Array:
    weight = np.sin(np.pi * (np.arange(len(raw)) + 0.5) / len(raw)) ** 2
    return np.asarray(weight @ raw[:, :2] / weight.sum())


def _swing(
    raw: Array, before: Array | None, after: Array | None, clearance: float, rate_hz: float, config: SwingConfig
) -> Array:
    """A smooth path (m, 3) near `raw`, from rest at `before` to rest at `after`; None where the recording ends in mid-air."""
    m = len(raw)
    share = np.arange(m) / max(m - 1, 1)
    blend = (share**3 * (10 - 15 * share + 6 * share**2))[:, None]
    first = None if before is None else before - raw[0]
    last = None if after is None else after - raw[-1]
    start = first if first is not None else last if last is not None else np.zeros(3)
    end = last if last is not None else start
    target = raw + (1 - blend) * start + blend * end
    rest = before is not None, after is not None
    planar = _SwingSpline(m, rate_hz, config.knot_s, config.stiffness, config.evenness, *rest)
    spline = _SwingSpline(m, rate_hz, config.knot_s, config.stiffness * (1 + 100 * config.evenness), 0.0, *rest)
    result = np.stack([*(planar.fit(target[:, axis]) for axis in range(2)), np.zeros(m)], axis=1)
    if before is None and after is None:
        result[:, 2] = raw[:, 2]
        return result
    shape = np.maximum(target[:, 2], 0.0)
    if shape.max() < 0.1 * clearance:
        shape = np.sin(np.pi * share) ** 2
    for _ in range(4):  # the spline rounds the top off: aim higher until the animal's clearance comes out
        result[:, 2] = spline.fit(shape, lower=0.0)
        shape = shape * (clearance / max(result[:, 2].max(), 1e-6))
    result[:, 2] = spline.fit(shape, lower=0.0)
    return result


class _SwingSpline:
    """Penalised cubic B-splines on the samples of one swing, at rest at its ends."""

    def __init__(
        self,
        m: int,
        rate_hz: float,
        knot_s: float,
        stiffness: float,
        evenness: float,
        from_rest: bool,
        to_rest: bool,
    ) -> None:
        from scipy.interpolate import BSpline

        pieces = max(6, round((m - 1) / rate_hz / knot_s))
        knots = np.concatenate([np.zeros(_DEGREE), np.linspace(0, 1, pieces + 1), np.ones(_DEGREE)])
        self._basis = BSpline.design_matrix(np.linspace(0, 1, m), knots, _DEGREE).toarray()
        k = pieces + _DEGREE
        roughness = np.sqrt(stiffness * m / pieces) * np.diff(np.eye(k), n=3, axis=0)
        unevenness = np.sqrt(evenness * m / pieces) * np.diff(np.eye(k), n=1, axis=0)
        self._matrix = np.concatenate([self._basis, roughness, unevenness])
        self._first = np.arange(k) < (_AT_REST if from_rest else 0)
        self._last = np.arange(k) >= k - (_AT_REST if to_rest else 0)

    def fit(self, target: Array, lower: float | None = None) -> Array:
        """The spline (m,) nearest to `target` (m,) that rests at target's ends, and stays above `lower`."""
        from scipy.optimize import lsq_linear

        coefficients = np.where(self._first, target[0], np.where(self._last, target[-1], 0.0))
        free = ~(self._first | self._last)
        padded = np.concatenate([target, np.zeros(len(self._matrix) - len(target))])
        rest = padded - self._matrix @ coefficients
        if lower is None:
            coefficients[free] = np.linalg.lstsq(self._matrix[:, free], rest, rcond=None)[0]
        else:  # a B-spline lies in the convex hull of its coefficients
            coefficients[free] = lsq_linear(self._matrix[:, free], rest, bounds=(lower, np.inf)).x
        return np.asarray(self._basis @ coefficients)
