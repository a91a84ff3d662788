"""Makes the trunk's motion one that the feet on the ground can bring about.

An animal's trunk moves as its own mass, its light legs and its narrow stance demand. On a robot with other masses and a wider
stance the same trunk motion asks for forces that the standing feet cannot give: on two feet, no moment about the line
between them; in flight, nothing. Left as it is, the robot must deviate, in a way of its own. Here the trunk's path is changed
by the least that removes the contradiction, and the feet come closer together or further apart if that costs
less. "Least" is measured as the imitation reward measures a deviation.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fastmimic.conventions import GRAVITY
from fastmimic.motion.contacts import Stances
from fastmimic.motion.retarget_cycle import Track
from fastmimic.motion.retarget_dynamics import Demand, push_directions
from fastmimic.robot import Robot

Array = NDArray[np.float64]


@dataclass(frozen=True)
class BalanceConfig:
    """How the trunk is balanced.

    Attributes:
        rounds: steps of the solver at most; 0 leaves the trunk as the animal's.
        hz: fastest motion of the correction.
        linear_weight, angular_weight: of a residual acceleration, s⁴, against the deviation from the animal.
        outlier: weighted residual beyond which the cost grows only linearly: landings and lift-offs are shorter than any correction.
        friction: coefficient that the motion may count on.
        force_weight: of the pushes squared, in quarters of the weight: spreads the load over the feet and keeps the centre of
            pressure in the middle of the support, so that the robot can correct.
        min_load: of each standing foot, share of an even load: a foot that is said to stand must be felt to stand, and the
            centre of pressure keeps that far from the edge of the support.
        sample_s: time between the instants that are looked at.
    """

    rounds: int = 8
    hz: float = 6.0
    linear_weight: float = 1.0
    angular_weight: float = 0.2
    outlier: float = 3.0
    friction: float = 0.6
    force_weight: float = 0.5
    min_load: float = 0.2
    sample_s: float = 0.01


_POSITION_COST = np.array([20.0, 20.0, 100.0, 10.0, 10.0, 10.0])
_VELOCITY_COST = np.array([2.0, 2.0, 10.0, 1.0, 1.0, 1.0])
"""Exponents of the imitation reward: root position, orientation; linear and angular velocity."""
_ADMM_STEP = 3.0
_ADMM_ROUNDS = 200


class TrunkSpline:
    """Uniform cubic B-splines over a motion, periodic or not: deviations of the trunk as functions of time."""

    def __init__(self, n: int, rate_hz: float, periodic: bool, hz: float) -> None:
        duration = n / rate_hz
        self.pieces = max(4, round(2 * hz * duration))
        self.periodic = periodic
        self.size = self.pieces if periodic else self.pieces + 3
        self.knot_s = duration / self.pieces
        self.n = n

    def rows(self, sample: NDArray[np.int_]) -> tuple[NDArray[np.int_], Array]:
        """Indices (k, 4) of the coefficients at samples (k,), and their weights (3, k, 4) for value, 1st and 2nd derivative."""
        at = sample / self.n * self.pieces
        piece = np.minimum(at.astype(int), self.pieces - 1)
        u = at - piece
        one = np.ones_like(u)
        value = np.stack([(1 - u) ** 3, 3 * u**3 - 6 * u**2 + 4, -3 * u**3 + 3 * u**2 + 3 * u + 1, u**3], axis=-1) / 6
        first = np.stack([-((1 - u) ** 2), 3 * u**2 - 4 * u, -3 * u**2 + 2 * u + 1, u**2], axis=-1) / 2
        second = np.stack([1 - u, 3 * u - 2 * one, -3 * u + one, u], axis=-1)
        index = piece[:, None] + np.arange(4)
        if self.periodic:
            index %= self.size
        return index, np.stack([value, first / self.knot_s, second / self.knot_s**2])

    def values(self, coefficients: Array) -> Array:
        """(n, c) of coefficients (size, c)."""
        index, weight = self.rows(np.arange(self.n))
        return np.einsum("ka,kac->kc", weight[0], coefficients[index])


def balance(
    robot: Robot,
    spline: TrunkSpline,
    footing: Footing,
    demand_of: Callable[[Deviation], Demand],
    config: BalanceConfig,
) -> Deviation:
    """The deviation that makes a motion feasible at the least change.

    Args:
        robot: mass and inertia.
        spline: of the trunk's deviation.
        footing: which foot stands where.
        demand_of: what the motion with a deviation asks of the ground, at the same samples each time.
        config: weights.
    """
    best = Deviation(np.zeros((spline.size, 6)), np.zeros((footing.count, 2)))
    if config.rounds == 0:
        return best
    problem = _Problem(robot, spline, footing, demand_of(best), best, config)
    damping = 0.01
    for _ in range(config.rounds):
        trial = problem.solve(damping)
        trial_problem = _Problem(robot, spline, footing, demand_of(trial), trial, config)
        gain = 1.0 - trial_problem.cost / problem.cost
        if gain > 0:
            best, problem, damping = trial, trial_problem, damping / 5
            if gain < 0.01:
                break
        else:
            damping = 10 * damping
    return best


class _Problem:
    """Least squares in the deviation and the forces together, linearised about one deviation.

    Per sample, the residual is r = r₀ + B d − G x: what the motion demands, what a further deviation d adds, and what pushes
    x ≥ 0 along the edges of the friction pyramids give; all as weighted accelerations of the whole robot.
    """

    def __init__(
        self,
        robot: Robot,
        spline: TrunkSpline,
        footing: Footing,
        demand: Demand,
        present: Deviation,
        config: BalanceConfig,
    ) -> None:
        self._present, self._footing = present, footing
        self._weight = np.sqrt(np.array([config.linear_weight] * 3 + [config.angular_weight] * 3))
        self._scale = self._weight / np.array([robot.mass] * 3 + list(robot.inertia_b.diagonal()))
        self._index, self._basis = spline.rows(demand.sample)
        self._k, self._size = len(demand.sample), 6 * spline.size + 2 * footing.count
        self._push_force, push_wrench, self._can = push_directions(demand, config.friction)
        self._unit = robot.mass * GRAVITY / 4
        self._force_weight = config.force_weight
        self._pushes = self._unit * np.swapaxes(push_wrench * self._scale, 1, 2) * self._can[:, None, :]
        even = np.clip(demand.wrench[:, 2], 0.0, None) / np.maximum(demand.stands.sum(axis=1), 1)
        least = np.repeat((config.min_load * even / (4 * self._unit))[:, None], 16, axis=1)  # on four edges a foot
        self._least = least
        self._demand = demand.wrench * self._scale - np.einsum("kri,ki->kr", self._pushes, least)
        self._column = self._columns(6 * spline.size)
        self._change = self._change_cost(config)
        best = self._best_pushes()
        residual = self._demand - np.einsum("kri,ki->kr", self._pushes, best)
        size, c = np.linalg.norm(residual, axis=1), config.outlier
        vector = present.vector()
        self.residual = residual / self._weight
        misfit = np.where(size < c, size**2, c * (2 * size - c)).sum() + config.force_weight * np.sum(best**2)
        self.cost = float(misfit + vector @ (self._change @ vector))
        self._trust = np.minimum(1.0, c / np.maximum(size, 1e-9))[:, None]
        self._start = best
        self._slope = self._slope_at(best)

    def solve(self, damping: float) -> Deviation:
        """The minimum about the present deviation, held back by `damping`: ADMM, the pushes eliminated sample by sample."""
        from scipy.sparse import diags
        from scipy.sparse.linalg import splu

        G, B, trust = self._pushes, self._slope, self._trust[:, :, None]
        gain = np.swapaxes(G, 1, 2) * trust
        inverse = np.linalg.inv(gain @ G + (self._force_weight + _ADMM_STEP) * np.eye(16))
        weight = trust * np.eye(6) - np.swapaxes(gain, 1, 2) @ inverse @ gain
        curvature = self._scatter(np.swapaxes(B, 1, 2) @ weight @ B)
        hold = damping * (diags(curvature.diagonal() + 1e-9) + self._change)
        factor = splu((curvature + self._change + hold).tocsc())
        vector = self._present.vector()
        fixed = np.einsum("krc,krs,ks->kc", B, weight, self._demand)
        z, u = self._start, np.zeros_like(self._start)
        step = np.zeros(self._size)
        for _ in range(_ADMM_ROUNDS):
            aim = _ADMM_STEP * (z - u)
            given = np.einsum("krc,kir,kij,kj->kc", B, gain, inverse, aim, optimize=True)
            step = factor.solve(self._gather(given - fixed) - self._change @ vector)
            wanted = self._demand + np.einsum("krc,kc->kr", B, step[self._column])
            x = np.einsum("kij,kj->ki", inverse, np.einsum("kir,kr->ki", gain, wanted) + aim)
            x = 1.6 * x - 0.6 * z
            z = np.maximum(x + u, 0.0) * self._can
            u = (u + x - z) * self._can
        return self._present.plus(step)

    def _best_pushes(self) -> Array:
        """The pushes (k, 16) that come nearest to the demand, in units of a quarter of the weight."""
        from scipy.optimize import nnls

        small = np.sqrt(self._force_weight) * np.eye(16)
        return np.stack(
            [
                nnls(np.concatenate([matrix, small]), np.concatenate([wanted, np.zeros(16)]))[0]
                for matrix, wanted in zip(self._pushes, self._demand, strict=True)
            ]
        )

    def _slope_at(self, pushes: Array) -> Array:
        """B (k, 6, 32): by the trunk's acceleration, by the ground forces' moment about the displaced centre of mass, and by that of
        the displaced feet."""
        forces = self._unit * (self._push_force * ((pushes + self._least) * self._can)[..., None]).reshape(self._k, 4, 4, 3).sum(axis=2)
        lever = np.zeros((self._k, 6, 6))
        for axis in range(3):
            lever[:, 3:, axis] = np.cross(np.eye(3)[axis], forces.sum(axis=1)) * self._scale[3:]
        trunk = np.diag(self._weight)[None, :, :, None] * self._basis[2][:, None, None, :]
        trunk = trunk + lever[..., None] * self._basis[0][:, None, None, :]
        c, s, zero = np.cos(self._footing.turn), np.sin(self._footing.turn), np.zeros_like(self._footing.turn)
        moved = np.stack([np.stack([c, s, zero], axis=-1), np.stack([-s, c, zero], axis=-1)], axis=2)  # (k, 4, 2, 3)
        feet = np.zeros((self._k, 6, 8))
        feet[:, 3:] = np.swapaxes(-np.cross(moved, forces[:, :, None]).reshape(self._k, 8, 3) * self._scale[3:], 1, 2)
        return np.concatenate([trunk.reshape(self._k, 6, 24), feet], axis=2)

    def _columns(self, first_foot: int) -> NDArray[np.int_]:
        """Which unknowns act at each sample, (k, 32)."""
        trunk = 6 * self._index[:, None, :] + np.arange(6)[None, :, None]
        feet = first_foot + 2 * np.maximum(self._footing.stance, 0)[:, :, None] + np.arange(2)
        return np.concatenate([trunk.reshape(self._k, 24), feet.reshape(self._k, 8)], axis=1)

    def _gather(self, per_sample: Array) -> Array:
        """Sums (k, 32) into (size,)."""
        return np.bincount(self._column.ravel(), per_sample.ravel(), minlength=self._size)

    def _scatter(self, per_sample: Array):  # type: ignore[no-untyped-def]
        """Sums (k, 32, 32) into a sparse (size, size)."""
        from scipy.sparse import csr_matrix

        columns = self._column
        rows = np.broadcast_to(columns[:, :, None], per_sample.shape)
        other = np.broadcast_to(columns[:, None, :], per_sample.shape)
        return csr_matrix((per_sample.ravel(), (rows.ravel(), other.ravel())), shape=(self._size, self._size))

    def _change_cost(self, config: BalanceConfig):  # type: ignore[no-untyped-def]
        """Quadratic form (size, size) of the deviation from the animal."""
        value, first = self._basis[0], self._basis[1]
        per_sample = np.zeros((self._k, 32, 32))
        blocks = np.einsum("ka,kb,c->kcab", value, value, _POSITION_COST)
        blocks += np.einsum("ka,kb,c->kcab", first, first, _VELOCITY_COST)
        for c in range(6):
            per_sample[:, 4 * c : 4 * c + 4, 4 * c : 4 * c + 4] = blocks[:, c]
        for leg in range(4):
            for column in (24 + 2 * leg, 25 + 2 * leg):
                per_sample[:, column, column] = config.foot_weight * (self._footing.stance[:, leg] >= 0)
        return self._scatter(per_sample)
