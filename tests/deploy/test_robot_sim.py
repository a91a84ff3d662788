"""The simulated robot: its body, the faults of its wire, its log, and the process that it is."""

import contextlib
import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("cyclonedds", reason="CycloneDDS is not installed")


from deploy.dds_domains import free_domain
from fastmimic.base.errors import ConfigError, DriverError
from fastmimic.cli import main
from fastmimic.deploy.dds.cyclone import Participant
from fastmimic.deploy.driver import StateMessage
from fastmimic.deploy.go2 import messages
from fastmimic.deploy.go2.driver import Go2Driver
from fastmimic.deploy.log import GROUND_TRUTH, Recorder, load_ground_truth
from fastmimic.deploy.sim import LinkFaults, SimulatedBody, SimulatedLink
from fastmimic.deploy.sim_server import SimServer, SimSettings, go2_body
from fastmimic.robot import Robot, load_robot
from fastmimic.robot.state import COMMAND
from fastmimic.simulation.config import ideal_sensors
from fastmimic.simulation.simulators import PHYSICS_RATE_HZ


@pytest.fixture(scope="module")
def go2() -> Robot:
    return load_robot("go2")


def hold(robot: Robot, stiffness: float = 120.0) -> np.ndarray[Any, Any]:
    """A command to stand."""
    command = np.zeros(1, COMMAND)
    command["joint_pos"], command["stiffness"], command["damping"] = robot.home_joint_pos, stiffness, 4.0
    return command


def passed(body: SimulatedBody, seconds: float, command: np.ndarray[Any, Any] | None = None) -> None:
    """So many s, with a command in each step."""
    for _ in range(round(seconds * PHYSICS_RATE_HZ)):
        if command is not None:
            body.obey(command)
        body.step()
        if body.steps % 2 == 0:
            body.measure()


def height(body: SimulatedBody) -> float:
    return float(body.observation["root_pos"][0, 2])


def test_lying_it_stays_down_and_damps(go2: Robot) -> None:
    body = go2_body(go2, SimSettings())
    passed(body, 1.0)
    assert body.damped
    assert body.damped_s == pytest.approx(1.0)
    assert height(body) < 0.5 * go2.home_height
    assert not body.fell


def test_standing_its_own_service_holds_it(go2: Robot) -> None:
    body = go2_body(go2, SimSettings(start="standing"))
    passed(body, 2.0)
    assert body.service.active
    assert not body.damped
    assert height(body) == pytest.approx(go2.home_height, abs=0.02)


def test_the_service_lies_down_and_gets_up(go2: Robot) -> None:
    body = go2_body(go2, SimSettings(start="standing"))
    body.service.lie_down()
    passed(body, 2.0)
    assert height(body) < 0.5 * go2.home_height
    body.service.stand_up()
    passed(body, 2.5)
    assert height(body) == pytest.approx(go2.home_height, abs=0.02)
    assert not body.fell


def test_without_commands_for_20_ms_it_damps_and_obeys_again_with_the_next(go2: Robot) -> None:
    body = go2_body(go2, SimSettings(start="standing"))
    body.service.active = False
    passed(body, 0.5, hold(go2))
    passed(body, 0.019)
    assert not body.damped
    passed(body, 0.002)
    assert body.damped
    assert not body.command["stiffness"].any()
    passed(body, 1.0)
    assert height(body) < 0.7 * go2.home_height
    passed(body, 0.001, hold(go2))
    assert not body.damped


def test_its_motors_are_those_of_the_simulation_and_their_limits_too(go2: Robot) -> None:
    body = go2_body(go2, SimSettings(start="standing", sensors=ideal_sensors()))
    simulation = go2_body(
        go2, SimSettings(start="standing", sensors=ideal_sensors())
    ).simulation  # whose motor law has tests of its own
    body.service.active = False
    command = hold(go2)
    command["torque"], command["joint_vel"] = 2.0, 0.5
    for k in range(100):
        command["joint_pos"] = go2.home_joint_pos + 0.002 * k
        passed(body, 0.001, command)
        simulation.step(command)
        assert body.observation == simulation.observation
    command["torque"] = 1e3
    passed(body, 0.004, command)
    assert body.sensors.reading["torque"][0] == pytest.approx(go2.torque_limit)


def test_it_notices_that_it_has_fallen(go2: Robot) -> None:
    body = go2_body(go2, SimSettings(start="standing"))
    body.service.active = False
    limp = np.zeros(1, COMMAND)
    passed(body, 1.0, limp)
    assert body.fell


def test_its_sensors_are_not_the_truth_but_near_it(go2: Robot) -> None:
    body = go2_body(go2, SimSettings(start="standing", seed=3))
    passed(body, 1.0)
    off = body.sensors.reading["joint_pos"] - body.observation["joint_pos"]
    assert 0 < abs(off).max() < 0.03
    assert body.sensors.reading["foot_force"].sum() == pytest.approx(9.81 * go2.mass, rel=0.3)


def test_faults_come_as_often_as_they_should() -> None:
    link = SimulatedLink(LinkFaults(loss=0.2, corrupt=0.1, duplicate=0.1, latency_s=0.01), 0.002, 0)
    arrived = []
    for k in range(4000):
        link.send(0.002 * k, k, np.array([k, k], np.int64))
        arrived += [(0.002 * k, np.frombuffer(packet.content, np.int64)) for packet in link.arrived(0.002 * k)]
    assert link.lost / 4000 == pytest.approx(0.2, abs=0.03)
    assert link.corrupted / 3200 == pytest.approx(0.1, abs=0.03)
    whole = [(at, int(m[0])) for at, m in arrived if m[0] == m[1]]
    assert len(arrived) / (4000 - link.lost) == pytest.approx(1.1, abs=0.03)
    assert min(at - 0.002 * k for at, k in whole) == pytest.approx(0.01)
    assert [k for _, k in whole] == sorted(k for _, k in whole)


def test_reordering_swaps_neighbours() -> None:
    link = SimulatedLink(LinkFaults(reorder=0.3), 0.002, 1)
    order = []
    for k in range(200):
        link.send(0.002 * k, k, np.zeros(1))
        order += [packet.sequence for packet in link.arrived(0.002 * k)]
    steps = np.diff(order)
    assert len(set(order)) == len(order) >= 198
    assert (steps == -1).sum() > 20
    assert steps.max() <= 3


@pytest.mark.parametrize("wrong", [{"loss": 1.5}, {"corrupt": -0.1}, {"latency_s": float("nan")}])
def test_faults_are_shares_and_seconds(wrong: dict[str, float]) -> None:
    with pytest.raises(ConfigError, match=next(iter(wrong))):
        LinkFaults(**wrong)


def running(sim: SimServer) -> Iterator[None]:
    stop = threading.Event()
    thread = threading.Thread(target=sim.run, args=(stop, 120.0))
    thread.start()
    try:
        yield
    finally:
        stop.set()
        thread.join()


@pytest.fixture
def simulated(go2: Robot) -> Iterator[Callable[..., SimServer]]:
    """Starts robots that are one until the end of the test."""
    open_ones: list[tuple[SimServer, Iterator[None]]] = []

    def call(**settings: Any) -> SimServer:
        sim = SimServer(go2, SimSettings(domain=free_domain(), **settings), Recorder(GROUND_TRUTH, 1000))
        runner = running(sim)
        next(runner)
        open_ones.append((sim, runner))
        return sim

    yield call
    for sim, runner in open_ones:
        runner.close()
        sim.close()


@pytest.mark.slow
def test_the_driver_finds_its_service_has_it_lie_down_and_let_go(
    go2: Robot, simulated: Callable[..., SimServer]
) -> None:
    sim, said = simulated(start="standing"), []
    with Go2Driver(go2, domain=sim.settings.domain, say=said.append) as driver:
        assert not sim.body.service.active
        assert height(sim.body) < 0.5 * go2.home_height
        state = driver.read(5.0)
    assert state is not None
    assert len(said) == 2
    assert not sim.body.fell


def test_a_robot_that_does_not_lie_down_is_not_let_go_of(go2: Robot, simulated: Callable[..., SimServer]) -> None:
    sim = simulated(start="standing")
    del sim.services[messages.SPORT].handlers[messages.STAND_DOWN]
    with pytest.raises(DriverError, match=r"answered with code 3203 and it still stands"):
        Go2Driver(go2, domain=sim.settings.domain).open()
    assert sim.body.service.active


def test_commands_are_ignored_while_its_service_is_active(go2: Robot, simulated: Callable[..., SimServer]) -> None:
    sim = simulated(start="standing")
    with Go2Driver(go2, domain=sim.settings.domain, release=False) as driver:
        wait_for(lambda: driver.write(hold(go2)) or sim.counts.commands_ignored > 5)
    assert sim.counts.commands_received == 0
    assert sim.body.service.active


def test_a_service_answers_what_it_does_not_know_with_a_code(simulated: Callable[..., SimServer]) -> None:
    sim = simulated(start="standing")
    with contextlib.closing(Participant(sim.settings.domain)) as participant:
        client = messages.ServiceClient(participant, messages.SPORT)
        assert client.find(10.0)
        assert client.ask(4711).code == messages.NOT_IMPLEMENTED


def test_corrupted_states_are_rejected_and_lost_ones_counted(go2: Robot, simulated: Callable[..., SimServer]) -> None:
    sim = simulated(states=LinkFaults(corrupt=0.2, loss=0.2, duplicate=0.2, reorder=0.1))
    with Go2Driver(go2, domain=sim.settings.domain) as driver:
        wait_for(lambda: driver.read(0.01) is not None and driver.packets.received > 300)
        packets = driver.packets
    assert packets.rejected > 0.15 * packets.received
    assert packets.lost > 0.15 * packets.received


def test_corrupted_commands_are_rejected(go2: Robot, simulated: Callable[..., SimServer]) -> None:
    sim = simulated(commands=LinkFaults(corrupt=0.5))
    with Go2Driver(go2, domain=sim.settings.domain) as driver:
        wait_for(
            lambda: driver.write(hold(go2)) or min(sim.counts.commands_received, sim.counts.commands_rejected) > 10
        )


@pytest.mark.slow
def test_a_dead_robot_is_silent_and_limp(go2: Robot, simulated: Callable[..., SimServer]) -> None:
    sim = simulated(dead_after_s=2.0)
    with Go2Driver(go2, domain=sim.settings.domain) as driver:
        wait_for(lambda: driver.write(hold(go2)) or sim.body.time > 2.1)
        driver.read()
        assert driver.read(0.3) is None
        wait_for(lambda: driver.write(hold(go2)) or sim.body.damped)


def wait_for(done: Callable[[], Any], most_s: float = 30.0) -> None:
    end = time.monotonic() + most_s
    while not done():
        assert time.monotonic() < end
        time.sleep(0.001)


@pytest.fixture
def process(tmp_path: Path) -> Iterator[Callable[..., subprocess.Popen[str]]]:
    started: list[subprocess.Popen[str]] = []

    def call(*arguments: str) -> subprocess.Popen[str]:
        command = [sys.executable, "-m", "fastmimic", "robot-sim", "--json", *arguments]
        pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
        environment = os.environ | {"PYTHONUNBUFFERED": "1"}
        started.append(subprocess.Popen(command, text=True, cwd=tmp_path, env=environment, **pipes))
        return started[-1]

    yield call
    for process in started:
        if process.poll() is None:
            process.kill()
        process.communicate()


@pytest.mark.slow
def test_a_process_is_stood_up_over_the_wire_and_ends_at_ctrl_c(
    go2: Robot, process: Callable[..., subprocess.Popen[str]], tmp_path: Path
) -> None:
    domain = free_domain()
    robot = process("--domain", str(domain), "--log", "truth.mcap", "--watchdog-ms", "500")
    assert robot.stderr is not None
    assert any("Ctrl-C" in line for line in robot.stderr)  # after what is said while it prepares
    with Go2Driver(go2, domain=domain) as driver:
        state = driver.read(10.0)
        assert state is not None
        lying = state.reading["joint_pos"][0].copy()
        began, command = state.sequence, hold(go2)
        while (share := (state.sequence - began) / 1500) < 1.6:
            command["joint_pos"] = lying + min(share, 1.0) * (go2.home_joint_pos - lying)
            driver.write(command)
            state = driver.read(10.0)
            assert state is not None
        silent: StateMessage | None = state
        while silent is not None and silent.sequence < state.sequence + 700:  # milliseconds of the robot's own time
            silent = driver.read(10.0)
        assert silent is not None
    robot.send_signal(signal.SIGINT)
    out, err = robot.communicate(timeout=30)
    assert robot.returncode == 0, err
    assert "Traceback" not in err
    account = json.loads(out)
    assert account["commands_received"] > 100
    assert account["commands_rejected"] == 0
    assert account["damped"] >= 1
    assert not account["fell"]
    truth = load_ground_truth(tmp_path / "truth.mcap")
    at = int(np.searchsorted(truth["tick"], state.sequence))
    assert truth["tick"][at] == state.sequence
    assert truth["observation"]["root_pos"][at, 2] == pytest.approx(go2.home_height, abs=0.03)
    assert truth["observation"]["joint_pos"][at] == pytest.approx(state.reading["joint_pos"][0], abs=0.05)
    assert account["duration_s"] == pytest.approx(truth["time_s"][-1], abs=0.01)


@pytest.mark.slow
def test_a_process_that_is_killed_leaves_what_it_really_did(
    process: Callable[..., subprocess.Popen[str]], tmp_path: Path
) -> None:
    robot = process("--domain", str(free_domain()), "--log", "truth.mcap")
    assert robot.stderr is not None
    assert any("Ctrl-C" in line for line in robot.stderr)  # after what is said while it prepares
    time.sleep(1.2)
    robot.kill()
    robot.communicate()
    rows = load_ground_truth(tmp_path / "truth.mcap")
    assert rows["time_s"][-1] > 0.5
    np.testing.assert_array_equal(np.diff(rows["tick"]), rows["tick"][0])
    assert rows["observation"]["root_pos"][:, 2].max() < 0.2, "m: it lies"


def test_a_second_robot_in_the_domain_ends_with_one_line_and_the_first_goes_on(
    simulated: Callable[..., SimServer], capsys: pytest.CaptureFixture[str]
) -> None:
    sim = simulated()
    assert main(["robot-sim", "--domain", str(sim.settings.domain), "--duration", "30"]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert "another robot publishes states" in err.splitlines()[-1]
    at = sim.body.time
    wait_for(lambda: sim.body.time > at + 0.1)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--interface", "nowhere0"), "no network interface 'nowhere0'"),
        (("--start", "flying"), "start must be one of lying, standing, found flying"),
        (("--sensors", "none"), "--sensors takes real or ideal"),
        (("--robot", "a1"), "does not speak the protocol of a a1"),
        (("--loss", "1.2"), "loss must be in [0, 1], found 1.2"),
        (("--domain", "231"), "a number from 0 to 230"),
        (("--log", "truth.csv"), "must end in .mcap"),
        (("--dead-after", "-1"), "dead_after_s must not be negative, found -1"),
    ],
)
def test_what_cannot_be_is_one_line(
    arguments: tuple[str, ...], message: str, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    assert main(["robot-sim", *arguments]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert len(err.splitlines()) == 1
    assert message in err
