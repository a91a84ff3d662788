"""A steered robot in simulation."""

import json
import socket
import time
from pathlib import Path

import numpy as np
import pytest

from fastmimic.base.errors import ConfigError
from fastmimic.cli import main
from fastmimic.play.follow import SteeringFigures, follow
from fastmimic.play.page import Pacer
from fastmimic.play.session import LiveSession
from fastmimic.simulation.conditions import Conditions
from fastmimic.steering.commands import CommandSocket
from fastmimic.steering.gait_field import GaitField

SCRIPT = ((0.0, (0.0, 0.0, 0.0)), (1.0, (0.6, 0.0, 0.0)), (4.0, (0.3, 0.1, 0.4)))


def script(time_s: float) -> np.ndarray:
    return np.array([velocity for at, velocity in SCRIPT if at <= time_s][-1])


@pytest.mark.slow
@pytest.mark.parametrize("observe", ["truth", "sensors"])
def test_a_robot_follows_a_script(gaits: GaitField, observe: str) -> None:
    session = LiveSession(gaits.robot, {}, gaits=gaits, conditions=Conditions(observe=observe))
    found = follow(session, script, 7.0, SteeringFigures()).as_dict()
    assert found["falls"] == 0
    assert found["commands"] == 3
    assert found["commands_beyond_the_gaits"] == 0
    assert found["minutes"] == pytest.approx(7.0 / 60.0)
    assert found["velocity_error_m_s"] < 0.06
    assert found["yaw_rate_error_rad_s"] < 0.06
    assert 100 < found["response_ms"] < 900
    assert set(found["share_of_time"]) == {"standing", "walk", "trot"}
    assert sum(found["share_of_time"].values()) == pytest.approx(1.0)
    assert 1.5 < found["way_m"] < 3.0
    follow(session, lambda time_s: np.zeros(3), 2.0, SteeringFigures())
    assert session.reference.state == "standing"


@pytest.mark.slow
def test_a_robot_that_falls_gets_up_and_goes_on(gaits: GaitField) -> None:
    session = LiveSession(gaits.robot, {}, gaits=gaits)
    session.steer((0.5, 0.0, 0.0))
    session.run(1.0)
    session.fall()
    session.run(5.0)
    assert session.falls == 1
    assert not session.fallen
    before = float(session.observation["root_pos"][0])
    found = follow(session, lambda time_s: np.array([0.5, 0.0, 0.0]), 3.0, SteeringFigures())
    assert found.falls == 0
    assert float(session.observation["root_pos"][0]) > before + 0.5


@pytest.mark.slow
def test_what_no_steered_robot_does(gaits: GaitField) -> None:
    session = LiveSession(gaits.robot, {}, gaits=gaits)
    assert session.steered
    with pytest.raises(ConfigError, match="plays no motions"):
        session.switch("trot")
    with pytest.raises(ConfigError, match="no gaits to steer with"):
        LiveSession(gaits.robot, {}).steer((0.1, 0.0, 0.0))


def test_another_program_steers_and_its_silence_stops(gaits: GaitField) -> None:
    session, commands = LiveSession(gaits.robot, {}, gaits=gaits), CommandSocket(0)
    sender = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        pacer = Pacer(session, commands)
        pacer.advance(0.01)
        assert not session.reference.place["wanted"].any()
        sender.sendto(json.dumps({"linear": {"x": 0.5}}).encode(), ("127.0.0.1", commands.port))
        until = time.monotonic() + 5.0
        while not session.reference.place["wanted"].any() and time.monotonic() < until:
            pacer.advance(0.01)
        np.testing.assert_allclose(session.reference.place["wanted"][0], [0.5, 0.0, 0.0])
        while session.reference.place["wanted"].any() and time.monotonic() < until:
            pacer.advance(0.01)
        assert not session.reference.place["wanted"].any()
    finally:
        sender.close()
        commands.close()


def test_only_a_steered_robot_listens(capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("viser", reason="the extra 'view' is not installed")
    assert main(["play", "trot", "--udp", "9870"]) == 2
    assert "--udp steers a robot; give 'steer'" in capsys.readouterr().err


@pytest.mark.slow
def test_evaluate_steers_by_a_script(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, gaits: GaitField, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("fastmimic.steering.gait_field.gait_field", lambda *_, **__: gaits)
    path = tmp_path / "way.csv"
    path.write_text("0.2,0.5,0,0\n2.2,0,0,0\n3,0,0,0\n")
    assert main(["evaluate", "steer", "--commands", str(path), "--observe", "sensors", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert (found["falls"], found["commands"]) == (0, 2)
    assert found["minutes"] == pytest.approx(3.0 / 60.0)
    assert 0.5 < found["way_m"] < 1.5
    assert main(["evaluate", "steer", "--commands", str(path), "--duration", "1"]) == 0
    assert "steered for 1 s" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--udp", "9870"], "takes velocities from --commands FILE.csv"),
        (["--topic", "cmd_vel"], "takes velocities from --commands FILE.csv"),
        ([], "give one of them"),
        (["--commands", "way.csv", "--episodes", "3"], "--episodes is for a motion"),
        (["--commands", "way.csv", "--simulator", "pybullet"], "steered in mujoco only, not in pybullet"),
        (["--commands", "nowhere.csv"], "nowhere.csv: no such file"),
    ],
)
def test_what_evaluate_cannot_steer_by(arguments: list[str], said: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["evaluate", "steer", *arguments]) == 2
    assert said in capsys.readouterr().err


@pytest.mark.parametrize(
    ("lines", "duration", "said"),
    [
        ("0,0.3,0,0\n", [], "no control step in 0 s"),
        ("-1,0.3,0,0\n", [], "line 1: its time is negative"),
        ("0,0.3,0,0\n2,0,0,0\n", ["--duration", "0.0005"], "no control step in 0.0005 s"),
    ],
)
def test_a_time_without_a_control_step_is_said_before_the_gaits_are_made(
    lines: str,
    duration: list[str],
    said: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("fastmimic.steering.gait_field.gait_field", lambda *_, **__: pytest.fail("gaits are made"))
    (tmp_path / "short.csv").write_text(lines)
    assert main(["evaluate", "steer", "--commands", str(tmp_path / "short.csv"), *duration]) == 2
    lines_said = capsys.readouterr().err.splitlines()
    assert len(lines_said) == 1
    assert said in lines_said[0]
