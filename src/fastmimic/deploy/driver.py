"""A robot's low-level interface: read its sensors, write its motors' commands.

Drivers convert the vendor's units, order and signs to the project's (`fastmimic.base.conventions`).
"""

import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from typing import Any, Final, Self

import numpy as np

from fastmimic.base.arrays import Array, Records
from fastmimic.base.errors import ConfigError, DriverError
from fastmimic.robot import Robot
from fastmimic.robot.state import COMMAND

FIRST_STATE_S: Final = 3.0  # timeout of the first state
_POLL_S: Final = 0.0002
ENCODER_ERROR: Final = 0.3  # rad; tolerance beyond a joint's range

SIM: Final = "sim"
_GO2: Final = ("fastmimic.deploy.go2.driver", "Go2Driver", ("interface", "domain"))
WIRED: Final[dict[str, tuple[str, str, tuple[str, ...]]]] = {
    "go2": _GO2,
    "a1": ("fastmimic.deploy.a1_driver", "A1Driver", ()),
    "b2": _GO2,
    "a2": _GO2,
}  # by robot: module, class, and names of the driver's own options. A B2 and an A2 have the Go2's messages.
DRIVERS: Final = (*WIRED, SIM)


@dataclass(frozen=True, eq=False)
class StateMessage:
    """A copy of a state as it was received."""

    reading: Records  # (1,) of `READING`
    sequence: int  # the robot's own count of its messages
    received: float  # s on the driver's clock


@dataclass
class Packets:
    """Messages since the driver was opened."""

    sent: int = 0  # commands written
    received: int = 0  # states accepted
    lost: int = 0  # states missing between the sequence numbers received
    rejected: int = 0  # states with a wrong checksum, duplicates, out of order, or not finite
    foreign: int = 0  # commands to this robot that another program sent; known of drivers over DDS


class RobotDriver(ABC):
    """Base of all drivers; a context manager that opens and closes the connection."""

    def __init__(
        self,
        robot: Robot,
        *,
        release: bool = True,
        say: Callable[[str], None] = lambda text: None,
        timeout_s: float = FIRST_STATE_S,
    ) -> None:
        """`release`: whether opening may release the motors from the robot's own software; otherwise it only listens.
        `say` takes lines on progress while it opens; `timeout_s` is that of the first state."""
        self._robot, self._release, self._say, self._timeout_s = robot, release, say, timeout_s
        self.packets = Packets()
        self._sequence = -1  # of the last accepted state

    def open(self) -> None:
        """Connects and waits for the first state. Sends no command. Raises `DriverError` for whatever a user can
        correct: a missing extra, an unknown interface, another robot, no state within `timeout_s`."""
        self.packets, self._sequence = Packets(), -1
        try:
            self._connect()
        except BaseException:
            self.close()
            raise

    @abstractmethod
    def close(self) -> None:
        """Disconnects; sends nothing. May be called twice."""

    def read(self, timeout_s: float = 0.0) -> StateMessage | None:
        """The newest acceptable state since the last call, or None after `timeout_s`. See `Packets.rejected`."""
        end = self._now() + timeout_s
        while (state := self._newest()) is None and (left := end - self._now()) > 0:
            self._wait(left)
        return state

    def write(self, command: Records) -> None:
        """Sends (1,) of `fastmimic.robot.state.COMMAND` to the motors; raises `DriverError` if it is not finite."""
        if not np.isfinite(command.view(np.float64)).all():
            raise DriverError("a command that is not finite was not sent to the motors")
        if self._send(command):
            self.packets.sent += 1

    def _count(self, sequence: int, *, good: bool, step: int) -> bool:
        """Counts a state of this number; returns whether it is good and newer than the last one. Numbers grow by `step`
        from state to state; 0 if that is not known."""
        if not good or sequence <= self._sequence:
            self.packets.rejected += 1
            return False
        if step and self._sequence >= 0:
            self.packets.lost += max(0, (sequence - self._sequence) // step - 1)
        self._sequence = sequence
        self.packets.received += 1
        return True

    def _now(self) -> float:
        return time.perf_counter()

    @abstractmethod
    def _connect(self) -> None:
        """Opens the connection and waits for the first state, which does not count; raises `DriverError`."""

    @abstractmethod
    def _newest(self) -> StateMessage | None:
        """The newest acceptable state since the last call."""

    def _wait(self, most_s: float) -> None:
        """Waits for a state, up to `most_s`."""
        time.sleep(min(_POLL_S, most_s))

    @abstractmethod
    def _send(self, command: Records) -> bool:
        """Sends a finite command; returns whether it left."""

    def __enter__(self) -> Self:
        self.open()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def damping_command(damping: float = 2.2) -> Records:
    """(1,) of `COMMAND`: `damping` N·m·s/rad on every joint and nothing else: the robot sinks to the ground."""
    command = np.zeros(1, COMMAND)
    command["damping"] = damping
    return command


def implausible_joint(robot: Robot, joint_pos: Array) -> str:
    """A message if a joint, of (12,) rad, is outside the robot's range; empty if all are plausible."""
    off = np.maximum(robot.joint_lower - joint_pos, joint_pos - robot.joint_upper)
    j = int(np.argmax(off))
    if off[j] <= ENCODER_ERROR:
        return ""
    outside = f"outside the {robot.name}'s {robot.joint_lower[j]:.2f} … {robot.joint_upper[j]:.2f} rad"
    said = f"{robot.joint_names[j]} is at {joint_pos[j]:.2f} rad, {outside}"
    return f"{said}: another robot, or its joints are not calibrated"


def make_driver(driver: str, robot: Robot, **options: Any) -> RobotDriver:
    """A driver (one of `WIRED`) of a real robot, not yet open; `options` are those of `RobotDriver` and its own. Raises
    `ConfigError` for an unknown option, `DriverError` for a missing dependency."""
    module, name, own = WIRED[driver]
    unknown = next((option for option in options if option not in (*own, "release", "say", "timeout_s")), None)
    if unknown is not None:
        known = f"; it has {', '.join(f'--{option}' for option in own)}" if own else ""
        raise ConfigError(f"driver '{driver}' has no --{unknown}{known}")
    return getattr(import_module(module), name)(robot, **options)
