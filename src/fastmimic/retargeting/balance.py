"""Changes the trunk's motion as little as possible until the standing feet can produce it.

An animal's trunk motion suits its mass, light legs and narrow stance. On a robot it can need forces that the standing
feet cannot give: two feet give no moment about the line between them, and there is none in flight. The robot would
then deviate from its reference more and more. A change is measured like a deviation in the imitation reward.

The problem is least squares in the deviation d and in pushes x ≥ 0 along the edges of the feet's friction pyramids:

    min Σ ρ(r) + dᵀC d + ε‖x‖²,    r = r₀ + B d − G x

r₀ is the demand of the present motion, as acceleration, by inverse dynamics of the whole robot, linearised at each step
(Levenberg–Marquardt). ADMM solves the convex problem in between; the pushes are eliminated sample by sample.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from fastmimic.base.arrays import Array
from fastmimic.base.configuration import documented, parameter
from fastmimic.base.conventions import GRAVITY
from fastmimic.motion.ground import GroundDemand, push_directions
from fastmimic.robot import Robot

_AT_REST: Final = 3  # coefficients of a cubic B-spline that fix position, velocity and acceleration at an end


class TrunkSpline:
    """Deviations of a trunk over time, as uniform cubic B-splines: six coordinates (x, y, z, roll, pitch, yaw) with
    common knots, `size` coefficients each. If not periodic, they vanish at both ends with velocity and acceleration."""

    def __init__(self, n: int, rate_hz: float, periodic: bool, hz: float) -> None:
        """`hz` is the highest frequency, with two knots a period, over the `n` samples of a motion."""
        duration = n / rate_hz
        self._pieces = max(4, round(2 * hz * duration))
        self._periodic = periodic
        self._knot_s = duration / self._pieces
        self._n = n
        self.size = self._pieces if periodic else max(1, self._pieces + 3 - 2 * _AT_REST)

    def basis(self, sample: NDArray[np.int_]) -> tuple[NDArray[np.int_], Array]:
        """Indices (k, 4) of the coefficients at samples (k,); weights (3, k, 4) in value and two derivatives."""
        at = sample / self._n * self._pieces
        piece = np.minimum(at.astype(int), self._pieces - 1)
        u = at - piece
        value = np.stack([(1 - u) ** 3, 3 * u**3 - 6 * u**2 + 4, -3 * u**3 + 3 * u**2 + 3 * u + 1, u**3], axis=-1) / 6
        first = np.stack([-((1 - u) ** 2), 3 * u**2 - 4 * u, -3 * u**2 + 2 * u + 1, u**2], axis=-1) / 2
        second = np.stack([1 - u, 3 * u - 2, -3 * u + 1, u], axis=-1)
        index = piece[:, None] + np.arange(4)
        weight = np.stack([value, first / self._knot_s, second / self._knot_s**2])
        if self._periodic:
            return index % self.size, weight
        inside = (index >= _AT_REST) & (index < self._pieces + 3 - _AT_REST)
        return np.where(inside, index - _AT_REST, 0), weight * inside

    def values(self, coefficients: Array) -> Array:
        """All samples (n, 6) of coefficients (size, 6)."""
        index, weight = self.basis(np.arange(self._n))
        return np.einsum("ka,kac->kc", weight[0], coefficients[index])


@documented
@dataclass(frozen=True)
class BalanceConfig:
    """How the trunk is balanced."""

    rounds: int = parameter(8, about="linearisations at most; 0 leaves the trunk as the animal's")
    hz: float = parameter(12.0, unit="Hz", above=0.0, about="highest frequency of the correction")
    linear_weight: float = parameter(16.0, unit="s⁴", about="weight of a residual linear acceleration")
    angular_weight: float = parameter(3.0, unit="s⁴", about="weight of a residual angular acceleration")
    outlier: float = parameter(
        6.0,
        above=0.0,
        about="weighted residual beyond which the cost grows linearly: a leg that is thrown forwards acts for less time"
        " than any correction of the trunk",
    )
    friction: float = parameter(0.6, about="coefficient of friction that the motion may use")
    force_weight: float = parameter(
        1.0,
        about="weight of the squared pushes, in quarters of the robot's weight: it spreads the load and keeps the"
        " centre of pressure inside the support",
    )
    min_load: float = parameter(0.2, about="least load of each standing foot, share of an even load")
    sample_s: float = parameter(0.01, unit="s", above=0.0, about="time between the instants of the demand")


_POSITION_COST: Final = np.array([20.0, 20.0, 500.0, 10.0, 10.0, 10.0])
_VELOCITY_COST: Final = np.array([2.0, 2.0, 50.0, 1.0, 1.0, 1.0])
"""Exponents of the imitation reward for root position and angle, linear and angular velocity. Height counts much more,
because a trunk could otherwise avoid most infeasible forces by hopping, unlike the animal."""
_ADMM_STEP: Final = 3.0
_ADMM_RELAXATION: Final = 1.6
_ADMM_ROUNDS: Final = 200
_ENOUGH: Final = 0.01  # relative gain at which the solver stops


def balance(
    robot: Robot, spline: TrunkSpline, demand_of: Callable[[Array], GroundDemand], config: BalanceConfig
) -> Array:
    """The least deviation of the trunk that makes a motion feasible, as coefficients (size, 6) of `spline`. They are x,
    y, z in the heading frame, m; roll, pitch, yaw, rad. `demand_of` gives the ground wrench of the motion for such
    coefficients, always at the same samples."""
    best = np.zeros((spline.size, 6))
    if config.rounds == 0:
        return best
    problem = _Problem(robot, spline, demand_of(best), best, config)
    damping = 0.01
    for _ in range(config.rounds):
        trial = problem.solve(damping)
        trial_problem = _Problem(robot, spline, demand_of(trial), trial, config)
        gain = 1.0 - trial_problem.cost / problem.cost
        if gain > 0:
            best, problem, damping = trial, trial_problem, damping / 5
            if gain < _ENOUGH:
                break
        else:
            damping *= 10
    return best


class _Problem:
    """The problem linearised about one deviation. Per sample (k of them): 6 residuals, 24 coefficients, 16 pushes."""

    def __init__(
        self, robot: Robot, spline: TrunkSpline, demand: GroundDemand, present: Array, config: BalanceConfig
    ) -> None:
        self._present = present
        self._epsilon = config.force_weight
        self._weight = np.sqrt(np.array([config.linear_weight] * 3 + [config.angular_weight] * 3))
        scale = self._weight / np.array([robot.mass] * 3 + list(robot.inertia_b.diagonal()))
        index, basis = spline.basis(demand.sample)
        self._k = len(demand.sample)
        self._column = (6 * index[:, None, :] + np.arange(6)[None, :, None]).reshape(self._k, 24)
        self._change = self._change_cost(basis)

        unit = robot.mass * GRAVITY / 4
        force, wrench, can = push_directions(demand, config.friction)
        self._can = can
        self._pushes = unit * np.swapaxes(wrench * scale, 1, 2) * can[:, None, :]
        even = np.maximum(demand.wrench[:, 2], 0.0) / np.maximum(demand.stands.sum(axis=1), 1)
        least = (config.min_load * even / (4 * unit))[:, None] * can  # equal on a foot's four edges
        self._demand = demand.wrench * scale - np.einsum("kri,ki->kr", self._pushes, least)
        self._start = self._best_pushes()
        residual = self._demand - np.einsum("kri,ki->kr", self._pushes, self._start)
        size, c = np.linalg.norm(residual, axis=1), config.outlier
        self._trust = np.minimum(1.0, c / np.maximum(size, 1e-9))[:, None, None]
        misfit = np.where(size < c, size**2, c * (2 * size - c)).sum()
        vector = present.ravel()
        self.cost = float(misfit + self._epsilon * np.sum(self._start**2) + vector @ (self._change @ vector))
        ground_force = unit * np.einsum("kif,ki->kf", force, (self._start + least) * can)
        self._slope = self._slope_of(basis, ground_force, scale)

    def solve(self, damping: float) -> Array:
        """Coefficients (size, 6) at the minimum, drawn towards the present ones by `damping`."""
        from scipy.sparse import diags
        from scipy.sparse.linalg import splu

        G, B = self._pushes, self._slope
        gain = np.swapaxes(G, 1, 2) * self._trust
        inverse = np.linalg.inv(gain @ G + (self._epsilon + _ADMM_STEP) * np.eye(16))
        weight = self._trust * np.eye(6) - np.swapaxes(gain, 1, 2) @ inverse @ gain
        curvature = self._scatter(np.swapaxes(B, 1, 2) @ weight @ B)
        hold = damping * (diags(curvature.diagonal() + 1e-9) + self._change)
        factor = splu((curvature + self._change + hold).tocsc())
        given = np.swapaxes(B, 1, 2) @ np.swapaxes(gain, 1, 2) @ inverse
        by_gain = inverse @ gain
        vector = self._present.ravel()
        fixed = self._gather(np.einsum("krc,krs,ks->kc", B, weight, self._demand)) + self._change @ vector
        step, z, u = np.zeros_like(vector), self._start, np.zeros_like(self._start)
        for _ in range(_ADMM_ROUNDS):
            aim = _ADMM_STEP * (z - u)
            step = factor.solve(self._gather(np.einsum("kci,ki->kc", given, aim)) - fixed)
            wanted = self._demand + np.einsum("krc,kc->kr", B, step[self._column])
            x = np.einsum("kir,kr->ki", by_gain, wanted) + np.einsum("kij,kj->ki", inverse, aim)
            x = _ADMM_RELAXATION * x + (1 - _ADMM_RELAXATION) * z
            z = np.maximum(x + u, 0.0) * self._can
            u = (u + x - z) * self._can
        return (vector + step).reshape(-1, 6)

    def _best_pushes(self) -> Array:
        """The pushes (k, 16) nearest to the demand, in quarters of the weight."""
        from scipy.optimize import nnls

        small, zero = np.sqrt(self._epsilon) * np.eye(16), np.zeros(16)
        return np.stack(
            [
                nnls(np.concatenate([matrix, small]), np.concatenate([wanted, zero]))[0]
                for matrix, wanted in zip(self._pushes, self._demand, strict=True)
            ]
        )

    def _slope_of(self, basis: Array, ground_force: Array, scale: Array) -> Array:
        """B (k, 6, 24): by the trunk's acceleration, and by the ground's moment about the displaced centre of mass."""
        lever = np.zeros((self._k, 6, 6))
        for axis in range(3):
            lever[:, 3:, axis] = np.cross(np.eye(3)[axis], ground_force) * scale[3:]
        slope = np.diag(self._weight)[None, :, :, None] * basis[2][:, None, None, :]
        slope = slope + lever[..., None] * basis[0][:, None, None, :]
        return np.asarray(slope.reshape(self._k, 6, 24))

    def _change_cost(self, basis: Array) -> Any:
        """C (sparse): the quadratic cost of deviating from the animal."""
        per_sample = np.zeros((self._k, 24, 24))
        for c in range(6):
            own = slice(4 * c, 4 * c + 4)
            per_sample[:, own, own] = _POSITION_COST[c] * basis[0][:, :, None] * basis[0][:, None, :]
            per_sample[:, own, own] += _VELOCITY_COST[c] * basis[1][:, :, None] * basis[1][:, None, :]
        return self._scatter(per_sample)

    def _gather(self, per_sample: Array) -> Array:
        """Sums (k, 24) into (unknowns,)."""
        sums = np.bincount(self._column.ravel(), per_sample.ravel(), minlength=self._present.size)
        return sums.astype(np.float64)

    def _scatter(self, per_sample: Array) -> Any:
        """Sums (k, 24, 24) into a sparse (unknowns, unknowns)."""
        from scipy.sparse import csr_matrix

        rows = np.broadcast_to(self._column[:, :, None], per_sample.shape)
        columns = np.broadcast_to(self._column[:, None, :], per_sample.shape)
        size = self._present.size
        return csr_matrix((per_sample.ravel(), (rows.ravel(), columns.ravel())), shape=(size, size))
