"""Velocities from another program, by UDP."""

import json
import math
import socket
import time
from typing import Any, Final

import numpy as np

from fastmimic.base.arrays import Array
from fastmimic.base.errors import ConfigError

LOST_S: Final = 0.5
"""Without a command for so long, the robot is to stand."""
_MOST_BYTES: Final = 2048


class CommandSocket:
    """Receives velocities on a UDP port of this machine: a JSON object for each, as ROS has them in
    `geometry_msgs/Twist`, `{"linear": {"x": 0.5, "y": 0}, "angular": {"z": 0.2}}`; what is left out is 0. Raises
    `ConfigError` if the port cannot be opened."""

    def __init__(self, port: int) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        try:
            self._socket.bind(("127.0.0.1", port))
        except (OSError, OverflowError) as error:
            self._socket.close()
            raise ConfigError(f"UDP port {port} cannot be opened: {error}") from None
        self.port = int(self._socket.getsockname()[1])
        self._last, self._at = np.zeros(3), -math.inf
        self.refused = 0
        """Messages that were no velocity."""

    def close(self) -> None:
        self._socket.close()

    def velocity(self) -> Array | None:
        """The newest velocity (3,), forwards, to the left, m/s, turning to the left, rad/s; zero, once, when none has
        come for `LOST_S`; None while none comes: others may steer."""
        while True:
            try:
                message = self._socket.recv(_MOST_BYTES)
            except (BlockingIOError, ConnectionError):
                break
            found = read_twist(message)
            if found is None:
                self.refused += 1
            else:
                self._last, self._at = found, time.monotonic()
        if self._at == -math.inf:
            return None
        if time.monotonic() - self._at > LOST_S:
            self._last, self._at = np.zeros(3), -math.inf
        return self._last


def read_twist(message: bytes) -> Array | None:
    """The velocity (3,) of a message; None if it is no such object or one of its numbers is none."""

    def number(part: str, axis: str) -> float:
        value: Any = found.get(part, {}).get(axis, 0.0)
        return float(value) if isinstance(value, int | float) and not isinstance(value, bool) else math.nan

    try:
        found = json.loads(message)
        velocity = np.array([number("linear", "x"), number("linear", "y"), number("angular", "z")])
    except (ValueError, AttributeError, RecursionError, OverflowError):
        return None
    return velocity if np.isfinite(velocity).all() else None
