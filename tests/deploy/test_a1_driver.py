"""The A1's driver with a binding that is made up, after what the published code does with the real one."""

import sys
import types
from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from fastmimic.base.errors import DriverError
from fastmimic.deploy.a1_driver import A1Driver
from fastmimic.deploy.driver import RobotDriver
from fastmimic.robot import Robot
from fastmimic.robot.state import COMMAND

MADE: "list[Binding]" = []


class Binding:
    """An A1 that answers each command with a state 2 ms later."""

    def __init__(self, level: int) -> None:
        assert level == 0xFF
        self.commands: list[np.ndarray[Any, Any]] = []
        self.answers = True
        motors = [
            SimpleNamespace(q=q, dq=0.1 * j, tauEst=-0.2 * j) for j, q in enumerate([0.05, 0.9, -1.8] * 4 + [0] * 8)
        ]
        imu = SimpleNamespace(quaternion=[0.8, 0.0, 0.6, 0.0], gyroscope=[1, 2, 3], accelerometer=[4, 5, 6])
        self.state = SimpleNamespace(imu=imu, motorState=motors, footForce=[10, -20, 30, 40], tick=0)
        MADE.append(self)

    def send_command(self, command: np.ndarray[Any, Any]) -> None:
        assert len(command) == 60
        self.commands.append(np.array(command))
        if self.answers:
            self.state.tick += 2

    def receive_observation(self) -> SimpleNamespace:
        return self.state


@pytest.fixture(autouse=True)
def module(monkeypatch: pytest.MonkeyPatch) -> types.ModuleType:
    made = types.ModuleType("robot_interface")
    made.RobotInterface = Binding  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "robot_interface", made)
    MADE.clear()
    return made


@pytest.fixture
def driver(robot: Robot) -> Iterator[A1Driver]:
    with A1Driver(robot) as found:
        yield found


def test_it_asks_with_commands_that_move_nothing(driver: A1Driver) -> None:
    (binding,) = MADE
    assert binding.commands
    assert not any(command.any() for command in binding.commands)
    assert driver.packets.sent == 0


def test_it_can_listen_without_saying_anything(robot: Robot) -> None:
    with pytest.raises(DriverError, match="no state of an A1"):
        A1Driver(robot, release=False, timeout_s=0.05).open()
    assert not MADE[0].commands


def test_a_command_is_interleaved_joint_by_joint(driver: A1Driver) -> None:
    command = np.zeros(1, COMMAND)
    for k, name in enumerate(("joint_pos", "stiffness", "joint_vel", "damping", "torque")):
        command[name] = 10 * k + np.arange(12)
    driver.write(command)
    sent = MADE[0].commands[-1]
    assert sent.dtype == np.float32
    assert sent[:5].tolist() == [0, 10, 20, 30, 40]
    assert sent[-5:].tolist() == [11, 21, 31, 41, 51]
    assert driver.packets.sent == 1


def test_a_state_becomes_a_reading_once(driver: A1Driver) -> None:
    driver.write(np.zeros(1, COMMAND))
    state = driver.read()
    assert state is not None
    reading = state.reading[0]
    assert reading["quat"] == pytest.approx([0.8, 0.0, 0.6, 0.0])
    assert reading["gyro"].tolist() == [1, 2, 3]
    assert reading["accel"].tolist() == [4, 5, 6]
    assert reading["joint_pos"] == pytest.approx([0.05, 0.9, -1.8] * 4)
    assert reading["joint_vel"] == pytest.approx(0.1 * np.arange(12))
    assert reading["torque"] == pytest.approx(-0.2 * np.arange(12))
    assert reading["foot_force"].tolist() == [10, -20, 30, 40]
    assert state.sequence == MADE[0].state.tick
    assert driver.read(0.01) is None


def test_states_that_make_no_sense_are_rejected(driver: A1Driver) -> None:
    binding = MADE[0]
    binding.state.imu.gyroscope = [0.0, np.nan, 0.0]
    driver.write(np.zeros(1, COMMAND))
    assert driver.read() is None
    assert driver.packets.rejected == 1


def test_a_command_that_is_not_finite_is_not_sent(driver: A1Driver) -> None:
    command, before = np.zeros(1, COMMAND), len(MADE[0].commands)
    command["joint_pos"][0, 0] = np.inf
    with pytest.raises(DriverError, match="not finite"):
        driver.write(command)
    assert len(MADE[0].commands) == before


def test_the_older_binding_is_made_without_a_level(robot: Robot, module: types.ModuleType) -> None:
    class Older(Binding):
        def __init__(self) -> None:
            super().__init__(0xFF)

    module.RobotInterface = Older  # type: ignore[attr-defined]
    with A1Driver(robot) as driver:
        driver.write(np.zeros(1, COMMAND))
        assert driver.read() is not None


def test_without_the_binding_it_is_said_where_to_get_it(robot: Robot, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "robot_interface", None)
    with pytest.raises(DriverError, match="build it from third_party/unitree_legged_sdk"):
        A1Driver(robot).open()


def test_another_module_of_that_name_is_not_taken_for_it(robot: Robot, module: types.ModuleType) -> None:
    del module.RobotInterface
    with pytest.raises(DriverError, match="is another 'robot_interface'"):
        A1Driver(robot).open()


def test_silence_is_said_to_be_that(robot: Robot, module: types.ModuleType) -> None:
    class Silent(Binding):
        def send_command(self, command: np.ndarray[Any, Any]) -> None:
            pass

    module.RobotInterface = Silent  # type: ignore[attr-defined]
    with pytest.raises(DriverError, match="no state of an A1 within"):
        A1Driver(robot, timeout_s=0.05).open()


def test_joints_outside_its_limits_mean_another_robot(robot: Robot, module: types.ModuleType) -> None:
    class Other(Binding):
        def __init__(self, level: int) -> None:
            super().__init__(level)
            self.state.motorState[2].q = 0.4

    module.RobotInterface = Other  # type: ignore[attr-defined]
    with pytest.raises(DriverError, match=r"FR_knee is at 0\.40 rad, outside the a1's"):
        A1Driver(robot, timeout_s=0.05).open()


def test_a_driver_that_lacks_a_method_cannot_be_made(robot: Robot) -> None:
    class Deaf(A1Driver):
        _newest = RobotDriver._newest

    with pytest.raises(TypeError, match=r"abstract method '?_newest"):
        Deaf(robot)
