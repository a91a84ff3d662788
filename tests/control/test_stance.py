"""The stance forces are what the stated optimisation problem says, and a failure of the solver is survived."""

import dataclasses

import daqp
import numpy as np
import pytest

from control.bodies import body
from fastmimic.base.conventions import GRAVITY
from fastmimic.control.config import ControllerConfig, StanceConfig, pack_config
from fastmimic.control.controller import SCRATCH, constant_gains_of
from fastmimic.control.native import make_workspace
from fastmimic.control.stance import (
    _HOLD_STEPS,
    MAX_CONSTRAINTS,
    MAX_VARIABLES,
    invert_symmetric_3x3,
    stance_forces,
)
from fastmimic.robot.robot import A1_MASS_KG
from fastmimic.robot.state import MEMORY, MODEL

MASS = 12.0
WEIGHT = MASS * GRAVITY
INERTIA = np.array([[0.11, 0.004, -0.01], [0.004, 0.34, 0.002], [-0.01, 0.002, 0.37]])
STANCE = StanceConfig(
    acceleration_weight=(1.0, 2.0, 3.0, 10.0, 5.0, 1.0),
    force_weight=1e-4,
    friction=0.5,
    friction_sides=4,
    min_force=0.05,
    max_force=1.5,
)
STILL = np.zeros(6)


class Stance:
    """The QP of one robot, with everything around it at hand."""

    def __init__(self, arms: np.ndarray | None = None, stance: StanceConfig = STANCE) -> None:
        self.config = pack_config(ControllerConfig(stance=stance), body(MASS))
        self.stance = stance
        self.arms = np.array(arms if arms is not None else square(0.2, 0.13, 0.27))
        self.memory = np.zeros(1, MEMORY)
        self.memory["friction"] = stance.friction
        self.qp = make_workspace(MAX_VARIABLES, MAX_CONSTRAINTS)
        self.model, self.gain, self.scratch = np.zeros(1, MODEL), constant_gains_of(stance), np.zeros(1, SCRATCH)
        self.model["mass"] = MASS
        self.scratch["inverse_inertia"], self.scratch["against"] = np.linalg.inv(INERTIA), (0.0, 0.0, GRAVITY)
        self.scratch["arms"] = self.arms

    def solve(self, desired: np.ndarray, legs: tuple[int, ...]) -> bool:
        self.memory["stance"] = [leg in legs for leg in range(4)]
        self.scratch["desired"] = desired
        records = self.config, self.model, self.gain, self.memory, self.scratch, self.qp
        return stance_forces(*(record[0] for record in records))

    @property
    def force(self) -> np.ndarray:
        return self.memory["force"][0].copy()

    def acceleration(self, force: np.ndarray) -> np.ndarray:
        """(6,) linear and angular acceleration that forces (4, 3) and gravity give the body, by Newton and Euler."""
        linear = force.sum(axis=0) / MASS - np.array([0, 0, GRAVITY])
        moment = np.cross(self.arms, force).sum(axis=0)
        return np.concatenate([linear, np.linalg.solve(INERTIA, moment)])

    def cost(self, force: np.ndarray, desired: np.ndarray) -> float:
        error = self.acceleration(force) - desired
        weight = np.array(self.stance.acceleration_weight)
        return float(error @ (weight * error) + self.stance.force_weight * np.sum(force**2))

    def dense_solution(self, desired: np.ndarray, legs: tuple[int, ...]) -> np.ndarray:
        """The same problem written down as a whole: 12 forces leg by leg, every condition a row."""
        unit = [self.acceleration(f.reshape(4, 3)) - self.acceleration(np.zeros((4, 3))) for f in np.eye(12)]
        a, q = np.array(unit).T, np.diag(self.stance.acceleration_weight)
        hessian = 2 * (a.T @ q @ a + float(self.config["r_weight"][0]) * np.eye(12))
        gradient = -2 * a.T @ q @ (desired - self.acceleration(np.zeros((4, 3))))
        rows, lower, upper = [], [], []
        for leg in range(4):
            x, y, z = np.eye(12)[3 * leg : 3 * leg + 3]
            if leg not in legs:
                rows += [x, y, z]
                lower += [0.0] * 3
                upper += [0.0] * 3
                continue
            for side in (x, y):
                rows += [self.stance.friction * z - side, self.stance.friction * z + side]
                lower += [0.0] * 2
                upper += [1e9] * 2
            for sign in (1, -1) if self.stance.friction_sides == 8 else ():
                rows += [np.sqrt(2) * self.stance.friction * z - (x + sign * y)]
                rows += [np.sqrt(2) * self.stance.friction * z + (x + sign * y)]
                lower += [0.0] * 2
                upper += [1e9] * 2
            rows.append(z)
            lower.append(self.stance.min_force * WEIGHT)
            upper.append(self.stance.max_force * WEIGHT)
        equal = np.where(np.array(lower) == np.array(upper), 5, 0).astype(np.intc)  # DAQP's mark of an equality
        x, _, flag, _ = daqp.solve(hessian, gradient, np.array(rows), np.array(upper), np.array(lower), equal)
        assert flag == 1
        return x.reshape(4, 3)


def square(x: float, y: float, height: float) -> np.ndarray:
    """Feet (FR, FL, RR, RL) on level ground under the centre of mass."""
    return np.array([[x, -y, -height], [x, y, -height], [-x, -y, -height], [-x, y, -height]])


def random_case(rng: np.random.Generator, stance: StanceConfig = STANCE) -> tuple[Stance, np.ndarray, tuple[int, ...]]:
    arms = square(0.2, 0.13, 0.27) + rng.uniform(-0.08, 0.08, (4, 3))
    legs = tuple(int(leg) for leg in np.flatnonzero(rng.random(4) < 0.6)) or (int(rng.integers(4)),)
    return Stance(arms, stance), rng.normal(size=6) * (4, 4, 6, 15, 15, 15), legs


def assert_allowed(case: Stance, force: np.ndarray, legs: tuple[int, ...]) -> None:
    for leg in range(4):
        if leg not in legs:
            np.testing.assert_array_equal(force[leg], 0.0)
            continue
        x, y, z = force[leg]
        assert case.stance.min_force * WEIGHT - 1e-6 <= z <= case.stance.max_force * WEIGHT + 1e-6
        assert max(abs(x), abs(y)) <= case.stance.friction * z + 1e-6


@pytest.mark.nojit
def test_forces_are_those_of_the_problem_written_down_as_a_whole() -> None:
    rng = np.random.default_rng(0)
    at_friction_limit = 0
    for _ in range(100):
        case, desired, legs = random_case(rng)
        assert case.solve(desired, legs)
        np.testing.assert_allclose(case.force, case.dense_solution(desired, legs), atol=1e-5)
        assert_allowed(case, case.force, legs)
        ratio = np.abs(case.force[list(legs), :2]).max(axis=1) / case.force[list(legs), 2]
        at_friction_limit += bool(np.any(ratio > case.stance.friction - 1e-6))
    assert at_friction_limit > 20, "the cases must exercise the friction pyramid"


@pytest.mark.nojit
def test_eight_sides_keep_forces_close_to_the_cone() -> None:
    """No force is further out than the corners of the octagon, μ / cos 22.5°; with four sides some are at μ √2."""
    octagon, furthest = dataclasses.replace(STANCE, friction_sides=8), {4: 0.0, 8: 0.0}
    for stance in (STANCE, octagon):
        rng = np.random.default_rng(0)
        for _ in range(60):
            case, desired, legs = random_case(rng, stance)
            assert case.solve(desired, legs)
            np.testing.assert_allclose(case.force, case.dense_solution(desired, legs), atol=1e-5)
            assert_allowed(case, case.force, legs)
            force = case.force[list(legs)]
            ratio = np.hypot(force[:, 0], force[:, 1]) / force[:, 2] / stance.friction
            furthest[stance.friction_sides] = max(furthest[stance.friction_sides], float(ratio.max()))
    assert furthest[4] == pytest.approx(np.sqrt(2), abs=1e-3)
    assert furthest[8] == pytest.approx(1 / np.cos(np.pi / 8), abs=1e-3)


def test_no_allowed_forces_are_cheaper() -> None:
    """Optimality without any solver: the cost is convex, so that looking around the solution suffices."""
    rng = np.random.default_rng(1)
    for _ in range(20):
        case, desired, legs = random_case(rng)
        case.solve(desired, legs)
        best = case.cost(case.force, desired)
        for _ in range(50):
            other = case.force
            standing = list(legs)
            other[standing] += rng.normal(size=(len(standing), 3)) * rng.choice([0.1, 1.0, 30.0])
            low, high = case.stance.min_force * WEIGHT, case.stance.max_force * WEIGHT
            other[standing, 2] = np.clip(other[standing, 2], low, high)
            limit = case.stance.friction * other[standing, 2:]
            other[standing, :2] = np.clip(other[standing, :2], -limit, limit)
            assert case.cost(other, desired) >= best - 1e-9


def test_standing_still_carries_the_weight_in_equal_parts() -> None:
    """Up to the price of force: R makes each newton cost, which takes R m²/(4 q) = 0.13 % off any weight."""
    case = Stance()
    case.solve(STILL, (0, 1, 2, 3))
    share = 1 / (1 + STANCE.force_weight * A1_MASS_KG**2 / (4 * STANCE.acceleration_weight[2]))
    np.testing.assert_allclose(case.force, np.tile([0, 0, share * WEIGHT / 4], (4, 1)), atol=1e-6)
    assert share > 0.998


def test_forces_that_cost_nothing_give_the_wanted_acceleration_exactly() -> None:
    """Four feet can give any moderate acceleration; as R goes to zero nothing is held back."""
    case = Stance(stance=dataclasses.replace(STANCE, force_weight=1e-9))
    desired = np.array([0.5, -0.3, 1.0, 1.0, -2.0, 0.7])
    case.solve(desired, (0, 1, 2, 3))
    np.testing.assert_allclose(case.acceleration(case.force), desired, atol=1e-4)


def test_the_robot_pushes_no_harder_than_allowed_however_much_is_wanted() -> None:
    case = Stance()
    case.solve(np.array([50.0, 0, 100.0, 0, 0, 0]), (1, 2))
    assert_allowed(case, case.force, (1, 2))
    assert case.force[1, 2] == pytest.approx(STANCE.max_force * WEIGHT)
    case.solve(np.array([0, 0, -100.0, 0, 0, 0]), (1, 2))
    np.testing.assert_allclose(case.force[[1, 2], 2], STANCE.min_force * WEIGHT)


@pytest.mark.nojit
def test_a_robot_in_the_air_has_no_forces_and_nothing_to_solve() -> None:
    case = Stance()
    case.solve(STILL, (0, 1))
    assert case.solve(STILL, ())
    np.testing.assert_array_equal(case.force, 0.0)
    assert case.memory["qp_failures"][0] == 0


class TestFailure:
    """A solver that fails is a status that is handled: hold the last forces, then drop them."""

    BROKEN = np.array([np.nan, 0, 0, 0, 0, 0])
    LEGS = (0, 1, 2, 3)

    @pytest.fixture
    def case(self) -> Stance:
        case = Stance()
        case.solve(np.array([0.5, 0, 1.0, 0, 0, 0]), self.LEGS)
        return case

    @pytest.mark.nojit
    def test_holds_the_last_forces_for_a_few_steps_then_drops_them(self, case: Stance) -> None:
        last = case.force
        for _ in range(_HOLD_STEPS):
            assert not case.solve(self.BROKEN, self.LEGS)
            np.testing.assert_array_equal(case.force, last)
        assert not case.solve(self.BROKEN, self.LEGS)
        np.testing.assert_array_equal(case.force, 0.0)

    @pytest.mark.nojit
    def test_is_counted(self, case: Stance) -> None:
        for _ in range(3):
            case.solve(self.BROKEN, self.LEGS)
        assert case.memory["qp_failures"][0] == 3

    @pytest.mark.nojit
    def test_does_not_push_with_a_leg_that_has_taken_off_since(self, case: Stance) -> None:
        case.solve(self.BROKEN, (0, 1, 3))
        np.testing.assert_array_equal(case.force[2], 0.0)
        assert np.all(case.force[[0, 1, 3], 2] > 0)

    def test_is_over_with_the_next_success(self, case: Stance) -> None:
        before = case.force
        for _ in range(_HOLD_STEPS + 5):
            case.solve(self.BROKEN, self.LEGS)
        assert case.solve(np.array([0.5, 0, 1.0, 0, 0, 0]), self.LEGS)
        np.testing.assert_array_equal(case.force, before)
        last = case.force
        case.solve(self.BROKEN, self.LEGS)
        np.testing.assert_array_equal(case.force, last, "the count of failures in a row starts anew")

    @pytest.mark.parametrize("value", [np.nan, np.inf])
    def test_is_noticed_for_every_kind_of_broken_input(self, case: Stance, value: float) -> None:
        for i in range(6):
            desired = np.zeros(6)
            desired[i] = value
            assert not case.solve(desired, self.LEGS)
            assert np.isfinite(case.force).all()


@pytest.mark.nojit
def test_the_inverse_of_the_inertia() -> None:
    out = np.empty((3, 3))
    invert_symmetric_3x3(INERTIA, out)
    np.testing.assert_allclose(out @ INERTIA, np.eye(3), atol=1e-12)


def test_failed_steps_of_a_flight_do_not_carry_over() -> None:
    """A flight between two failures ends the series of failures."""
    case = Stance()
    case.solve(STILL, (0, 1))
    for _ in range(_HOLD_STEPS):
        case.solve(TestFailure.BROKEN, (0, 1))
    case.solve(STILL, ())
    assert case.memory["failed_in_a_row"][0] == 0
