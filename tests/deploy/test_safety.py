"""Every violation, caused: it ends in damping, says why, and leaves a complete log."""

import os
import pty
import runpy
import signal
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from deploy.rig import Rig, assert_damped, once
from fastmimic.base.errors import ConfigError, DriverError
from fastmimic.base.text import markdown_table
from fastmimic.deploy.computer import StopSwitch
from fastmimic.deploy.deployment import Deployment
from fastmimic.deploy.driver import StateMessage
from fastmimic.deploy.safety import Guard, SafetyLimits, StopReason, read_limits
from fastmimic.deploy.sim import LinkFaults, SimDriver
from fastmimic.deploy.state_machine import DeploymentPhase, StateMachine
from fastmimic.robot import Robot, load_robot
from fastmimic.robot.state import COMMAND, READING
from robot.mjcf import a1_tree, heavier, write


def following(machine: StateMachine) -> bool:
    return machine.phase is DeploymentPhase.FOLLOW and bool(machine.follower.clock["sample"][0] > 100)


def assert_stopped(rig: Rig, done: Deployment, reason: StopReason, text: str) -> None:
    """Damped for that reason, with a log to the end."""
    assert done.outcome.stopped_by is reason, done.outcome
    assert text in done.outcome.text
    assert done.result["stopped_by"] == reason.value
    assert "\n" not in done.outcome.text
    assert_damped(rig)
    rows = done.log.rows
    assert rows["phase"][-1] == DeploymentPhase.DAMP
    damped = rows[rows["phase"] == DeploymentPhase.DAMP]
    assert len(damped) == round(SafetyLimits().damping_s * 500)
    np.testing.assert_array_equal(damped["command"]["stiffness"], 0.0)
    crouched = (rows["phase"] == DeploymentPhase.CROUCH).sum()
    assert crouched == (round(SafetyLimits().crouch_s * 500) if reason.crouches else 0)
    assert done.result["periods"] == len(rows)


def tampered(rig: Rig, field: str, value: Any) -> Callable[[StateMachine], None]:
    """From now on a field of each state is something else."""

    def change(state: StateMessage) -> StateMessage:
        state.reading[field][0] = value(state.reading[field][0])
        return state

    def act(machine: StateMachine) -> None:
        rig.driver.change = change

    return act


def at(index: int, value: float) -> Callable[[np.ndarray], np.ndarray]:
    def put(array: np.ndarray) -> np.ndarray:
        array[index] = value
        return array

    return put


STATES = {
    "a joint beyond its range": (
        ("joint_pos", at(4, 4.4)),
        StopReason.JOINT_POSITION,
        "FL_hip: angle 4.40 rad, beyond 4.29 rad",
    ),
    "a joint below its range": (
        ("joint_pos", at(11, -2.9)),
        StopReason.JOINT_POSITION,
        "RL_knee: angle -2.90 rad, beyond -2.80 rad",
    ),
    "a joint too fast": (
        ("joint_vel", at(2, -40.0)),
        StopReason.JOINT_VELOCITY,
        "FR_knee: speed 40.00 rad/s, beyond 31.50 rad/s",
    ),
    "a motor beyond all": (("torque", at(0, 60.0)), StopReason.TORQUE, "FR_abduction: torque 60.00 N·m, beyond 50.25"),
    "a motor at its limit for long": (("torque", at(7, -33.0)), StopReason.TORQUE, "for more than 0.3 s"),
    "an orientation that jumps": (
        ("quat", lambda q: np.array([np.cos(0.4), 0.0, np.sin(0.4), 0.0])),
        StopReason.IMU,
        "orientation and gyroscope differ by 0.78 rad; 0.1 are allowed",
    ),
    "not a number": (("gyro", at(1, np.nan)), StopReason.NOT_FINITE, "a state of the robot is not finite"),
    "infinite": (("accel", at(1, np.inf)), StopReason.NOT_FINITE, "a state of the robot is not finite"),
}


@pytest.mark.parametrize("case", STATES)
def test_a_state_beyond_the_limits(case: str, stands: Rig) -> None:
    (field, value), reason, text = STATES[case]
    done = stands.run(watch=once(following, tampered(stands, field, value)))
    assert_stopped(stands, done, reason, text)


def test_a_robot_that_is_tipped_over(stands: Rig) -> None:
    def tip(machine: StateMachine) -> None:
        state = stands.sim.body.observation[0]
        position, rolling = state["root_pos"][None] + [[0.0, 0.0, 0.2]], np.array([[9.0, 0.0, 0.0]])
        rest = state["root_quat"][None], state["joint_pos"][None], np.zeros((1, 3)), rolling, np.zeros((1, 12))
        stands.sim.body.simulation.reset(position, *rest)

    done = stands.run(watch=once(following, tip))
    assert done.outcome.stopped_by is StopReason.TILT
    assert "rad from the reference's; 0.6 are allowed" in done.outcome.text
    assert done.result["fell"]


def test_a_base_that_sinks(stands: Rig) -> None:
    """The legs fold under it: the motors of a real robot may lose their power, and still tell what was commanded."""

    def weaken(machine: StateMachine) -> None:
        def change(state: StateMessage) -> StateMessage:
            reading, command = state.reading.copy(), machine._last
            reading["torque"] = command["torque"]
            return replace(state, reading=reading)

        stands.driver.change = change
        stands.sim.body._last["stiffness"] = 0.0
        stands.sim._commands.send = lambda *_: None  # no command arrives any more
        stands.sim.body._commanded = 10**9  # and its watchdog does not mind

        stands.sim.body._last["torque"] *= 0.5

    done = stands.run(watch=once(following, weaken))
    assert done.outcome.stopped_by is StopReason.HEIGHT
    assert "m above the ground; 0.171 to 0.400 m are allowed" in done.outcome.text
    assert done.result["fell"]


def test_a_robot_that_falls_silent(stands: Rig) -> None:
    def silence(machine: StateMachine) -> None:
        stands.driver.change = lambda state: None

    done = stands.run(watch=once(following, silence))
    assert_stopped(stands, done, StopReason.STALE_STATE, "no state of the robot for 22 ms; 20 are allowed")


def test_a_wire_on_which_all_is_damaged(stands: Rig, a1: Robot) -> None:
    def cut(machine: StateMachine) -> None:
        stands.sim._states.faults = LinkFaults(corrupt=1.0)

    done = stands.run(watch=once(following, cut))
    assert_stopped(stands, done, StopReason.STALE_STATE, "no state")
    assert done.result["packets"]["rejected"] > 100


def test_a_computer_that_is_too_slow(stands: Rig) -> None:
    def delay(machine: StateMachine) -> None:
        step = machine.controller.step

        def slow(*arguments: Any) -> Any:
            stands.clock.time_s += 0.06
            return step(*arguments)

        machine.controller.step = slow  # type: ignore[method-assign]

    done = stands.run(watch=once(following, delay))
    assert_stopped(stands, done, StopReason.OVERRUN, "a command was 58.0 ms late; 50 are allowed")


def test_a_delay_that_is_short_is_counted_and_survived(stands: Rig) -> None:
    def pause(machine: StateMachine) -> None:
        stands.clock.time_s += 0.007

    done = stands.run(watch=once(following, pause))
    assert done.outcome.stopped_by is StopReason.DURATION
    assert done.result["periods_skipped"] == 2
    assert done.result["deadline_misses"] == 0


def test_a_state_that_arrives_just_after_a_pause_is_in_time(stands: Rig) -> None:
    """Of a computer on which everything paused, the robot's messages included."""

    def pause(machine: StateMachine) -> None:
        stands.clock.time_s += 0.03
        read = stands.driver.read

        def not_yet(timeout_s: float = 0.0) -> StateMessage | None:
            if timeout_s == 0.0:
                return None
            stands.driver.read = read  # type: ignore[method-assign]
            return read(timeout_s)

        stands.driver.read = not_yet  # type: ignore[method-assign]

    done = stands.run(watch=once(following, pause))
    assert done.outcome.stopped_by is StopReason.DURATION
    assert done.log.rows["late_s"].max() > 0.025


def test_a_period_that_takes_too_long_is_a_miss(stands: Rig) -> None:
    def delay(machine: StateMachine) -> None:
        write = stands.driver.write

        def slow(command: np.ndarray) -> None:
            stands.driver.write = write  # type: ignore[method-assign]
            stands.clock.time_s += 0.003
            write(command)

        stands.driver.write = slow  # type: ignore[method-assign]

    done = stands.run(watch=once(following, delay))
    assert done.outcome.stopped_by is StopReason.DURATION
    assert done.result["deadline_misses"] == 1


def test_forces_that_cannot_be_computed(stands: Rig) -> None:
    def spoil(machine: StateMachine) -> None:
        machine.controller._config["r_weight"] = np.nan  # type: ignore[attr-defined]

    done = stands.run(watch=once(following, spoil))
    assert_stopped(stands, done, StopReason.QP_FAILURE, "6 times in a row; 5 are allowed")


def test_a_command_that_is_no_number(stands: Rig) -> None:
    def spoil(machine: StateMachine) -> None:
        command = np.zeros(1, COMMAND)
        command["torque"][0, 5] = np.nan
        machine.controller.step = lambda *_: command  # type: ignore[method-assign]

    done = stands.run(watch=once(following, spoil))
    assert_stopped(stands, done, StopReason.NOT_FINITE, "a command of the controller is not finite")
    assert all(np.isfinite(command["torque"]).all() for command in stands.driver.written)


def test_an_estimate_that_is_no_number(stands: Rig) -> None:
    def spoil(machine: StateMachine) -> None:
        machine.estimator.state["estimate"] = np.nan

    done = stands.run(watch=once(following, spoil))
    assert_stopped(stands, done, StopReason.NOT_FINITE, "the estimate of the robot's state is not finite")


def test_a_robot_that_cannot_stand_up(stands: Rig, a1: Robot) -> None:
    def blocked(state: StateMessage) -> StateMessage:
        state.reading["joint_pos"][0, 8] = -2.5  # a knee that stays bent
        return state

    stands.driver.change = blocked
    done = stands.run()
    assert_stopped(stands, done, StopReason.POSTURE, "RR_knee")
    assert DeploymentPhase.FOLLOW not in done.log.rows["phase"]


@pytest.mark.parametrize("broken", ["read", "write"])
def test_a_driver_that_fails(stands: Rig, broken: str) -> None:
    def fail(machine: StateMachine) -> None:
        def failing(*_: Any) -> Any:
            raise DriverError("the socket is gone")

        setattr(stands.driver, broken, failing)

    done = stands.run(watch=once(following, fail))
    assert done.outcome.stopped_by is StopReason.DRIVER
    assert done.outcome.text == "the socket is gone"
    assert stands.driver.closed == 1


def test_a_bug_in_the_loop_damps_the_robot_as_well(stands: Rig) -> None:
    def fail(machine: StateMachine) -> None:
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        stands.run(watch=once(following, fail))
    last = stands.driver.written[-1]
    np.testing.assert_array_equal(last["stiffness"], 0.0)
    np.testing.assert_array_equal(last["damping"], SafetyLimits().damping)
    assert stands.driver.closed == 1


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal(stands: Rig, number: signal.Signals) -> None:
    before = signal.getsignal(number)
    done = stands.run(watch=once(following, lambda machine: os.kill(os.getpid(), number)))
    assert_stopped(stands, done, StopReason.SIGNAL, "a signal")
    assert DeploymentPhase.CROUCH in done.log.rows["phase"]
    assert signal.getsignal(number) is before


def test_a_second_signal_does_not_wait_for_the_damping(stands: Rig) -> None:
    def twice(machine: StateMachine) -> None:
        os.kill(os.getpid(), signal.SIGINT)
        os.kill(os.getpid(), signal.SIGINT)

    done = stands.run(watch=once(following, twice))
    assert done.outcome.stopped_by is StopReason.SIGNAL
    assert (done.log.rows["phase"] == DeploymentPhase.DAMP).sum() == 1
    np.testing.assert_array_equal(stands.driver.written[-1]["stiffness"], 0.0)


@pytest.mark.parametrize("key", [" ", "\n", "q"])
def test_a_key_in_the_terminal(stands: Rig, key: str) -> None:
    keyboard, terminal = pty.openpty()
    with os.fdopen(terminal, "r") as stream:
        stands.switch = StopSwitch(stream)

        def press(machine: StateMachine) -> None:
            os.write(keyboard, key.encode())
            time.sleep(0.01)  # for the terminal to pass it on

        done = stands.run(watch=once(following, press))
    os.close(keyboard)
    assert_stopped(stands, done, StopReason.KEY, "a key")
    assert DeploymentPhase.CROUCH not in done.log.rows["phase"]


def test_the_key_that_has_it_sit_down_and_keys_that_mean_nothing() -> None:
    keyboard, terminal = pty.openpty()
    with os.fdopen(terminal, "r") as stream, StopSwitch(stream) as switch:
        os.write(keyboard, b"xyz")
        time.sleep(0.01)
        switch.poll()
        assert (switch.key, switch.leave) == (False, False)
        os.write(keyboard, b"s")
        time.sleep(0.01)
        switch.poll()
        assert (switch.key, switch.leave) == (False, True)
    os.close(keyboard)


@pytest.mark.parametrize(("key", "agreed"), [(b"\n", True), (b"q", False), (b" ", False)])
def test_only_enter_is_consent(key: bytes, agreed: bool) -> None:
    keyboard, terminal = pty.openpty()
    with os.fdopen(terminal, "r") as stream, StopSwitch(stream) as switch:
        os.write(keyboard, key)
        assert switch.wait_for_consent() is agreed
    os.close(keyboard)


@pytest.mark.nojit
def test_a_state_is_held_against_the_limits_without_the_jit_as_well(a1: Robot) -> None:
    guard = Guard(a1, SafetyLimits(), 500.0)
    reading = np.zeros(1, READING)
    reading["quat"], reading["joint_pos"] = (1.0, 0.0, 0.0, 0.0), a1.home_joint_pos
    assert guard.check_state(reading) is None
    reading["joint_vel"][0, 3] = -50.0
    found = guard.check_state(reading)
    assert found is not None
    assert (found.reason, found.text) == (
        StopReason.JOINT_VELOCITY,
        "FL_abduction: speed 50.00 rad/s, beyond 31.50 rad/s",
    )
    reading["joint_vel"] = 0.0
    reading["quat"] = np.cos(0.35), np.sin(0.35), 0.0, 0.0
    found = guard.check_state(reading)
    assert found is not None
    assert found.text == "the trunk's tilt is 0.70 rad from the vertical; 0.6 are allowed"


@pytest.mark.nojit
def test_commands_are_cut_to_what_the_robot_can(a1: Robot) -> None:
    guard = Guard(a1, SafetyLimits(), 500.0)
    command = np.zeros(1, COMMAND)
    command["joint_pos"], command["joint_vel"], command["torque"] = 9.0, -99.0, 99.0
    command["stiffness"], command["damping"] = 1e4, -1.0
    assert guard.cut_command(command) is None
    np.testing.assert_array_equal(command["joint_pos"][0], a1.joint_upper)
    np.testing.assert_array_equal(command["joint_vel"][0], -a1.joint_speed_limit)
    np.testing.assert_array_equal(command["torque"][0], a1.torque_limit)
    np.testing.assert_array_equal(command["stiffness"], 300.0)
    np.testing.assert_array_equal(command["damping"], 0.0)
    assert guard.cut == 60
    fine = command.copy()
    guard.cut_command(command)
    assert guard.cut == 0
    assert command.tobytes() == fine.tobytes()


class TestLimits:
    def test_a_file_and_options_that_go_before_it(self, a1: Robot, tmp_path: Path) -> None:
        path = tmp_path / "limits.toml"
        path.write_text("tilt = 0.4\nqp_failures = 3\n")
        found = read_limits(a1, path, ["tilt=0.5", "stale_s=0.03"])
        assert found == SafetyLimits(tilt=0.5, qp_failures=3, stale_s=0.03)

    def test_gains_are_in_the_units_of_each_robot(self, a1: Robot, tmp_path: Path) -> None:
        heavy = load_robot(write(heavier(a1_tree(), 8.0), tmp_path / "heavy.xml"))
        assert SafetyLimits.of(a1) == SafetyLimits()
        limits = SafetyLimits.of(heavy)
        assert limits.damping == pytest.approx(8.0 * SafetyLimits().damping)
        assert limits.stiffness_most == pytest.approx(8.0 * SafetyLimits().stiffness_most)
        assert limits.tilt == SafetyLimits().tilt
        assert read_limits(heavy, None, ["damping=4"]).damping == 4.0

    @pytest.mark.parametrize(
        ("settings", "said"),
        [
            (["tlit=0.5"], "--limit: unknown 'tlit'.*did you mean 'tilt'"),
            (["tilt"], "NAME=VALUE"),
            (["tilt=steep"], "NAME=VALUE"),
            (["tilt=-1"], r"tilt must be in \(0, 1\.5708\]"),
            (["tilt=nan"], "tilt must be finite"),
            (["tilt=2"], r"tilt must be in \(0, 1\.5708\]"),
            (["height_least=2"], "must be below height_most"),
            (["qp_failures=2.5"], "of the kind of 5"),
        ],
    )
    def test_what_they_cannot_be(self, settings: list[str], said: str, a1: Robot) -> None:
        with pytest.raises(ConfigError, match=said):
            read_limits(a1, None, settings)

    def test_the_documentation_has_their_table(self) -> None:
        docs = Path(__file__).parents[2] / "docs"
        described = runpy.run_path(str(docs / "hooks.py"))["describe"](SafetyLimits)
        rows = markdown_table(("limit", "default", "unit", "range", "meaning, and `stopped_by`"), described)
        page = docs / "deploy.md"
        found = page.read_text(encoding="utf-8").split("<!-- limits:begin -->")[1].split("<!-- limits:end -->")[0]
        assert found.split("\n")[1:-1] == rows

    def test_a_file_that_is_none(self, a1: Robot, tmp_path: Path) -> None:
        path = tmp_path / "limits.toml"
        path.write_text("tilt: 0.5")
        with pytest.raises(ConfigError, match=r"limits\.toml: cannot be read as TOML"):
            read_limits(a1, path)


def test_the_simulated_robot_counts_what_it_is_sent(a1: Robot) -> None:
    with SimDriver(a1) as sim:
        assert sim.packets.sent == 0
        sim.write(np.zeros(1, COMMAND))
        assert sim.packets.sent == 1


@pytest.mark.slow
@pytest.mark.parametrize("limit", ["damp", "sit", "ignore"])
def test_another_program_that_commands_the_motors_while_it_trots(trotting: Rig, limit: str) -> None:
    def hear(machine: object) -> None:
        trotting.sim.packets.foreign += 1

    limits = SafetyLimits(foreign=limit)
    done = trotting.run(duration_s=0.5, limits=limits, watch=once(lambda machine: machine.in_motion, hear))
    assert done.result["packets"]["foreign"] == 1
    phases = done.log.rows["phase"]
    if limit == "ignore":
        assert done.outcome.stopped_by is StopReason.DURATION
        return
    assert done.outcome.stopped_by is StopReason.FOREIGN
    trotted = done.log.rows["in_motion"].sum()
    if limit == "damp":
        assert_damped(trotting, limits)
        assert trotted <= 2, "periods: at once"
    else:
        assert phases[-1] == DeploymentPhase.RELEASE
        assert (phases == DeploymentPhase.SIT).any()
