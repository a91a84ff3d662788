"""The structured filter against the same filter with 18 × 18 matrices."""

import numpy as np
import pytest

from estimation.reference_filter import PlainFilter
from fastmimic.base.rotations import matrix_from_quat
from fastmimic.estimation.config import EstimatorConfig
from fastmimic.estimation.estimator import START, Estimator
from fastmimic.estimation.kalman import STATES
from fastmimic.robot import Robot
from fastmimic.robot.state import OBSERVATION, READING

RATE = 500.0
LOADED = 60.0  # N, well above what counts as contact


def dense(state: np.record) -> tuple[np.ndarray, np.ndarray]:
    """Mean (18,) and covariance (18, 18) in the plain filter's order."""
    mean = state["estimate"].T.ravel()
    cov = np.zeros((STATES, 3, STATES, 3))
    for axis in range(3):
        cov[:, axis, :, axis] = state["cov"][axis // 2]
    return mean, cov.reshape(18, 18)


def random_reading(robot: Robot, rng: np.random.Generator, forces: np.ndarray) -> np.ndarray:
    """Sensors of a robot that moves anyhow; their IMU's orientation never changes."""
    reading = np.zeros(1, READING)
    reading["quat"][0] = (0.98, 0.1, -0.05, 0.15) / np.linalg.norm((0.98, 0.1, -0.05, 0.15))
    reading["gyro"] = rng.normal(0, 1.0, 3)
    reading["accel"] = np.array([0.0, 0.0, 9.81]) + rng.normal(0, 3.0, 3)
    reading["joint_pos"] = robot.home_joint_pos + rng.normal(0, 0.1, 12)
    reading["joint_vel"] = rng.normal(0, 2.0, 12)
    reading["foot_force"] = forces
    return reading


@pytest.mark.nojit
@pytest.mark.parametrize("gate", [3.0, 1e6])
def test_it_agrees_with_plain_matrices(robot: Robot, gate: float) -> None:
    """Over feet that come and go, and with velocities so wild that some are taken for sliding."""
    rng = np.random.default_rng(3)
    config = EstimatorConfig(
        foot_force="on", slip_gate=gate, foot_walk=0.05, settle_time=0.006, ground_time=1e12, ground_start=1e12
    )  # in the level frame throughout
    estimator = Estimator(robot, 1, RATE, config)
    start = np.zeros(1, START)
    start["velocity"] = (0.4, -0.2, 0.1)
    estimator.reset(random_reading(robot, rng, np.zeros(4)), start, np.ones((1, 4), np.int64))
    state = estimator.state[0]
    plain = PlainFilter(robot, config, 1 / RATE, *dense(state))
    slid = 0
    for step in range(60):
        forces = LOADED * np.array([step % 20 < 12, step % 20 >= 10, step % 30 < 15, step % 7 < 5], float)
        planned = np.array([[1, 1, step % 30 < 10, 1]], np.int64)
        reading = random_reading(robot, rng, forces)
        stood = state["stance_time"] > 0
        estimator.step(reading, planned)
        rotation = matrix_from_quat(state["quat"])
        feet, roll, velocity = plain.legs(rotation, reading[0])
        plain.predict(rotation, reading[0], roll)
        for leg in np.flatnonzero(~stood):
            plain.anchor(leg, feet[leg])
        for leg in np.flatnonzero(state["stance_time"] > 0):
            slid += plain.take_in(leg, feet[leg], velocity[leg], state["stance_time"][leg])
        mean, cov = dense(state)
        np.testing.assert_allclose(mean, plain.x, rtol=0, atol=1e-10)
        np.testing.assert_allclose(cov, plain.p, rtol=1e-7, atol=1e-14)
    assert (slid > 0) == (gate < 1e6)


@pytest.mark.nojit
def test_the_covariance_stays_one(robot: Robot) -> None:
    """Symmetric, positive definite, and bounded where it can be known: velocity and height, not the place."""
    rng = np.random.default_rng(0)
    estimator = Estimator(robot, 1, RATE, EstimatorConfig(foot_force="on"))
    estimator.reset(random_reading(robot, rng, np.full(4, LOADED)), np.zeros(1, START), np.ones((1, 4), np.int64))
    steps, state = 400, estimator.state[0]
    places = []
    for step in range(steps):
        forces = LOADED * np.array([step % 100 < 60, step % 100 >= 40, step % 100 >= 40, step % 100 < 60], float)
        reading = random_reading(robot, rng, forces)
        reading["gyro"], reading["joint_vel"] = 0.0, 0.0
        estimator.step(reading, np.ones((1, 4), np.int64))
        for cov in state["cov"]:
            np.testing.assert_allclose(cov, cov.T, rtol=1e-9, atol=1e-16)
            assert np.linalg.eigvalsh(cov).min() > 0
        places.append(state["cov"][0, 0, 0])
    assert state["cov"][:, 1, 1].max() < 0.05**2, "velocity is measured by the legs"
    assert state["cov"][1, 0, 0] < 0.005**2, "height is measured by the feet on the ground"
    assert places[-1] > 2 * places[100] > 0, "what was travelled is not measured again: the place gets lost"


@pytest.mark.nojit
def test_a_foot_in_the_air_says_nothing(robot: Robot) -> None:
    """The base of a robot that falls freely accelerates as the IMU says, whatever its legs do."""
    rng = np.random.default_rng(1)
    estimator = Estimator(robot, 1, RATE)
    start = np.zeros(1, START)
    start["velocity"] = (1.0, 0.5, 0.0)
    reading = random_reading(robot, rng, np.zeros(4))
    reading["accel"], reading["gyro"] = 0.0, 0.0
    seen = estimator.reset(reading, start, np.zeros((1, 4), np.int64))
    z0 = float(seen["root_pos"][0, 2])
    for _ in range(100):
        reading["joint_pos"] = robot.home_joint_pos + rng.normal(0, 0.3, 12)
        reading["joint_vel"] = rng.normal(0, 5.0, 12)
        seen = estimator.step(reading, np.zeros((1, 4), np.int64))
    t = 0.2
    np.testing.assert_allclose(seen["lin_vel"][0, :2], [1.0, 0.5], atol=1e-9)
    np.testing.assert_allclose(seen["root_pos"][0, :2], [t, 0.5 * t], atol=1e-9)
    assert seen.dtype == OBSERVATION
    assert seen["root_pos"][0, 2] - z0 == pytest.approx(-0.5 * 9.81 * t**2, rel=0.05)
