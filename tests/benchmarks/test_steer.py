"""A steered robot in simulation."""

import json
import socket
import time

import numpy as np
import pytest
from steer import Command, SteeringFigures, follow

from fastmimic.base.errors import ConfigError
from fastmimic.cli import main
from fastmimic.play.page import Pacer
from fastmimic.play.session import LiveSession
from fastmimic.simulation.conditions import Conditions
from fastmimic.steering.commands import CommandSocket
from fastmimic.steering.gait_field import GaitField

SCRIPT = [Command(0.0, (0.0, 0.0, 0.0)), Command(1.0, (0.6, 0.0, 0.0)), Command(4.0, (0.3, 0.15, 0.8))]


@pytest.mark.parametrize("observe", ["truth", "sensors"])
def test_a_robot_follows_a_script(gaits: GaitField, observe: str) -> None:
    session = LiveSession(gaits.robot, {}, gaits=gaits, conditions=Conditions(observe=observe))
    found = follow(session, SCRIPT, 7.0, SteeringFigures()).as_dict()
    assert found["falls"] == 0
    assert found["commands"] == 3
    assert found["commands_beyond_the_gaits"] == 0
    assert found["minutes"] == pytest.approx(7.0 / 60.0)
    assert found["velocity_error_m_s"] < 0.06
    assert found["yaw_rate_error_rad_s"] < 0.06
    assert 100 < found["response_ms"] < 900
    follow(session, [Command(0.0, (0.0, 0.0, 0.0))], 2.0, SteeringFigures())
    assert session.reference.state == "standing"


def test_a_robot_that_falls_gets_up_and_goes_on(gaits: GaitField) -> None:
    session = LiveSession(gaits.robot, {}, gaits=gaits)
    session.steer((0.5, 0.0, 0.0))
    session.run(1.0)
    session.fall()
    session.run(5.0)
    assert session.falls == 1
    assert not session.fallen
    before = float(session.observation["root_pos"][0])
    found = follow(session, [Command(0.0, (0.5, 0.0, 0.0))], 3.0, SteeringFigures())
    assert found.falls == 0
    assert float(session.observation["root_pos"][0]) > before + 0.5


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
