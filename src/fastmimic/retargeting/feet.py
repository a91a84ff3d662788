"""The reach of a robot's legs, footholds within it, and foot paths: still in stance, in between the animal's swings."""

from dataclasses import dataclass

import numpy as np

from fastmimic.base.arrays import Array, Indices
from fastmimic.base.configuration import tabulated
from fastmimic.base.conventions import LEFT
from fastmimic.base.rotations import rotate_planar
from fastmimic.motion.contacts import Stances, contact_mask, swings_of
from fastmimic.retargeting.track import TrunkTrack, WorldPath
from fastmimic.robot import Robot

MIN_CLEARANCE_SHARE = 0.8  # least height of a swing, of the animal's
_DEGREE = 3
_AT_REST = 3  # coefficients of a cubic B-spline that fix position, velocity and acceleration at an end
_FLAT = 0.1  # a swing with less than this share of its clearance gets a plain sin² shape
_CLEARANCE_ROUNDS = 4
_STEP = 5  # samples between two checks of reach


@tabulated
@dataclass(frozen=True)
class SwingPathConfig:
    """How the path of a swing is fitted."""

    knot_s: float = 0.025
    stiffness: float = 1.0
    min_clearance_m: float = 0.02
    linger_s: float = 0.02


def plant_feet(
    raw_w: Array,
    track: TrunkTrack,
    stances: Stances,
    holds: list[list[Array]],
    highest: float,
    ground_z: float,
    rate_hz: float,
    config: SwingPathConfig,
) -> Array:
    """Consistent foot paths (n, 4, 3), world, m: fixed in stance, the animal's path between footholds in swing.

    Position, velocity and acceleration are continuous. Feet rest at touch-down and lift-off, and never sink in.

    Args:
        raw_w: (n, 4, 3) the animal's foot paths, world, m; z is the height above the ground.
        track: the trunk; its `cycle` repeats the paths.
        holds: from `footholds`.
        highest: largest height of a foot, m.
        ground_z: height of a standing foot's centre, m.
    """
    feet, n, periodic = raw_w.copy(), len(raw_w), track.cycle is not None
    for leg, spans in enumerate(stances):
        path, out = WorldPath(raw_w[:, leg], track), WorldPath(raw_w[:, leg], track)
        for stance, hold in zip(spans, holds[leg], strict=True):
            out.write(np.arange(*stance), np.tile([*hold, 0.0], (stance.duration, 1)))
        for lift_off, touch_down in swings_of(spans, n, periodic) if spans else ():
            from_rest = periodic or lift_off > 0
            to_rest = periodic or touch_down < n
            index = np.arange(lift_off - from_rest, touch_down + to_rest)  # with the samples at rest on both sides
            held, raw = out.read(index), path.read(index)
            clearance = min(max(float(raw[:, 2].max()), config.min_clearance_m), highest)
            ends = held[0] if from_rest else None, held[-1] if to_rest else None
            swing = _swing(raw, *ends, clearance, rate_hz, config)
            inner = slice(int(from_rest), len(index) - int(to_rest))
            out.write(index[inner], swing[inner])
        feet[:, leg] = out.samples
    feet[..., 2] += ground_z
    return feet


def _swing(
    raw: Array, before: Array | None, after: Array | None, clearance: float, rate_hz: float, config: SwingPathConfig
) -> Array:
    """A smooth path (m, 3) near `raw`, from rest at `before` to rest at `after`; None at an end in the air."""
    m = len(raw)
    share = np.arange(m) / max(m - 1, 1)
    blend = (share**3 * (10 - 15 * share + 6 * share**2))[:, None]
    first = None if before is None else before - raw[0]
    last = None if after is None else after - raw[-1]
    start = first if first is not None else last if last is not None else np.zeros(3)
    end = last if last is not None else start
    target = raw + (1 - blend) * start + blend * end
    rest = before is not None, after is not None
    spline = _SwingSpline(m, rate_hz, config.knot_s, config.stiffness, rest)
    shape = np.maximum(target[:, 2], 0.0)
    if shape.max() < _FLAT * clearance:
        shape = np.sin(np.pi * share) ** 2
    for _ in range(_CLEARANCE_ROUNDS):  # the spline flattens the top, so aim higher
        z = spline.fit(shape, lower=0.0)
        shape = shape * (clearance / max(z.max(), 1e-6))
    return np.stack([spline.fit(target[:, 0]), spline.fit(target[:, 1]), spline.fit(shape, lower=0.0)], axis=1)


class _SwingSpline:
    """Penalised cubic B-splines on the samples of one swing, at rest at its ends."""

    def __init__(self, m: int, rate_hz: float, knot_s: float, stiffness: float, rest: tuple[bool, bool]) -> None:
        from scipy.interpolate import BSpline

        pieces = max(6, round((m - 1) / rate_hz / knot_s))
        knots = np.concatenate([np.zeros(_DEGREE), np.linspace(0, 1, pieces + 1), np.ones(_DEGREE)])
        self._basis = BSpline.design_matrix(np.linspace(0, 1, m), knots, _DEGREE).toarray()
        k = pieces + _DEGREE
        roughness = np.sqrt(stiffness * m / pieces) * np.diff(np.eye(k), n=3, axis=0)
        self._matrix = np.concatenate([self._basis, roughness])
        self._first = np.arange(k) < (_AT_REST if rest[0] else 0)
        self._last = np.arange(k) >= k - (_AT_REST if rest[1] else 0)

    def fit(self, target: Array, lower: float | None = None) -> Array:
        """The spline (m,) nearest to `target` (m,) that rests at the target's ends and stays above `lower`."""
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


@dataclass(frozen=True, eq=False)
class Reach:
    """Reach of the legs with the base at its nominal height."""

    hip_height: float  # of the abduction axes above the centres of standing feet, m
    longest: float  # leg in its plane within the knees' limits, m
    shortest: float  # likewise
    hips: Array  # (4, 2) abduction joint origins in the heading frame, m
    lateral_offset: Array  # (4,) from there to the leg's plane, m
    abduction: float  # largest inward angle, rad

    @classmethod
    def of_robot(cls, robot: Robot, base_height: float, margin_rad: float) -> "Reach":
        """With knees and abduction joints `margin_rad` inside their limits."""
        a, b = robot.thigh_length, robot.calf_length
        knees = np.stack([robot.joint_lower[2::3] + margin_rad, robot.joint_upper[2::3] - margin_rad])
        lengths = np.sqrt(a * a + b * b + 2 * a * b * np.cos(knees))
        inward = np.where(LEFT, -robot.joint_lower[0::3], robot.joint_upper[0::3])
        return cls(
            hip_height=base_height + float(robot.hip_pos_b[:, 2].mean()) - robot.foot_radius,
            longest=float(lengths.max(axis=0).min()),
            shortest=float(lengths.min(axis=0).max()),
            hips=robot.hip_pos_b[:, :2],
            lateral_offset=np.asarray(robot.lateral_offset),
            abduction=float(inward.min()) - margin_rad,
        )

    @property
    def clearance(self) -> float:
        """Largest height of a foot under its hip, m."""
        return self.hip_height - self.shortest

    def forward(self, leg: int, lateral: Array, drop: Array) -> Array:
        """Largest distance (k,) of a foot ahead of its hip, at `lateral` and `drop` (k,) from the abduction axis, m."""
        square = self.longest**2 - drop**2 - lateral**2 + self.lateral_offset[leg] ** 2
        return np.sqrt(np.maximum(square, 0.0))

    def inward(self, leg: int, drop: Array) -> Array:
        """Largest distance (k,), m, of a foot inwards of its abduction axis, `drop` (k,) below it, m."""
        a, d = self.abduction, abs(float(self.lateral_offset[leg]))
        along = (drop - d * np.sin(a)) / np.cos(a)
        return np.asarray(along * np.sin(a) - d * np.cos(a))

    def longest_stance(self, speed: float, linger_s: float) -> float:
        """Longest stance, s, within the leg's reach at a speed of travel, m/s."""
        drop = np.array([self.hip_height])
        sweep = 2 * min(float(self.forward(leg, self.lateral_offset[[leg]], drop)[0]) for leg in range(4))
        return sweep / max(speed, 1e-3) - 2 * linger_s


def foot_offsets(robot: Robot, track: TrunkTrack, stances: Stances, stance_width: float) -> Array:
    """Constant shifts (4, 2) of the feet against the robot's hips, m.

    The positions of shoulder, hip and toe markers belong to the animal's build, not to its motion. The mean footholds
    are shifted fore-aft under the centre of mass, and laterally to `stance_width` outside the abduction axis (a share
    of the lateral link). Left and right shift alike.
    """
    side = np.where(LEFT, 1.0, -1.0)
    stands = contact_mask(stances, len(track.root_z))
    mean = np.zeros((4, 2))
    for leg in range(4):
        if stands[:, leg].any():
            mean[leg] = track.toe_from_hip[stands[:, leg], leg].mean(axis=0)
    outward = np.repeat((side * mean[:, 1]).reshape(2, 2).mean(axis=1), 2)
    forward = robot.com_b[0] - robot.hip_pos_b[:, 0].mean() - mean[:, 0].mean()
    width = stance_width * np.abs(robot.lateral_offset)
    return np.stack([np.full(4, forward), side * (width - outward)], axis=-1)


def footholds(raw_w: Array, track: TrunkTrack, stances: Stances, reach: Reach, linger: int) -> list[list[Array]]:
    """The foothold (2,), world, m, of each stance of each foot. It is the mean of the animal's path in stance, weighted
    towards mid-stance, and moved into reach from touch-down to lift-off. `raw_w` (n, 4, 3) are the animal's foot paths,
    world, m. The foot must also be in reach for `linger` samples before and after the stance."""
    sway = np.concatenate([track.root_xy, track.root_z[:, None] - track.root_z.mean()], axis=1)
    trunk = WorldPath(sway, track)
    result = []
    for leg, spans in enumerate(stances):
        path = WorldPath(raw_w[:, leg], track)
        holds = []
        for span in spans:
            last = span.lift_off + linger
            when = np.append(np.arange(span.touch_down - linger, last, _STEP), last)
            if not path.periodic:
                when = np.clip(when, 0, path.n - 1)
            raw = path.read(np.arange(*span))
            weight = np.sin(np.pi * (np.arange(len(raw)) + 0.5) / len(raw)) ** 2
            hold = np.asarray(weight @ raw[:, :2] / weight.sum())
            holds.append(hold + _into_reach(hold, leg, trunk.read(when), track, when, reach))
        result.append(holds)
    return result


def _into_reach(hold: Array, leg: int, trunk: Array, track: TrunkTrack, when: Indices, reach: Reach) -> Array:
    """The displacement (2,), world, that brings a foothold into reach of a trunk (k, 3): x, y, z above its mean."""
    heading = track.heading_at(when)
    local = rotate_planar(-heading, hold - trunk[:, :2]) - reach.hips[leg]
    roll, pitch = track.tilt[when % len(track.tilt)].T
    x, y = reach.hips[leg]
    drop = reach.hip_height + trunk[:, 2] - np.sin(pitch) * x + np.sin(roll) * y
    side = np.sign(reach.lateral_offset[leg])
    sideways = side * max(0.0, float((-reach.inward(leg, drop) - side * local[:, 1]).max()))
    limit = reach.forward(leg, local[:, 1] + sideways, drop)
    lowest, highest = float((-limit - local[:, 0]).max()), float((limit - local[:, 0]).min())
    forward = 0.5 * (lowest + highest) if lowest > highest else float(np.clip(0.0, lowest, highest))
    return rotate_planar(heading[len(heading) // 2], np.array([forward, sideways]))
