"""Foot paths that stand still in stance and follow the animal's swings in between."""

from dataclasses import dataclass

import numpy as np

from fastmimic.base.arrays import Array
from fastmimic.base.configuration import documented, parameter
from fastmimic.motion.contacts import Stance, Stances, swings_of
from fastmimic.retargeting.track import TrunkTrack, WorldPath

_DEGREE = 3
_AT_REST = 3  # coefficients of a cubic B-spline that fix position, velocity and acceleration at an end
_FLAT = 0.1  # a swing with less than this share of its clearance gets a plain sin² shape
_CLEARANCE_ROUNDS = 4


@documented
@dataclass(frozen=True)
class SwingPathConfig:
    """How the path of a swing is fitted."""

    knot_s: float = parameter(
        0.025, unit="s", above=0.0, about="spacing of the spline's knots; faster motion is taken for marker noise"
    )
    stiffness: float = parameter(
        1.0, about="weight of the third differences against the distance from the animal's path"
    )
    min_clearance_m: float = parameter(0.02, unit="m", scale="length", about="least height of every swing")
    linger_s: float = parameter(
        0.02,
        unit="s",
        about="time before touch-down and after lift-off in which the foot is near its foothold and must be in reach",
    )


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
    feet = np.empty_like(raw_w)
    for leg in range(4):
        path = WorldPath(raw_w[:, leg], track)
        feet[:, leg] = _plant(path, stances[leg], holds[leg], highest, rate_hz, config)
    feet[..., 2] += ground_z
    return feet


def _plant(
    path: WorldPath, stances: list[Stance], holds: list[Array], highest: float, rate_hz: float, config: SwingPathConfig
) -> Array:
    n = path.n
    if not stances:
        return path.samples
    out = WorldPath(path.samples, path.track)
    for stance, hold in zip(stances, holds, strict=True):
        out.write(np.arange(*stance), np.tile([*hold, 0.0], (stance.duration, 1)))
    for lift_off, touch_down in swings_of(stances, n, path.periodic):
        from_rest = path.periodic or lift_off > 0
        to_rest = path.periodic or touch_down < n
        index = np.arange(lift_off - from_rest, touch_down + to_rest)  # with the samples at rest on both sides
        held, raw = out.read(index), path.read(index)
        clearance = min(max(float(raw[:, 2].max()), config.min_clearance_m), highest)
        ends = held[0] if from_rest else None, held[-1] if to_rest else None
        swing = _swing(raw, *ends, clearance, rate_hz, config)
        inner = slice(int(from_rest), len(index) - int(to_rest))
        out.write(index[inner], swing[inner])
    return out.samples


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
