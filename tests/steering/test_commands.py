"""Velocities from other programs."""

import json
import socket
import time

import numpy as np
import pytest

from fastmimic.base.errors import ConfigError
from fastmimic.steering import commands
from fastmimic.steering.commands import CommandSocket, read_twist


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
        assert receiver.velocity() is None
        for message in ({"linear": {"x": 0.2}}, {"linear": {"x": 0.7}, "angular": {"z": -1.0}}):
            sender.sendto(json.dumps(message).encode(), ("127.0.0.1", receiver.port))
        sender.sendto(b"noise", ("127.0.0.1", receiver.port))
        until = time.monotonic() + 5.0
        while receiver.refused == 0 and time.monotonic() < until:
            found = receiver.velocity()
        assert receiver.refused == 1
        assert found is not None
        np.testing.assert_array_equal(found, [0.7, 0.0, -1.0])
        now = time.monotonic()
        monkeypatch.setattr(commands.time, "monotonic", lambda: now + commands.LOST_S + 0.01)
        silent = receiver.velocity()
        assert silent is not None
        assert not silent.any()
        assert receiver.velocity() is None  # others may steer
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
