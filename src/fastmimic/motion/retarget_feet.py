"""Feet that stand still while they stand, and swing as the animal's did in between."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fastmimic.motion.contacts import Stance, swings_of
from fastmimic.motion.retarget_cycle import Track

Array = NDArray[np.float64]

_DEGREE = 3


@dataclass(frozen=True)
class SwingConfig:
    """How a swing is fitted.

    Attributes:
        knot_s: spacing of the spline's knots; faster motion than it can follow is taken for marker noise.
        stiffness: weight of the spline's third differences against its distance from the animal's path.
        min_clearance_m: every swing lifts at least this much.
    """

    knot_s: float = 0.025
    stiffness: float = 0.02
    min_clearance_m: float = 0.02


def plant_feet(
    raw_xy: Array, raw_height: Array, track: Track, stances: list[list[Stance]], ground_z: float, rate_hz: float,
    config: SwingConfig,
) -> Array:
    """Consistent foot paths: fixed in the world in stance, the animal's path blended between footholds in swing.

    Args:
        raw_xy: (n, 4, 2) the animal's paths, world, m.
        raw_height: (n, 4) above the ground, m.
        track: gives the displacement of a cycle.
        stances: of each leg.
        ground_z: height of a standing foot's centre, m.
        rate_hz: of the samples.
        config: of the swings.

    Returns:
        (n, 4, 3) centres of the feet, world, m; twice continuously differentiable, at rest on the ground at every
        touch-down and lift-off.
    """
    n = len(raw_xy)
    feet = np.empty((n, 4, 3))
    for leg in range(4):
        raw = np.concatenate([raw_xy[:, leg], raw_height[:, leg, None]], axis=1)
        feet[:, leg] = _plant(_Path(raw, track), stances[leg], ground_z, rate_hz, config)
    return feet


class _Path:
    """A path on n samples, continued over the seam of a cycle."""

    def __init__(self, samples: Array, track: Track) -> None:
        self.samples, self.track, self.n = samples, track, len(samples)
        self.periodic = track.cycle is not None

    def __call__(self, index: NDArray[np.int_]) -> Array:
        if not self.periodic:
            return self.samples[index]
        points = self.samples[index % self.n].copy()
        lap = index // self.n
        for cycles in np.unique(lap):
            points[lap == cycles, :2] = self.track.moved(points[lap == cycles, :2], int(cycles))
        return points

    def write(self, out: Array, index: NDArray[np.int_], points: Array) -> None:
        if not self.periodic:
            out[index] = points
            return
        lap = index // self.n
        for cycles in np.unique(lap):
            rows = lap == cycles
            out[index[rows] % self.n, :2] = self.track.moved(points[rows, :2], -int(cycles))
            out[index[rows] % self.n, 2] = points[rows, 2]


def _plant(path: _Path, stances: list[Stance], ground_z: float, rate_hz: float, config: SwingConfig) -> Array:
    n = path.n
    out = path.samples + np.array([0.0, 0.0, ground_z])
    holds: dict[int, Array] = {}
    for start, end in stances:
        hold = _foothold(path(np.arange(start, end)))
        holds[start] = hold
        path.write(out, np.arange(start, end), np.tile([*hold, ground_z], (end - start, 1)))
    if stances and stances[0] == (0, n):
        return out
    for lift_off, touch_down in swings_of(stances, n, path.periodic):
        before = next((holds[s] for s, e in stances if e == lift_off), None)
        after = next((holds[s] for s, _ in stances if s == touch_down), None)
        if after is None and path.periodic:
            after = path.track.moved(holds[touch_down - n], 1)
        first = lift_off - 1 if before is not None else lift_off  # the last sample at rest
        last = touch_down if after is not None else touch_down - 1
        index = np.arange(first, last + 1)
        swing = _swing(path(index), before, after, rate_hz, config)
        swing[:, 2] += ground_z
        keep = slice(1 if before is not None else 0, len(index) - (1 if after is not None else 0))
        path.write(out, index[keep], swing[keep])
    return out


def _foothold(raw: Array) -> Array:
    """Where a foot stands: mean of its raw path, weighted towards the middle of the stance."""
    weight = np.sin(np.pi * (np.arange(len(raw)) + 0.5) / len(raw)) ** 2
    return weight @ raw[:, :2] / weight.sum()


def _swing(raw: Array, before: Array | None, after: Array | None, rate_hz: float, config: SwingConfig) -> Array:
    """A smooth path (m, 3) near `raw` from rest at `before` to rest at `after` ((2,) or None where the recording ends)."""
    m = len(raw)
    share = np.arange(m) / max(m - 1, 1)
    blend = share**3 * (10 - 15 * share + 6 * share**2)
    gap0 = np.zeros(3) if before is None else np.array([*before, 0.0]) - raw[0]
    gap1 = np.zeros(3) if after is None else np.array([*after, 0.0]) - raw[-1]
    if before is None:
        gap0 = gap1
    if after is None:
        gap1 = gap0
    target = raw + (1 - blend)[:, None] * gap0 + blend[:, None] * gap1
    basis, penalty = _spline(m, rate_hz, config)
    ends = (before is not None, after is not None)
    result = np.stack([_fit(basis, penalty, target[:, axis], ends, None) for axis in range(2)], axis=1)
    clearance = max(float(raw[:, 2].max()), config.min_clearance_m)
    shape = np.maximum(target[:, 2], 0.0)
    if shape.max() < 1e-3:
        shape = np.sin(np.pi * share) ** 2
    z = shape
    for _ in range(4):
        z = _fit(basis, penalty, shape, ends, 0.0)
        shape = shape * (clearance / max(z.max(), 1e-6))
    return np.concatenate([result, z[:, None]], axis=1)


def _spline(m: int, rate_hz: float, config: SwingConfig) -> tuple[Array, Array]:
    """Cubic B-spline basis (m, k) on m samples, and the penalty (k − 3, k) on its third differences."""
    from scipy.interpolate import BSpline

    pieces = max(6, round((m - 1) / rate_hz / config.knot_s))
    knots = np.concatenate([np.zeros(_DEGREE), np.linspace(0, 1, pieces + 1), np.ones(_DEGREE)])
    basis = BSpline.design_matrix(np.linspace(0, 1, m), knots, _DEGREE).toarray()
    third = np.diff(np.eye(pieces + _DEGREE), n=3, axis=0)
    return basis, np.sqrt(config.stiffness * m / pieces) * third


def _fit(basis: Array, penalty: Array, target: Array, at_rest: tuple[bool, bool], lower: float | None) -> Array:
    """Penalised least squares; the first and last three coefficients are fixed where the foot is at rest there."""
    from scipy.optimize import lsq_linear

    k = basis.shape[1]
    free = np.ones(k, dtype=bool)
    fixed = np.zeros(k)
    if at_rest[0]:
        free[:3], fixed[:3] = False, target[0]
    if at_rest[1]:
        free[-3:], fixed[-3:] = False, target[-1]
    A = np.concatenate([basis, penalty])
    b = np.concatenate([target, np.zeros(len(penalty))]) - A @ fixed
    coefficients = fixed.copy()
    if lower is None:
        coefficients[free] = np.linalg.lstsq(A[:, free], b, rcond=None)[0]
    else:
        coefficients[free] = lsq_linear(A[:, free], b, bounds=(lower, np.inf)).x
    return np.asarray(basis @ coefficients)
