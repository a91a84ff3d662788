"""Velocities from another program, by UDP, or from a file; and how well a steered robot follows them."""

import json
import math
import socket
import time
from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any, Final, Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from fastmimic.base.arrays import Array, Records
from fastmimic.base.errors import ConfigError
from fastmimic.base.rotations import rotate_planar, yaw_from_quat
from fastmimic.clips.formats.text_table import is_number

LOST_S: Final = 0.5
"""Without a command for so long, the robot is to stand."""
_MOST_BYTES: Final = 2048
_MOST_MESSAGES: Final = 20  # read at once
_HELD_S: Final = 0.5  # least duration of a command that is measured: a stick that moves gives many shorter ones
_MEAN_S: Final = 1.0  # at the end of a command, over which its velocity is measured
_STRIDE_S: Final = 0.5  # over which the velocity of a response is averaged
_REACHED: Final = 0.63  # share of a change, of which the time is the response
_CHANGE: Final = (0.5, 0.2, 1.0)  # least change whose response is measured, m/s, m/s, rad/s


class Commands(Protocol):
    """Where a steered robot's velocities come from, until `end_s`, or for ever."""

    end_s: float | None

    def velocity(self, time_s: float) -> Array | None:
        """That wanted (3,) since so many seconds after the start: forwards, to the left, m/s, turning to the left,
        rad/s. None if there is none: others may steer."""


class CommandScript:
    """Velocities from a text file: each line has a time, s, and from then on the velocity forwards and to the left,
    m/s, and turning to the left, rad/s, between commas; a line of names may come first. `end_s` is the last time.
    Raises `ConfigError` for any other file."""

    def __init__(self, path: Path) -> None:
        try:
            lines = path.read_text(encoding="utf-8").splitlines()
        except FileNotFoundError:
            raise ConfigError(f"{path}: no such file") from None
        except (OSError, ValueError) as error:
            raise ConfigError(f"{path} has no velocities: {error}") from None
        named = bool(lines) and not any(map(is_number, lines[0].split(",")))
        found = [_numbers(line, f"{path}, line {i}") for i, line in enumerate(lines[named:], 1 + named)]
        if not found:
            raise ConfigError(f"{path} has no velocities: no line of numbers")
        self._rows = rows = np.array(found)
        if rows[0, 0] < 0.0:
            raise ConfigError(f"{path}, line {1 + named}: its time is negative; times are from the start")
        if (early := np.flatnonzero(np.diff(rows[:, 0]) <= 0)).size:
            raise ConfigError(f"{path}, line {early[0] + 2 + named}: its time is not later than the one before")
        self.end_s: float | None = float(rows[-1, 0])

    def velocity(self, time_s: float) -> Array | None:
        row = int(np.searchsorted(self._rows[:, 0], time_s, side="right")) - 1
        return None if row < 0 else np.array(self._rows[row, 1:])


def _numbers(line: str, where: str) -> list[float]:
    """The time and velocity of a line of a `CommandScript`; raises `ConfigError`."""
    try:
        numbers = [float(cell) for cell in line.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) != 4 or not np.isfinite(numbers).all():
        columns = "four numbers between commas: time in s, forwards, to the left in m/s, turning to the left in rad/s"
        raise ConfigError(f"{where}: expected {columns}; found '{line[:40]}'")
    return numbers


class ReceivedCommands(ABC):
    """Velocities that another program sends."""

    end_s: float | None = None

    def __init__(self) -> None:
        self._last, self._at = np.zeros(3), -math.inf

    @abstractmethod
    def received(self) -> list[Array]:
        """The finite velocities (3,) that came since the last call, oldest first."""

    def velocity(self, time_s: float) -> Array | None:
        """The newest; zero, once, when none has come for `LOST_S`; None while none comes."""
        for found in self.received():
            self._last, self._at = found, time.monotonic()
        if self._at == -math.inf:
            return None
        if time.monotonic() - self._at > LOST_S:
            self._last, self._at = np.zeros(3), -math.inf
        return self._last


class CommandSocket(ReceivedCommands):
    """Receives velocities on a UDP port of this machine: a JSON object for each, as ROS has them in
    `geometry_msgs/Twist`, `{"linear": {"x": 0.5, "y": 0}, "angular": {"z": 0.2}}`; what is left out is 0. Raises
    `ConfigError` if the port cannot be opened."""

    def __init__(self, port: int) -> None:
        super().__init__()
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        try:
            self._socket.bind(("127.0.0.1", port))
        except (OSError, OverflowError) as error:
            self._socket.close()
            raise ConfigError(f"UDP port {port} cannot be opened: {error}") from None
        self.port = int(self._socket.getsockname()[1])

    def close(self) -> None:
        self._socket.close()

    def received(self) -> list[Array]:
        found = []
        for _ in range(_MOST_MESSAGES):
            try:
                message = self._socket.recv(_MOST_BYTES)
            except (BlockingIOError, ConnectionError):
                break
            if (velocity := read_twist(message)) is not None:
                found.append(velocity)
        return found


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


@dataclass
class CommandErrors:
    """Of each command that held half a second or longer, the errors of the mean velocity, m/s, and turn rate, rad/s,
    in its last second; and of greater changes the time until 63 % of it, s."""

    velocity: list[float] = field(default_factory=list)
    yaw_rate: list[float] = field(default_factory=list)
    response_s: list[float] = field(default_factory=list)

    def add(self, observation: Records, wanted: Array, dt: float, fell: NDArray[np.bool_] | None = None) -> None:
        """Adds a run: states (t,) of `OBSERVATION`, the velocity wanted (t, 3), heading frame, at steps of `dt`, s. A
        command in which the robot `fell` (t,) counts only there."""
        moved = rotate_planar(-yaw_from_quat(observation["root_quat"]), observation["lin_vel"][:, :2])
        velocity = np.column_stack([moved, observation["ang_vel"][:, 2]])
        smooth = uniform_filter1d(velocity, max(1, round(_STRIDE_S / dt)), axis=0, mode="nearest")
        changes = np.flatnonzero(np.diff(wanted, axis=0).any(axis=1)) + 1
        for first, last in pairwise([0, *changes, len(wanted)]):
            if (last - first) * dt < _HELD_S or (fell is not None and fell[first:last].any()):
                continue
            error = velocity[max(first, last - round(_MEAN_S / dt)) : last].mean(axis=0) - wanted[first]
            self.velocity.append(float(np.hypot(*error[:2])))
            self.yaw_rate.append(abs(float(error[2])))
            change = wanted[first] - smooth[first]
            for axis in np.flatnonzero(np.abs(change) > _CHANGE):
                reached = (smooth[first:last, axis] - smooth[first, axis]) / change[axis] >= _REACHED
                if reached.any():
                    self.response_s.append(float(np.argmax(reached)) * dt)

    def as_dict(self) -> dict[str, float | None]:
        """Medians, JSON-serialisable; None without values."""
        found = {"velocity_error_m_s": self.velocity, "yaw_rate_error_rad_s": self.yaw_rate}
        found["response_ms"] = [1e3 * s for s in self.response_s]
        return {name: float(np.median(values)) if values else None for name, values in found.items()}
