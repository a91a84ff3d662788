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

from fastmimic.conventions import LEFT
from fastmimic.motion.retarget_dynamics import Demand, ground_forces
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
        width_weight: of a change of the half stance width, 1/m².
        friction: coefficient that the motion may count on.
        sample_s: time between the instants that are looked at.
    """

    rounds: int = 8
    hz: float = 6.0
    linear_weight: float = 1.0
    angular_weight: float = 0.2
    outlier: float = 3.0
    width_weight: float = 30.0
    friction: float = 0.5
    sample_s: float = 0.01


_POSITION_COST = np.array([20.0, 20.0, 20.0, 10.0, 10.0, 10.0])
_VELOCITY_COST = np.array([2.0, 2.0, 2.0, 1.0, 1.0, 1.0])
"""Exponents of the imitation reward: root position, orientation; linear and angular velocity."""


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


@dataclass(frozen=True, eq=False)
class Deviation:
    """How the robot's trunk and stance differ from the scaled animal's.

    Attributes:
        trunk: (size, 6) spline coefficients of x, y, z, roll, pitch, yaw in the heading frame, m and rad.
        width: change of the half stance width, m.
    """

    trunk: Array
    width: float

    def vector(self) -> Array:
        return np.concatenate([self.trunk.reshape(-1), [self.width]])

    @classmethod
    def of_vector(cls, vector: Array) -> "Deviation":
        return cls(vector[:-1].reshape(-1, 6), float(vector[-1]))


def balance(
    robot: Robot, spline: TrunkSpline, demand_of: Callable[[Deviation], Demand], config: BalanceConfig
) -> Deviation:
    """The deviation that makes a motion feasible at the least change (Levenberg–Marquardt).

    Args:
        robot: mass and inertia.
        spline: of the deviation.
        demand_of: what the motion with a deviation asks of the ground, at the same samples each time.
        config: weights.
    """
    best = Deviation(np.zeros((spline.size, 6)), 0.0)
    if config.rounds == 0:
        return best
    problem = _Problem(robot, spline, demand_of(best), config)
    damping = 0.01
    for _ in range(config.rounds):
        trial = problem.step(best, damping)
        trial_problem = _Problem(robot, spline, demand_of(trial), config)
        gain = 1.0 - trial_problem.cost(trial) / problem.cost(best)
        if gain > 0:
            best, problem, damping = trial, trial_problem, damping / 4
            if gain < 0.01:
                break
        else:
            damping = 10 * damping
    return best


class _Problem:
    """The least squares problem, linearised about one deviation."""

    def __init__(self, robot: Robot, spline: TrunkSpline, demand: Demand, config: BalanceConfig) -> None:
        forces, residual, blind = ground_forces(robot, demand, config.friction)
        weight = np.sqrt(np.array([config.linear_weight] * 3 + [config.angular_weight] * 3))
        self._index, self._basis = spline.rows(demand.sample)
        self._k, self._unknowns = len(demand.sample), 6 * spline.size + 1
        self._residual = residual * weight
        size = np.linalg.norm(self._residual, axis=1)
        self._robust = np.sqrt(np.minimum(1.0, config.outlier / np.maximum(size, 1e-9)))
        self._huber = np.where(size < config.outlier, size**2, config.outlier * (2 * size - config.outlier)).sum()
        self._blind = blind * (weight * self._robust[:, None])[:, :, None]
        self._jacobian = self._linearise(forces, robot.inertia_b.diagonal())
        self._position = self._diagonal(self._basis[0], np.sqrt(_POSITION_COST))
        self._velocity = self._diagonal(self._basis[1], np.sqrt(_VELOCITY_COST))
        self._width_cost = config.width_weight * self._k

    def cost(self, deviation: Deviation) -> float:
        vector = deviation.vector()
        change = np.sum((self._position @ vector) ** 2) + np.sum((self._velocity @ vector) ** 2)
        return float(self._huber + change + self._width_cost * deviation.width**2)

    def step(self, present: Deviation, damping: float) -> Deviation:
        """The minimum of the linearised problem, held back towards `present` by `damping`."""
        from scipy.sparse import csr_matrix
        from scipy.sparse.linalg import spsolve

        vector = present.vector()
        target = self._jacobian @ vector - (self._residual * self._robust[:, None]).ravel()
        width = csr_matrix(([self._width_cost], ([self._unknowns - 1], [self._unknowns - 1])), shape=(self._unknowns,) * 2)
        change = self._position.T @ self._position + self._velocity.T @ self._velocity + width
        curvature = self._jacobian.T @ self._jacobian
        hold = damping * (csr_matrix(np.diag(curvature.diagonal() + 1e-6)) + change)
        matrix = curvature + change + hold
        return Deviation.of_vector(spsolve(matrix.tocsc(), self._jacobian.T @ target + hold @ vector))

    def _linearise(self, forces: Array, inertia: Array):  # type: ignore[no-untyped-def]
        """By the deviation's acceleration, and by the moment of the ground's forces about the displaced centre of mass."""
        from scipy.sparse import csr_matrix

        lever = np.zeros((self._k, 6, 6))
        for axis in range(3):
            lever[:, 3:, axis] = np.cross(np.eye(3)[axis], forces.sum(axis=1)) / inertia
        outward = np.zeros((self._k, 6))
        side = np.where(LEFT, 1.0, -1.0)[None, :, None] * np.array([0.0, 1.0, 0.0])
        outward[:, 3:] = -np.cross(side, forces).sum(axis=1) / inertia
        by_width = np.einsum("krc,kc->kr", self._blind, outward)
        by_trunk = (
            self._blind[..., None] * self._basis[2][:, None, None]
            + (self._blind @ lever)[..., None] * self._basis[0][:, None, None]
        )
        rows = np.broadcast_to(np.arange(6 * self._k).reshape(-1, 6, 1, 1), by_trunk.shape)
        columns = np.broadcast_to(
            6 * self._index[:, None, None] + np.arange(6)[None, None, :, None], by_trunk.shape
        )
        return csr_matrix(
            (
                np.concatenate([by_trunk.ravel(), by_width.ravel()]),
                (
                    np.concatenate([rows.ravel(), np.arange(6 * self._k)]),
                    np.concatenate([columns.ravel(), np.full(6 * self._k, self._unknowns - 1)]),
                ),
            ),
            shape=(6 * self._k, self._unknowns),
        )

    def _diagonal(self, basis: Array, weight: Array):  # type: ignore[no-untyped-def]
        from scipy.sparse import csr_matrix

        rows = np.repeat(np.arange(6 * self._k).reshape(self._k, 6, 1), 4, axis=2)
        columns = 6 * self._index[:, None, :] + np.arange(6)[None, :, None]
        values = weight[None, :, None] * basis[:, None, :]
        return csr_matrix((values.ravel(), (rows.ravel(), columns.ravel())), shape=(6 * self._k, self._unknowns))
