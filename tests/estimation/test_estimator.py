"""The estimator on simulated robots and on made-up readings: accuracy, contacts, sliding feet, starts."""

import dataclasses
from typing import Any

import numpy as np
import pytest

from control.motions import gait, standing, turned
from estimation.reference_filter import PlainFilter
from fastmimic.base.conventions import GRAVITY
from fastmimic.base.errors import ConfigError
from fastmimic.base.rotations import matrix_from_quat, quat_from_rotvec, quat_from_yaw, rotvec_from_quat, yaw_from_quat
from fastmimic.episode.loop import run_episodes
from fastmimic.episode.plan import nominal_start
from fastmimic.episode.rollout import Rollout
from fastmimic.estimation.config import EstimatorConfig
from fastmimic.estimation.estimator import START, Estimator
from fastmimic.robot import Robot
from fastmimic.robot.kinematics import foot_jacobians, foot_positions
from fastmimic.robot.state import READING
from fastmimic.simulation.conditions import Conditions
from fastmimic.simulation.config import ideal_sensors

RATE = 500.0
ALL = np.ones((1, 4), np.int64)


def ideal(**changes: float) -> Conditions:
    """Sensors without errors, and a filter that knows of it."""
    return Conditions(observe="sensors", sensors=ideal_sensors(), estimator=EstimatorConfig(latency_s=0.0, **changes))


@pytest.fixture(scope="module")
def walked(robot: Robot) -> Rollout:
    """A robot that walks on a curve under an estimate from sensors without errors.

    The simulator's feet creep under load; the filter is told so, and trusts the accelerometer.
    """
    motion = turned(gait(robot, (0.3, 0.05), 0.4), 0.9)
    conditions = ideal(accel_noise=0.01, velocity_noise=0.5, foot_walk=0.3, position_noise=0.01, height_noise=0.05)
    return run_episodes(robot, motion, duration_s=3.0, log=True, conditions=conditions)


class TestWalking:
    def test_without_sensor_errors_the_estimate_is_the_truth(self, walked: Rollout) -> None:
        assert not walked.fell.any()
        assert walked.log is not None
        assert walked.log.estimate is not None
        truth, estimate = walked.log.observation[0], walked.log.estimate[0]
        assert np.all(np.abs(estimate["lin_vel"] - truth["lin_vel"]).max(axis=0) < [0.004, 0.004, 0.015])
        assert np.all(np.sqrt(np.mean((estimate["lin_vel"] - truth["lin_vel"]) ** 2, axis=0)) < 0.004)
        assert np.abs(estimate["root_pos"] - truth["root_pos"]).max() < 0.008, "after a metre"
        assert np.abs(estimate["root_quat"] - truth["root_quat"]).max() < 1e-3
        np.testing.assert_allclose(estimate["ang_vel"], truth["ang_vel"], atol=0.02)
        for name in ("joint_pos", "joint_vel"):
            np.testing.assert_allclose(estimate[name], truth[name], atol=1e-12)

    def test_the_figures_are_those_of_the_log(self, walked: Rollout) -> None:
        assert walked.log is not None
        assert walked.log.estimate is not None
        assert walked.estimation is not None
        truth, estimate, errors = walked.log.observation[0], walked.log.estimate[0], walked.estimation
        d = estimate["lin_vel"] - truth["lin_vel"]
        assert errors.velocity_rmse[0] == pytest.approx(np.sqrt(np.mean(np.sum(d**2, axis=1))))
        d = estimate["root_pos"] - truth["root_pos"]
        assert errors.height_rmse[0] == pytest.approx(np.sqrt(np.mean(d[:, 2] ** 2)))
        path = np.concatenate([[[0.0, 0.0]], truth["root_pos"][:, :2]])
        distance = np.linalg.norm(np.diff(path, axis=0), axis=1).sum()
        assert errors.position_drift[0] == pytest.approx(100 * np.linalg.norm(d[-1, :2]) / distance, rel=0.01)
        yaw = yaw_from_quat(estimate["root_quat"][-1]) - yaw_from_quat(truth["root_quat"][-1])
        assert errors.heading_error[0] == pytest.approx(float(yaw), abs=1e-9)

    def test_feet_roll_over_their_contact_points(self, robot: Robot, walked: Rollout) -> None:
        """A velocity from standing legs that holds the spheres' centres for fixed is off by several times more."""
        assert walked.log is not None
        plain = PlainFilter(robot, EstimatorConfig(), 1 / RATE, np.zeros(18), np.eye(18))
        rolling, fixed = [], []
        for i in range(100, 1500, 7):
            truth = walked.log.observation[0, i]
            rotation = matrix_from_quat(truth["root_quat"])
            reading = np.zeros(1, READING)[0]
            reading["gyro"] = rotation.T @ truth["ang_vel"]
            reading["joint_pos"], reading["joint_vel"] = truth["joint_pos"], truth["joint_vel"]
            _, roll, velocity = plain.legs(rotation, reading)
            for leg in np.flatnonzero(truth["foot_force"][:, 2] > 30.0):
                rolling.append((velocity[leg] - truth["lin_vel"])[:2])
                fixed.append((velocity[leg] - roll[leg] - truth["lin_vel"])[:2])
        assert np.sqrt(np.mean(np.square(rolling))) < 0.5 * np.sqrt(np.mean(np.square(fixed)))

    def test_a_standing_robot_stays_where_it_is(self, robot: Robot) -> None:
        conditions = Conditions(observe="sensors", seed=3)
        found = run_episodes(robot, standing(robot), start=nominal_start(4), duration_s=2.0, conditions=conditions)
        assert found.estimation is not None
        assert not found.fell.any()
        assert np.all(found.estimation.velocity_rmse < 0.02)
        assert np.all(found.estimation.height_rmse < 0.005)
        assert np.isnan(found.estimation.position_drift).all(), "it travels nowhere"

    def test_on_a_slope_the_frame_is_that_of_the_ground(self, robot: Robot) -> None:
        """The IMU finds the vertical, the feet the ground."""
        motion = gait(robot, (0.3, 0.0))
        conditions = dataclasses.replace(ideal(), terrain="slope=3")
        found = run_episodes(robot, motion, duration_s=4.0, log=True, conditions=conditions)
        assert not found.fell.any()
        assert found.log is not None
        assert found.log.estimate is not None
        truth, estimate = (matrix_from_quat(x[0]["root_quat"]) for x in (found.log.observation, found.log.estimate))
        up = np.einsum("tj,tj->t", truth[:, 2], estimate[:, 2])  # the bodies' z axes in either frame
        lean = np.degrees(np.arccos(np.clip(up, -1, 1)))
        assert lean[0] == pytest.approx(0.0, abs=0.1), "as the IMU has it"
        assert lean[-250:].mean() == pytest.approx(3.0, abs=0.5), "as the feet have it"


def at_rest(robot: Robot, quat: tuple[float, ...] = (1.0, 0.0, 0.0, 0.0)) -> np.ndarray:
    """Readings of a robot that stands in its home pose."""
    reading = np.zeros(1, READING)
    reading["quat"] = quat
    reading["accel"] = matrix_from_quat(np.array(quat)).T @ [0.0, 0.0, GRAVITY]
    reading["joint_pos"] = robot.home_joint_pos
    reading["foot_force"] = 0.25 * robot.mass * GRAVITY
    return reading


@pytest.mark.nojit
class TestMadeUp:
    def test_it_starts_where_it_is_told(self, robot: Robot) -> None:
        """Heading and place are given, whatever the IMU calls north; height and tilt are measured."""
        estimator = Estimator(robot, 1, RATE)
        start = np.zeros(1, START)
        start["position"], start["heading"] = (2.0, -1.0), 0.7
        seen = estimator.reset(at_rest(robot, tuple(quat_from_yaw(-2.0))), start, ALL)
        height = robot.foot_radius - foot_positions(robot, robot.home_joint_pos)[:, 2].min()
        np.testing.assert_allclose(seen["root_pos"][0], [2.0, -1.0, height], atol=1e-9)
        assert float(yaw_from_quat(seen["root_quat"][0])) == pytest.approx(0.7)
        np.testing.assert_allclose(seen["lin_vel"], 0.0, atol=1e-9)

    def test_standing_legs_correct_a_start_at_another_speed(self, robot: Robot) -> None:
        estimator = Estimator(robot, 1, RATE, EstimatorConfig(latency_s=0.0))
        start, reading = np.zeros(1, START), at_rest(robot)
        velocity = np.array([0.5, -0.2, 0.0])
        start["velocity"] = velocity + np.array([0.1, 0.1, 0.0])  # more than the robot's
        # feet that roll: J q̇ = ω × r − v with ω the calf's, solved for q̇
        jacobians = foot_jacobians(robot, robot.home_joint_pos)
        q = robot.home_joint_pos.reshape(4, 3)
        for leg in range(4):
            c, s = np.cos(q[leg, 0]), np.sin(q[leg, 0])
            calf = np.array([[1.0, 0.0, 0.0], [0.0, c, c], [0.0, s, s]])
            rolling = np.array([[0, 1, 0], [-1, 0, 0], [0, 0, 0]]) * robot.foot_radius @ calf
            reading["joint_vel"][0, 3 * leg : 3 * leg + 3] = np.linalg.solve(jacobians[leg] - rolling, -velocity)
        seen = estimator.reset(reading, start, ALL)
        assert np.abs(seen["lin_vel"][0] - velocity).max() < 0.03

    def test_a_sliding_foot_is_not_believed(self, robot: Robot) -> None:
        """One of four feet slides at 0.5 m/s under a robot at rest."""

        def run(gate: float) -> tuple[float, float]:
            estimator = Estimator(robot, 1, RATE, EstimatorConfig(latency_s=0.0, slip_gate=gate, foot_force="on"))
            reading = at_rest(robot)
            estimator.reset(reading, np.zeros(1, START), ALL)
            speed, place, steps = 0.0, 0.0, 100
            jacobian = foot_jacobians(robot, robot.home_joint_pos)[0]
            dq = np.linalg.solve(jacobian, [0.5, 0.0, 0.0])
            for step in range(2 * steps):
                if step >= steps:
                    reading["joint_vel"][0, :3] = dq
                    reading["joint_pos"][0, :3] += dq / RATE
                seen = estimator.step(reading, ALL)
                if step >= steps:
                    speed = max(speed, float(np.abs(seen["lin_vel"][0]).max()))
                    place = float(np.abs(seen["root_pos"][0, :2]).max())
            return speed, place

        speed, place = run(EstimatorConfig().slip_gate)
        believed_speed, believed_place = run(1e6)
        assert speed < 0.02
        assert place < 0.005
        assert believed_speed > 4 * speed
        assert believed_place > 4 * place

    def test_the_orientation_follows_the_gyro_at_once_and_the_imu_slowly(self, robot: Robot) -> None:
        config = EstimatorConfig(latency_s=0.0, orientation_time=0.1, foot_force="on")
        estimator = Estimator(robot, 1, RATE, config)
        reading = at_rest(robot)
        estimator.reset(reading, np.zeros(1, START), ALL)
        reading["gyro"][0, 2] = 1.0
        for step in range(50):
            reading["quat"] = quat_from_yaw((step + 1) / RATE)
            seen = estimator.step(reading, ALL)
        assert float(yaw_from_quat(seen["root_quat"][0])) == pytest.approx(0.1, abs=1e-9), "both agree"
        reading["gyro"] = 0.0
        reading["quat"] = quat_from_yaw(0.1 + 0.05)  # a step of the IMU alone
        for _ in range(50):  # one time constant
            seen = estimator.step(reading, ALL)
        followed = (float(yaw_from_quat(seen["root_quat"][0])) - 0.1) / 0.05
        assert followed == pytest.approx(1 - np.exp(-1), abs=0.01)

    def test_the_frame_turns_into_the_plane_of_the_feet(self, robot: Robot) -> None:
        """An IMU that is mounted askew does not matter in the end; the heading stays the gyro's."""
        estimator = Estimator(robot, 1, RATE, EstimatorConfig(latency_s=0.0, ground_time=0.15, foot_force="on"))
        reading = at_rest(robot, tuple(quat_from_rotvec(np.array([0.02, -0.01, 0.0]))))
        first = estimator.reset(reading, np.zeros(1, START), ALL)["root_quat"][0].copy()
        for _ in range(700):
            seen = estimator.step(reading, ALL)
        assert np.linalg.norm(rotvec_from_quat(first)) == pytest.approx(np.hypot(0.02, 0.01), rel=1e-4)
        assert np.abs(rotvec_from_quat(seen["root_quat"][0])).max() < 0.002
        assert np.abs(seen["lin_vel"]).max() < 1e-3

    def test_latency_is_made_up_for(self, robot: Robot) -> None:
        """Of a robot that glides and turns, with readings of 10 ms ago, the state of now is told."""
        estimator = Estimator(robot, 1, RATE, EstimatorConfig(latency_s=0.01))
        start, reading = np.zeros(1, START), at_rest(robot)
        start["velocity"] = (1.0, 0.0, 0.0)
        reading["foot_force"], reading["gyro"] = 0.0, (0.0, 0.0, 2.0)
        reading["joint_vel"][0, 4] = 3.0
        none = np.zeros((1, 4), np.int64)
        first = estimator.reset(reading, start, none).copy()
        np.testing.assert_allclose(first["root_pos"][0, :2], 0.0, atol=1e-9)
        assert first["joint_pos"][0, 4] == pytest.approx(robot.home_joint_pos[4] + 0.03)
        assert float(yaw_from_quat(first["root_quat"][0])) == pytest.approx(0.02)
        reading["accel"] = [0.0, 0.0, GRAVITY + 10.0]
        reading["quat"] = quat_from_yaw(2.0 / RATE)
        seen = estimator.step(reading, none)
        assert seen["lin_vel"][0, 2] == pytest.approx(10.0 * (0.002 + 0.01))
        assert seen["root_pos"][0, 2] - first["root_pos"][0, 2] == pytest.approx(0.5 * 10.0 * 0.012**2, rel=1e-6)

    def test_speeds_are_carried_on_as_they_change(self, robot: Robot) -> None:
        estimator = Estimator(robot, 1, RATE, EstimatorConfig(latency_s=0.01, rate_time=0.01))
        reading, acceleration = at_rest(robot), 50.0
        estimator.reset(reading, np.zeros(1, START), ALL)
        for step in range(40):  # several times the lag
            t = (step + 1) / RATE
            reading["joint_vel"][0, 4] = acceleration * t
            reading["joint_pos"][0, 4] = robot.home_joint_pos[4] + 0.5 * acceleration * t**2
            reading["gyro"][0, 0] = -acceleration * t
            seen = estimator.step(reading, ALL)
        now = t + 0.01
        assert seen["joint_vel"][0, 4] == pytest.approx(acceleration * now, rel=0.03)
        assert seen["joint_pos"][0, 4] == pytest.approx(robot.home_joint_pos[4] + 0.5 * acceleration * now**2, abs=2e-3)
        assert np.linalg.norm(seen["ang_vel"][0]) == pytest.approx(acceleration * now, rel=0.03)
        reading["joint_vel"] = 0.0
        for _ in range(100):
            seen = estimator.step(reading, ALL)
        np.testing.assert_allclose(seen["joint_vel"], 0.0, atol=1e-6)


@pytest.mark.nojit
class TestFootSensorsAlone:
    def course(self, robot: Robot, force: np.ndarray, planned: np.ndarray, **changes: float) -> np.ndarray:
        """What is told of the first foot's force, with the filter's record of it, over a course of readings (t,)."""
        estimator = Estimator(robot, 1, RATE, EstimatorConfig(foot_force="on", force_time=0.0, **changes))
        reading = at_rest(robot)
        reading["foot_force"][0, 0] = force[0]
        estimator.reset(reading, np.zeros(1, START), ALL)
        told = []
        for f, p in zip(force, planned, strict=True):
            reading["foot_force"][0, 0] = f
            seen = estimator.step(reading, np.array([[p, 1, 1, 1]], np.int64))
            told.append((seen["foot_force"][0, 0, 2], estimator.state["stance_time"][0, 0] > 0))
        return np.array(told)

    def test_the_sensors_offset_is_learnt_in_swing(self, robot: Robot) -> None:
        offset, steps = 9.0, 200
        force = np.concatenate([np.full(steps, offset), np.full(20, offset + 50.0)])
        planned = np.concatenate([np.zeros(steps), np.ones(20)]).astype(int)
        told = self.course(robot, force, planned)
        assert told[:steps, 0].max() == 0.0, "an offset is no contact"
        np.testing.assert_allclose(told[steps:, 0], 50.0, atol=1.0)

    def test_it_is_not_learnt_while_the_leg_stands(self, robot: Robot) -> None:
        told = self.course(robot, np.full(300, 40.0), np.ones(300, int))
        np.testing.assert_allclose(told[:, 0], 40.0)

    def test_hysteresis(self, robot: Robot) -> None:
        weight = robot.mass * GRAVITY
        config = EstimatorConfig()
        on, off = config.contact_force * weight, config.release_force * weight
        force = np.array([0.0, on - 0.5, on + 0.5, 0.5 * (on + off), off + 0.5, off - 0.5, on - 0.5])
        told = self.course(robot, force, np.ones(len(force), int))
        np.testing.assert_array_equal(told[:, 0] > 0, [False, False, True, True, True, False, False])

    def test_a_loaded_foot_that_is_pulled_away_bears_nothing(self, robot: Robot) -> None:
        planned = np.array([1, 1, 1, 0, 0, 1, 1])
        told = self.course(robot, np.full(7, 60.0), planned)
        np.testing.assert_array_equal(told[:, 1], planned == 1)
        assert np.all(told[:, 0] == 60.0), "the gait planner is told all the same"

    def test_noise_is_smoothed(self, robot: Robot) -> None:
        estimator = Estimator(robot, 1, RATE, EstimatorConfig(foot_force="on", force_time=0.004))
        reading = at_rest(robot)
        estimator.reset(reading, np.zeros(1, START), ALL)
        reading["foot_force"][0, 0] += 30.0
        seen = estimator.step(reading, ALL)
        first = seen["foot_force"][0, 0, 2] - 0.25 * robot.mass * GRAVITY
        assert first == pytest.approx(30.0 * 0.002 / 0.006)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"velocity_noise": 0.0}, "velocity_noise must be positive, found 0.0"),
        ({"latency_s": -0.001}, "latency_s must not be negative"),
        ({"accel_noise": float("nan")}, "accel_noise must be finite"),
        ({"foot_force": "yes"}, "foot_force must be one of auto, off, on, found yes"),
        ({"release_force": 0.5}, r"release_force \(0.5\) must not be above contact_force"),
    ],
)
def test_parameters_out_of_their_range(change: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError, match=f"estimator: {message}"):
        dataclasses.replace(EstimatorConfig(), **change)
