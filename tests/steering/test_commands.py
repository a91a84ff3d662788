"""Velocities from other programs."""

import json
import socket
import time

import numpy as np
import pytest

from fastmimic.base.errors import ConfigError
from fastmimic.steering import commands
from fastmimic.steering.commands import CommandScript, CommandSocket, read_twist


@pytest.mark.parametrize(
    ("message", "velocity"),
    [
        ('{"linear": {"x": 0.5, "y": -0.1, "z": 9}, "angular": {"z": 1}}', (0.5, -0.1, 1.0)),
        ('{"linear": {"x": 0.5}}', (0.5, 0.0, 0.0)),
        ("{}", (0.0, 0.0, 0.0)),
        ("[1, 2]", None),
        ("0.5", None),
        ('{"linear": 3}', None),
        ('{"linear": {"x": "fast"}}', None),
        ('{"linear": {"x": true}}', None),
        ('{"linear": {"x": NaN}}', None),
        ('{"linear": {"x": 1e999}}', None),
        ("not json", None),
        ("[" * 2000, None),
    ],
)
def test_a_twist_is_read(message: str, velocity: tuple[float, ...] | None) -> None:
    found = read_twist(message.encode())
    assert found is None if velocity is None else tuple(found) == velocity  # type: ignore[arg-type]


def test_the_newest_message_counts_and_silence_stops(monkeypatch: pytest.MonkeyPatch) -> None:
    receiver = CommandSocket(0)
    sender = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        assert receiver.velocity(0.0) is None
        newest = json.dumps({"linear": {"x": 0.7}, "angular": {"z": -1.0}}).encode()
        for message in (json.dumps({"linear": {"x": 0.2}}).encode(), b"noise", newest, b"noise"):
            sender.sendto(message, ("127.0.0.1", receiver.port))
        found, until = None, time.monotonic() + 5.0
        while (found is None or found[0] != 0.7) and time.monotonic() < until:
            found = receiver.velocity(0.0)
        found = receiver.velocity(0.0)
        assert found is not None
        np.testing.assert_array_equal(found, [0.7, 0.0, -1.0])
        now = time.monotonic()
        monkeypatch.setattr(commands.time, "monotonic", lambda: now + commands.LOST_S + 0.01)
        silent = receiver.velocity(0.0)
        assert silent is not None
        assert not silent.any()
        assert receiver.velocity(0.0) is None  # others may steer
    finally:
        sender.close()
        receiver.close()


def test_a_port_that_is_taken_or_none() -> None:
    first = CommandSocket(0)
    try:
        with pytest.raises(ConfigError, match=f"UDP port {first.port} cannot be opened"):
            CommandSocket(first.port)
    finally:
        first.close()
    with pytest.raises(ConfigError, match="UDP port 70000 cannot be opened"):
        CommandSocket(70000)


def test_a_script_has_a_velocity_from_each_time_on(tmp_path) -> None:
    path = tmp_path / "commands.csv"
    path.write_text("time_s,forwards,left,turn\n0.5, 0.4, 0, -1\n2, 0, 0.1, 0\n")
    script = CommandScript(path)
    assert script.end_s == 2.0
    assert script.velocity(0.49) is None
    np.testing.assert_array_equal(script.velocity(0.5), [0.4, 0.0, -1.0])  # type: ignore[arg-type]
    np.testing.assert_array_equal(script.velocity(1.99), [0.4, 0.0, -1.0])  # type: ignore[arg-type]
    np.testing.assert_array_equal(script.velocity(9.0), [0.0, 0.1, 0.0])  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", r" has no velocities: no line of numbers"),
        ("time_s,forwards\n", r" has no velocities: no line of numbers"),
        ("0,1,2\n", r", line 1: expected four numbers between commas: time in s, .*; found '0,1,2'"),
        ("time_s,forwards\n0,abc\n", r", line 2: expected four .*forwards, to the left .*turning.*; found '0,abc'"),
        ("0,0,0,0\n1,1,2,x\n", r", line 2: .*; found '1,1,2,x'"),
        ("0,nan,0,0\n1,1,2,0\n", r", line 1: .*; found '0,nan,0,0'"),
        ("0,0,0,0\n1,1,2,nan\n", r", line 2: .*; found '1,1,2,nan'"),
        ("time_s\n-1,0,0,0\n0,1,0,0\n", r", line 2: its time is negative"),
        ("time_s\n0,0,0,0\n0,1,0,0\n", r", line 3: its time is not later than the one before"),
        ("0,1,2,3\n1,2\n", r", line 2: .*; found '1,2'"),
    ],
)
def test_a_file_without_velocities_is_refused(text: str, words: str, tmp_path) -> None:
    path = tmp_path / "commands.csv"
    path.write_text(text)
    with pytest.raises(ConfigError, match=r"commands\.csv" + words):
        CommandScript(path)


def test_a_file_that_is_no_text_is_refused(tmp_path) -> None:
    path = tmp_path / "commands.csv"
    path.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ConfigError, match="has no velocities"):
        CommandScript(path)
    with pytest.raises(ConfigError, match=r"nothing\.csv: no such file"):
        CommandScript(tmp_path / "nothing.csv")
