"""Contact by joint torques: forces on made-up legs, and robots in simulation whose foot sensors fail."""

import numpy as np
import pytest

from fastmimic.base.conventions import GRAVITY
from fastmimic.episode.loop import run_episodes
from fastmimic.episode.plan import nominal_start
from fastmimic.episode.rollout import Rollout
from fastmimic.estimation.config import EstimatorConfig
from fastmimic.estimation.estimator import START, Estimator
from fastmimic.imitation.evaluate import evaluate
from fastmimic.robot import Robot
from fastmimic.robot.dynamics import leg_torques
from fastmimic.robot.kinematics import foot_jacobians
from fastmimic.robot.state import READING
from fastmimic.runs.loading import load_motion
from fastmimic.simulation.conditions import Conditions, Disturbance

RATE = 500.0
FAULTS = ((1.0, 0.0), (0.0, 0.0), (0.1, 0.0), (10.0, 0.0), (0.0, 60.0))  # scale and offset of the foot sensors
DELAY_S, WRONG = 0.015, 0.05  # WRONG counts the bounces after a touch-down as well


def reading_of(robot: Robot, forces: np.ndarray) -> np.ndarray:
    """A robot that hangs in its home pose, with forces (4, 3) on its feet, N."""
    reading = np.zeros(1, READING)
    reading["quat"][0, 0], reading["accel"][0, 2] = 1.0, GRAVITY
    reading["joint_pos"], none = robot.home_joint_pos, np.zeros((1, 12))
    held = leg_torques(robot, reading["joint_pos"], none, none, reading["gyro"], reading["accel"])[0]
    pushed = np.einsum("lij,li->lj", foot_jacobians(robot, robot.home_joint_pos), forces)
    reading["torque"] = held - pushed.ravel()
    return reading


@pytest.mark.nojit
class TestLoads:
    def test_they_are_the_vertical_forces(self, robot: Robot) -> None:
        forces = np.array([[5.0, -3.0, 40.0], [0.0, 0.0, 0.0], [-10.0, 0.0, 25.0], [1.0, 2.0, 60.0]])
        estimator = Estimator(robot, 1, RATE, EstimatorConfig(foot_force="off"))
        reading, planned = reading_of(robot, forces), np.array([[1, 0, 1, 1]])
        estimator.reset(reading, np.zeros(1, START), planned)
        for _ in range(60):
            seen = estimator.step(reading, planned)
        np.testing.assert_allclose(estimator.state["load"][0], forces[:, 2], atol=0.1)
        np.testing.assert_allclose(seen["foot_force"][0, :, 2], forces[:, 2], atol=0.1)
        assert not estimator.believed.any()

    def test_a_foot_that_meets_the_ground_in_swing_is_felt(self, robot: Robot) -> None:
        estimator = Estimator(robot, 1, RATE, EstimatorConfig(foot_force="off"))
        swinging, air = np.array([[0, 1, 1, 1]]), np.zeros((4, 3))
        air[1:, 2] = robot.mass * GRAVITY / 3
        met = air.copy()
        met[0, 2] = 0.3 * robot.mass * GRAVITY
        estimator.reset(reading_of(robot, air), np.zeros(1, START), swinging)
        for _ in range(60):
            seen = estimator.step(reading_of(robot, air), swinging)
        assert seen["foot_force"][0, 0, 2] == 0.0
        estimator.state["swing_sums"][0, 0] = (
            1e6  # as after the first swings: until then a swinging leg is not believed
        )
        told = [float(estimator.step(reading_of(robot, met), swinging)["foot_force"][0, 0, 2]) for _ in range(20)]
        assert np.argmax(np.array(told) > 0) / RATE <= DELAY_S
        assert told[-1] == pytest.approx(met[0, 2], rel=0.05)


@pytest.fixture(scope="module")
def trotted(robot: Robot) -> Rollout:
    """A trot of 4 s, each robot with another fault of its foot sensors."""
    scales, offsets = zip(*FAULTS, strict=True)
    faults = Disturbance("foot-force-scale", scales), Disturbance("foot-force-offset", offsets)
    conditions = Conditions(observe="sensors", seed=1, disturbances=faults)
    return run_episodes(
        robot,
        load_motion("trot", robot),
        start=nominal_start(len(FAULTS)),
        duration_s=4.0,
        log=True,
        conditions=conditions,
    )


def touchdown_delays(true: np.ndarray, found: np.ndarray) -> list[int]:
    """Control steps from each touch-down after 20 ms or more in the air until it is found."""
    delays: list[int] = []
    for leg in range(4):
        began = np.flatnonzero(true[1:, leg] & ~true[:-1, leg]) + 1
        began = [k for k in began if 50 < k < len(true) - 50 and not true[k - 10 : k, leg].any()]
        delays += [int(np.argmax(found[k : k + 50, leg])) for k in began]
    return delays


class TestFailingFootSensors:
    def test_nobody_falls(self, trotted: Rollout) -> None:
        assert not trotted.fell.any()
        assert trotted.reward.min() > trotted.reward[0] - 0.01

    def test_contacts_are_found_all_the_same(self, trotted: Rollout, robot: Robot) -> None:
        log = trotted.course
        assert log.estimate is not None
        for truth, estimate in zip(log.observation, log.estimate, strict=True):
            true = truth["foot_force"][:, :, 2] > 0.02 * robot.mass * GRAVITY
            found = estimate["foot_force"][:, :, 2] > 0
            delays = touchdown_delays(true, found)
            assert len(delays) > 20
            assert np.median(delays) / RATE <= DELAY_S
            assert (true != found)[50:].mean() < WRONG

    def test_sensors_in_another_unit_are_used_and_dead_ones_are_not(self, trotted: Rollout) -> None:
        assert trotted.estimation is not None
        used = trotted.estimation.foot_sensors
        for row, (scale, _) in zip(used, FAULTS, strict=True):
            assert row.all() if scale > 0.0 else not row.any()

    def test_who_trusts_dead_sensors_falls(self, robot: Robot) -> None:
        """As before there was anything else; so the other tests can fail."""
        conditions = Conditions(
            observe="sensors",
            disturbances=(Disturbance("foot-force-scale", (0.0,)),),
            estimator=EstimatorConfig(foot_force="on"),
        )
        found = run_episodes(robot, load_motion("trot", robot), duration_s=4.0, conditions=conditions)
        assert found.fell[0] or found.reward[0] < 0.8


def test_what_is_not_learnt_yet_stops_no_leg(robot: Robot) -> None:
    """Robots that start amid a stride: torques of the first swings are not taken for the ground."""
    conditions = Conditions(observe="sensors")
    found = evaluate("trot", robot, episodes=12, duration_s=1.0, conditions=conditions).rollout
    assert not found.fell.any()
    assert found.early_contacts.mean() < 0.2
