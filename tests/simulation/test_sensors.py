"""Simulated sensors: what they measure, and that their errors are as large, as late and as reproducible as they say."""

import dataclasses
from typing import Any

import numpy as np
import pytest

from fastmimic.base.conventions import GRAVITY
from fastmimic.base.errors import ConfigError
from fastmimic.base.rotations import matrix_from_quat, quat_from_rotvec, quat_multiply, rotvec_from_quat
from fastmimic.robot import Robot
from fastmimic.robot.state import COMMAND, OBSERVATION
from fastmimic.simulation.conditions import Conditions, Disturbance, episode_generator, make_world
from fastmimic.simulation.config import SensorConfig, ideal_sensors
from fastmimic.simulation.sensors import Sensors

RATE = 500.0
DT = 1 / RATE


def level(n: int, robot: Robot) -> np.ndarray:
    """Robots at rest, level."""
    truth = np.zeros(n, OBSERVATION)
    truth["root_quat"] = (1.0, 0.0, 0.0, 0.0)
    truth["joint_pos"] = robot.home_joint_pos
    return truth


def tumbling(robot: Robot, steps: int) -> np.ndarray:
    """(steps,) states of a body that turns and accelerates at constant rates, with moving joints."""
    t = DT * np.arange(steps)
    truth = np.zeros(steps, OBSERVATION)
    omega, alpha = np.array([0.5, -1.0, 2.0]), np.array([1.0, 2.0, -3.0])
    truth["root_quat"] = quat_from_rotvec(t[:, None] * omega)
    truth["ang_vel"] = omega
    truth["lin_vel"] = t[:, None] * alpha
    truth["joint_pos"] = robot.home_joint_pos + 0.1 * np.sin(3 * t)[:, None]
    truth["joint_vel"] = 0.3 * np.cos(3 * t)[:, None]
    truth["foot_force"][:, :, 2] = 10.0 + 100.0 * t[:, None]
    return truth


def generators(n: int, seed: int = 0) -> list[np.random.Generator]:
    return [episode_generator(seed, i, 1) for i in range(n)]


def measured(robot: Robot, truth: np.ndarray, config: SensorConfig, seed: int = 0, n: int = 1) -> np.ndarray:
    """(n, steps) readings of n robots that all do the same."""
    sensors = Sensors(robot, n, RATE, config)
    command = np.zeros(n, COMMAND)
    rows = [sensors.reset(generators(n, seed), np.repeat(truth[:1], n)).copy()]
    rows += [sensors.measure(np.repeat(state, n), command).copy() for state in truth[1:]]
    return np.stack(rows, axis=1)


def with_errors(**values: float) -> SensorConfig:
    """Ideal sensors but for these."""
    return dataclasses.replace(ideal_sensors(), **values)


@pytest.mark.nojit
class TestIdeal:
    def test_they_tell_the_truth(self, robot: Robot) -> None:
        truth = tumbling(robot, 30)
        found = measured(robot, truth, ideal_sensors())[0]
        for name in ("joint_pos", "joint_vel"):
            np.testing.assert_array_equal(found[name], truth[name])
        np.testing.assert_allclose(found["quat"], truth["root_quat"], atol=1e-14)
        np.testing.assert_array_equal(found["foot_force"], truth["foot_force"][:, :, 2])
        rotation = matrix_from_quat(truth["root_quat"])
        np.testing.assert_allclose(found["gyro"], np.einsum("tij,ti->tj", rotation, truth["ang_vel"]), atol=1e-12)

    def test_the_accelerometer_feels_what_holds_the_robot_up(self, robot: Robot) -> None:
        truth = tumbling(robot, 30)
        found = measured(robot, truth, ideal_sensors())[0]
        np.testing.assert_allclose(found["accel"][0], [0, 0, GRAVITY], atol=1e-12)
        halfway = matrix_from_quat(quat_from_rotvec((DT * (np.arange(30) - 0.5))[:, None] * [0.5, -1.0, 2.0]))
        expected = np.einsum("tij,i->tj", halfway, [1.0, 2.0, -3.0 + GRAVITY])
        np.testing.assert_allclose(found["accel"][1:], expected[1:], atol=1e-4)

    def test_it_feels_nothing_in_free_fall(self, robot: Robot) -> None:
        truth = np.repeat(level(1, robot), 5)
        truth["lin_vel"][:, 2] = -GRAVITY * DT * np.arange(5)
        np.testing.assert_allclose(measured(robot, truth, ideal_sensors())[0]["accel"][1:], 0.0, atol=1e-12)

    def test_torques_are_those_of_the_motor_law(self, robot: Robot) -> None:
        sensors = Sensors(robot, 1, RATE, ideal_sensors())
        truth, command = level(1, robot), np.zeros(1, COMMAND)
        sensors.reset(generators(1), truth)
        command["torque"], command["stiffness"], command["damping"] = 3.0, 50.0, 2.0
        command["joint_pos"] = robot.home_joint_pos + 0.1
        truth["joint_vel"] = 1.5
        np.testing.assert_allclose(sensors.measure(truth, command)["torque"], 3.0 + 5.0 - 3.0)
        command["torque"] = 1e3
        np.testing.assert_allclose(sensors.measure(truth, command)["torque"][0], robot.torque_limit)

    def test_torques_are_those_of_the_commands_that_have_reached_the_motors(self, robot: Robot) -> None:
        world = make_world([Disturbance("delay", (0.004,))], 1, "mujoco")
        sensors = Sensors(robot, 1, RATE, ideal_sensors(), world)
        truth, command, found = level(1, robot), np.zeros(1, COMMAND), []
        sensors.reset(generators(1), truth)
        for torque in (1.0, 2.0, 3.0, 4.0):
            command["torque"] = torque
            found.append(float(sensors.measure(truth, command)["torque"][0, 0]))
        assert found == [0.0, 0.0, 1.0, 2.0]


@pytest.mark.nojit
class TestErrors:
    def test_foot_sensors_in_another_unit(self, robot: Robot) -> None:
        given = Disturbance("foot-force-scale", (0.0, 10.0)), Disturbance("foot-force-offset", (60.0, 0.0))
        sensors = Sensors(robot, 2, RATE, ideal_sensors(), make_world(given, 2, "mujoco"))
        truth = level(2, robot)
        truth["foot_force"][:, :, 2] = 25.0
        found = sensors.reset(generators(2), truth)["foot_force"]
        np.testing.assert_array_equal(found, [[60.0] * 4, [250.0] * 4])

    def test_readings_arrive_late(self, robot: Robot) -> None:
        truth = tumbling(robot, 30)
        late = with_errors(imu_latency_s=0.004, joint_latency_s=0.01, foot_latency_s=0.006)
        found = measured(robot, truth, late)[0]
        np.testing.assert_allclose(found["quat"][2:], truth["root_quat"][:-2], atol=1e-14)
        np.testing.assert_array_equal(found["joint_pos"][5:], truth["joint_pos"][:-5])
        np.testing.assert_array_equal(found["foot_force"][3:], truth["foot_force"][:-3, :, 2])
        np.testing.assert_array_equal(found["joint_pos"][:6], np.repeat(truth["joint_pos"][:1], 6, axis=0))

    def test_slow_sensors_hold_their_readings(self, robot: Robot) -> None:
        truth = tumbling(robot, 31)
        slow = with_errors(imu_rate_hz=250.0, joint_rate_hz=100.0, foot_rate_hz=50.0)
        found = measured(robot, truth, slow)[0]
        t = np.arange(31)
        np.testing.assert_allclose(found["quat"], truth["root_quat"][t - t % 2], atol=1e-14)
        np.testing.assert_array_equal(found["joint_pos"], truth["joint_pos"][t - t % 5])
        np.testing.assert_array_equal(found["foot_force"], truth["foot_force"][t - t % 10, :, 2])
        np.testing.assert_allclose(
            np.linalg.norm(found["accel"][2:], axis=1), np.hypot(np.hypot(1, 2), 6.81), rtol=1e-4
        )

    def test_readings_are_rounded(self, robot: Robot) -> None:
        truth = tumbling(robot, 5)
        coarse = with_errors(joint_pos_quantum=0.01, joint_vel_quantum=0.25, foot_quantum=2.0)
        found = measured(robot, truth, coarse)[0]
        for name, quantum, exact in (
            ("joint_pos", 0.01, truth["joint_pos"]),
            ("joint_vel", 0.25, truth["joint_vel"]),
            ("foot_force", 2.0, truth["foot_force"][:, :, 2]),
        ):
            np.testing.assert_allclose(found[name] / quantum, np.round(found[name] / quantum), atol=1e-9)
            assert np.abs(found[name] - exact).max() <= 0.5 * quantum + 1e-12

    def test_a_biased_accelerometer_tilts_the_vertical(self, robot: Robot) -> None:
        """By bias over g, so that the IMU's own vertical and its accelerometer agree at rest."""
        quat = quat_multiply(quat_from_rotvec(np.array([0.0, 0.0, 1.0])), quat_from_rotvec(np.array([0.3, 0.0, 0.0])))
        truth = np.repeat(level(1, robot), 2)
        truth["root_quat"] = quat
        found = measured(robot, truth, with_errors(accel_bias=0.05), n=16)[:, 1]
        for reading in found:
            felt = matrix_from_quat(reading["quat"]) @ reading["accel"]
            assert np.linalg.norm(felt[:2]) < 1e-3, "0.05 m/s² if the vertical were the true one"
            turn = rotvec_from_quat(quat_multiply(reading["quat"], quat * [1, -1, -1, -1]))
            assert abs(turn[2]) < 1e-4
            assert np.linalg.norm(turn) < 4 * 0.05 / GRAVITY
        assert np.std(found["accel"] - found["accel"].mean(axis=0)) > 0.02

    def test_the_heading_drifts_with_the_gyro(self, robot: Robot) -> None:
        truth = np.repeat(level(1, robot), 101)
        found = measured(robot, truth, with_errors(gyro_bias=0.02), n=4)
        for rows in found:
            turn = rotvec_from_quat(rows["quat"][-1])
            np.testing.assert_allclose(turn, [0.0, 0.0, 0.2 * rows["gyro"][-1, 2]], atol=1e-6)

    def test_motors_have_the_encoders_offsets(self, robot: Robot) -> None:
        """A motor that is told to stay where its encoder says it is makes no torque."""
        sensors = Sensors(robot, 2, RATE, with_errors(joint_offset=0.02))
        truth, command = level(2, robot), np.zeros(2, COMMAND)
        command["joint_pos"] = sensors.reset(generators(2), truth)["joint_pos"]
        command["stiffness"] = 100.0
        assert np.abs(command["joint_pos"] - truth["joint_pos"]).min() > 0
        np.testing.assert_allclose(sensors.measure(truth, sensors.to_motors(command))["torque"], 0.0, atol=1e-9)


@pytest.fixture(scope="module")
def noisy(robot: Robot) -> Any:
    """Many readings of robots at rest, with the default errors."""
    truth = level(1, robot)
    truth["foot_force"][:, :, 2] = 30.0
    return measured(robot, np.repeat(truth, 2000), SensorConfig(), n=8)


class TestNoise:
    @pytest.mark.parametrize("name", ["gyro", "accel", "joint_pos", "joint_vel", "torque"])
    def test_it_is_as_large_as_said_and_white(self, noisy: np.ndarray, name: str) -> None:
        x = noisy[name][:, 10:]
        x = x - x.mean(axis=1, keepdims=True)
        assert np.std(x) == pytest.approx(getattr(SensorConfig(), f"{name}_noise"), rel=0.03)
        assert abs(np.mean(x[:, 1:] * x[:, :-1]) / np.var(x)) < 0.02

    def test_what_lasts_is_drawn_for_each_episode(self, noisy: np.ndarray, robot: Robot) -> None:
        offset = noisy["joint_pos"].mean(axis=1) - robot.home_joint_pos
        assert np.std(offset) == pytest.approx(SensorConfig().joint_offset, rel=0.3)
        foot = noisy["foot_force"].mean(axis=1) - 30.0
        assert 0.5 * SensorConfig().foot_offset < np.std(foot) < 2 * SensorConfig().foot_offset

    def test_the_seed_decides(self, robot: Robot) -> None:
        truth = tumbling(robot, 20)
        first, again, other = (measured(robot, truth, SensorConfig(), seed, n=2) for seed in (5, 5, 6))
        assert first.tobytes() == again.tobytes()
        assert (first["gyro"] != other["gyro"]).all()
        assert (first["gyro"][0] != first["gyro"][1]).all()

    def test_a_robot_draws_the_same_beside_others(self, robot: Robot) -> None:
        truth = tumbling(robot, 300)  # over several blocks of noise
        alone, beside = (measured(robot, truth, SensorConfig(), n=n) for n in (1, 3))
        assert alone[0].tobytes() == beside[0].tobytes()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"gyro_noise": -1.0}, "gyro_noise must not be negative, found -1.0"),
        ({"imu_rate_hz": 0.0}, "imu_rate_hz must be positive"),
        ({"foot_latency_s": float("inf")}, "foot_latency_s must be finite"),
    ],
)
def test_parameters_out_of_their_range(change: dict[str, float], message: str) -> None:
    with pytest.raises(ConfigError, match=f"sensors: {message}"):
        dataclasses.replace(SensorConfig(), **change)


def test_conditions_know_what_can_be_observed() -> None:
    with pytest.raises(ConfigError, match="unknown observation 'sensor'; there are truth, sensors; did you mean"):
        Conditions(observe="sensor")
    with pytest.raises(ConfigError, match="seed must not be negative"):
        Conditions(seed=-1)
