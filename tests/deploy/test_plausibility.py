"""Sensors that lie: each is found before the robot steps, or while it does, and the robot is down before it falls."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pytest

from deploy.rig import Rig, once
from fastmimic.base.rotations import quat_from_rotvec, quat_multiply, quat_rotate_inverse
from fastmimic.deploy.deployment import Deployment
from fastmimic.deploy.driver import StateMessage
from fastmimic.deploy.plausibility import Senses
from fastmimic.deploy.safety import Guard, SafetyLimits, StopReason
from fastmimic.deploy.sequence import MotionSequence
from fastmimic.deploy.sim import SimDriver
from fastmimic.deploy.state_machine import DeploymentPhase, StateMachine
from fastmimic.robot import Robot
from fastmimic.robot.state import COMMAND, READING
from fastmimic.simulation.conditions import Conditions

Tamper = Callable[[Any], None]  # changes a reading of `READING` in place


def mounted(angle: float, *axis: float) -> Tamper:
    """An IMU that is turned against the trunk."""
    turn = quat_from_rotvec(angle * np.array(axis))

    def tamper(reading: Any) -> None:
        reading["quat"] = quat_multiply(reading["quat"], turn)
        reading["gyro"] = quat_rotate_inverse(turn, reading["gyro"])
        reading["accel"] = quat_rotate_inverse(turn, reading["accel"])

    return tamper


def stuck(*fields: str, at: Any = slice(None)) -> Tamper:
    first: list[Any] = []

    def tamper(reading: Any) -> None:
        first.append(reading.copy())
        for field in fields:
            reading[field][at] = first[0][field][at]

    return tamper


def scaled(field: str, factor: float) -> Tamper:
    def tamper(reading: Any) -> None:
        reading[field] *= factor

    return tamper


def shifted(field: str, value: float, at: int) -> Tamper:
    def tamper(reading: Any) -> None:
        reading[field][at] += value

    return tamper


def swapped(one: int, other: int) -> Tamper:
    def tamper(reading: Any) -> None:
        for field in ("joint_pos", "joint_vel"):
            reading[field][[one, other]] = reading[field][[other, one]]

    return tamper


def tampered(rig: Rig, tamper: Tamper) -> None:
    def change(state: StateMessage) -> StateMessage:
        reading = state.reading.copy()
        tamper(reading[0])
        return replace(state, reading=reading)

    rig.driver.change = change


BEFORE = {
    "IMU frozen": (stuck("quat", "gyro", "accel"), StopReason.IMU, "the orientation has stood still"),
    "IMU turned by 90°": (mounted(np.pi / 2, 0, 0, 1), StopReason.IMU, "does not turn as the legs do"),
    "IMU tilted": (mounted(0.4, 0, 1, 0), StopReason.IMU, "the IMU's level and the plane of the feet"),
    "gyroscope in °/s": (scaled("gyro", 180 / np.pi), StopReason.IMU, "differ by"),
    "a knee frozen": (stuck("joint_pos", "joint_vel", at=2), StopReason.JOINT_SENSOR, "FR_knee has stood still"),
    "hips swapped": (swapped(1, 4), StopReason.JOINT_SENSOR, "hip: its angle moved by"),
    "joint speeds dead": (scaled("joint_vel", 0.0), StopReason.JOINT_SENSOR, "its speed moved by 0.00"),
    "torques in other units": (scaled("torque", 0.1), StopReason.TORQUE_SENSOR, "of the robot's weight"),
}


@pytest.mark.slow
@pytest.mark.parametrize("case", BEFORE)
def test_a_sensor_that_is_wrong_from_the_beginning(case: str, stands: Rig) -> None:
    tamper, reason, text = BEFORE[case]
    tampered(stands, tamper)
    done = stands.run()
    assert (done.outcome.stopped_by, done.result["fell"]) == (reason, False), done.outcome
    assert text in done.outcome.text
    assert DeploymentPhase.FOLLOW not in done.log.rows["phase"]


WHILE = {
    "gyroscope frozen": (stuck("gyro"), StopReason.IMU),
    "orientation turned": (mounted(0.3, 1, 0, 0), StopReason.IMU),
    "a hip frozen": (stuck("joint_pos", "joint_vel", at=4), StopReason.JOINT_SENSOR),
    "joint speeds of the other sign": (scaled("joint_vel", -1.0), StopReason.JOINT_SENSOR),
    "torques dead": (scaled("torque", 0.0), StopReason.TORQUE_SENSOR),
    "an angle that jumps": (shifted("joint_pos", 0.3, 5), StopReason.JOINT_SENSOR),
}


def stepping(machine: StateMachine, after: int = 100) -> bool:
    return machine.in_motion and machine.follower.steps > after


@pytest.mark.slow
@pytest.mark.parametrize("case", WHILE)
def test_a_sensor_that_fails_while_the_robot_trots(case: str, trotting: Rig) -> None:
    """The robot is crouched before it falls: it stands upright until then, and its trunk lands softly."""
    tamper, *reasons = WHILE[case]
    done = trotting.run(watch=once(stepping, lambda machine: tampered(trotting, tamper)), cycles=6)
    assert done.outcome.stopped_by in reasons, done.outcome
    assert not done.result["fell"]
    assert done.outcome.phase is DeploymentPhase.FOLLOW
    assert not trotting.sim.body.fell
    before = ~np.isin(done.log.rows["phase"], (DeploymentPhase.CROUCH, DeploymentPhase.DAMP))
    assert tilt(done)[before].max() < 0.3
    assert trotting.sim.body.observation[0]["root_pos"][2] < 0.17, "m; it lies"


@pytest.mark.slow
def test_an_accelerometer_in_g_is_found_mostly_before_a_fall(a1: Robot, way: MotionSequence) -> None:
    """Its mean tells after half a second: by then the estimate may have led a joint to its limit, and in a quarter of
    the moments the robot to a fall."""
    fell = []
    for after in (100, 150, 200):
        rig = Rig(a1, way)
        begins, tamper = partial(stepping, after=after), scaled("accel", 1 / 9.81)
        done = rig.run(watch=once(begins, lambda machine, rig=rig, tamper=tamper: tampered(rig, tamper)), cycles=6)
        assert done.outcome.stopped_by in (StopReason.IMU, StopReason.JOINT_POSITION), done.outcome
        fell.append(done.result["fell"])
    assert sum(fell) <= 1


def tilt(done: Deployment) -> Any:
    """(t,) of the trunk, as it truly was, rad."""
    assert done.log.truth is not None
    x, y = done.log.truth["root_quat"][:, 1], done.log.truth["root_quat"][:, 2]
    return np.arccos(1.0 - 2.0 * (x * x + y * y))


def tremble(reading: Any) -> None:
    """Sensors that work never say the same twice."""
    for name in ("quat", "gyro", "accel", "joint_vel"):
        reading[name] += 1e-9


def senses(robot: Robot) -> tuple[Senses, Any, Any]:
    """Of a robot whose sensors and motors say what they should: also a reading and a command."""
    reading, command = np.zeros(1, READING), np.zeros(1, COMMAND)
    reading["quat"], reading["accel"] = (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 9.81)
    return Guard(robot, SafetyLimits.of(robot), 500.0).senses, reading, command


@pytest.mark.nojit
def test_a_reading_that_is_late_is_not_a_sensor_that_stands_still(a1: Robot) -> None:
    for elapsed_s in (0.0, 0.002):
        compared, reading, command = senses(a1)
        found = []
        for i in range(50):
            command["joint_pos"] = 0.02 * i
            found.append(compared.check(reading, command, elapsed_s))
        assert any(found) == (elapsed_s > 0.0)


@pytest.mark.nojit
def test_an_angle_that_jumps_is_doubted_at_once(a1: Robot) -> None:
    compared, reading, command = senses(a1)
    reading["joint_vel"][0, 5], found = 2.0, []
    for i in range(300):
        tremble(reading)
        reading["joint_pos"][0, 5] = 0.004 * i + 0.3 * (i >= 250)
        found.append(compared.check(reading, command, 0.002))
    assert not any(found[:250])
    assert found[250] == ("joint_sensor", "FL_knee: angle and speed differ by 0.30 rad; 0.25 are allowed")


@pytest.mark.nojit
def test_a_gyroscope_of_the_other_sign_is_doubted_before_the_trunk_has_turned_far(a1: Robot) -> None:
    compared, reading, command = senses(a1)
    rate, sign, found = 1.0, 1.0, []  # rad/s
    for i in range(300):
        tremble(reading)
        sign = 1.0 if i < 250 else -1.0
        reading["quat"] = quat_from_rotvec(np.array([0.002 * rate * i, 0.0, 0.0]))
        reading["gyro"] = (sign * rate, 0.0, 0.0)
        tremble(reading)
        found.append(compared.check(reading, command, 0.002))
    assert not any(found[:250])
    doubt = next(k for k, doubt in enumerate(found) if doubt) - 250
    assert doubt * 0.002 * rate < 0.04  # rad; by the sum over two seconds it would have been 0.05


@pytest.mark.nojit
@pytest.mark.parametrize(("share", "speed", "doubted"), [(0.0, 0.0, True), (0.5, 0.0, False), (0.0, 0.5, False)])
def test_a_motor_that_gives_no_torque(share: float, speed: float, doubted: bool, a1: Robot) -> None:
    """Weak motors are lived with, and at speed a motor may have no torque left."""
    compared, reading, command = senses(a1)
    found = []
    for i in range(300):
        given = 1.0 if i < 100 else share
        command["torque"][0, 4], reading["torque"][0, 4] = 10.0, 10.0 * given
        reading["joint_vel"][0, 4] = speed * a1.joint_speed_limit[4] * (i >= 100)
        reading["joint_pos"][0, 4] += 0.002 * reading["joint_vel"][0, 4]
        tremble(reading)
        found.append(compared.check(reading, command, 0.002))
    assert not any(found[:150])
    assert any(found) == doubted
    assert not doubted or found[-1] == ("torque_sensor", "FL_hip: its motor gives nothing of the torque commanded")


@pytest.mark.slow
@pytest.mark.parametrize("disturbance", ["side-push=8@9", "payload=5", "friction=0.3"])
def test_a_robot_that_has_a_hard_time_is_not_doubted(disturbance: str, trotting: Rig, a1: Robot) -> None:
    conditions = Conditions(observe="sensors", disturbances=(disturbance,))
    trotting.put_in(SimDriver(a1, trotting.clock, conditions=conditions))
    done = trotting.run(duration_s=2.0)
    assert done.outcome.stopped_by is StopReason.DURATION, done.outcome


def test_a_lean_that_is_switched_off(stands: Rig) -> None:
    done = stands.run(limits=SafetyLimits(lean=0.0))
    assert done.outcome.stopped_by is StopReason.DURATION
    assert DeploymentPhase.LEAN not in done.log.rows["phase"]


def test_a_robot_that_is_stopped_before_its_first_command_stays_folded(stands: Rig) -> None:
    """Nothing of what was rehearsed, a robot on its feet, is sent to one that lies."""
    begin = StateMachine.begin

    def silent(machine: StateMachine, reading: Any) -> Any:
        found = begin(machine, reading)
        stands.driver.change = lambda state: None
        return found

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(StateMachine, "begin", silent)
        done = stands.run(limits=SafetyLimits(stale_s=1e-4))
    assert done.outcome.stopped_by is StopReason.STALE_STATE
    first = done.log.rows["command"][done.log.rows["phase"] == DeploymentPhase.CROUCH][0]
    lying = done.log.rows["reading"]["joint_pos"][0]
    assert np.abs(first["joint_pos"] - lying).max() < 0.1 < np.abs(stands.sequence.stand - lying).max()


def test_a_dry_run_does_not_doubt_sensors_of_a_robot_that_it_does_not_move(stands: Rig) -> None:
    done = stands.run(dry_run=True)
    assert done.outcome.stopped_by is StopReason.DURATION
    assert not [line for line in done.noted if "torques" in line or "stood still" in line], done.noted
