"""A robot's low-level interface, the same for every robot: read its sensors, write its motors' commands.

Whatever a vendor counts, orders or signs otherwise is converted in that robot's driver and nowhere else: everything on
this side of it has the project's units, frames and order of joints (`fastmimic.base.conventions`).
"""

from dataclasses import dataclass
from types import TracebackType
from typing import Any, Protocol, Self

import numpy as np
from numpy.typing import NDArray

from fastmimic.robot.state import COMMAND


@dataclass(frozen=True, eq=False)
class StateMessage:
    """One state message.

    Attributes:
        reading: (1,) of `fastmimic.estimation.reading.READING`; a copy that nobody overwrites.
        sequence: the robot's own count of its messages; what is not above the last one's is old.
        received: when it arrived, s on the clock of `time.perf_counter`.
    """

    reading: NDArray[Any]
    sequence: int
    received: float


@dataclass
class Packets:
    """Messages since the driver was opened.

    Attributes:
        sent: commands written.
        received: states that were taken.
        lost: states missing between the sequence numbers of those that arrived.
        rejected: states that arrived and were not taken: a wrong checksum, duplicates, out of order, not finite.
    """

    sent: int = 0
    received: int = 0
    lost: int = 0
    rejected: int = 0


class RobotDriver(Protocol):
    """What the real-time loop needs of a robot. A driver derives from it, and is a context manager:
    leaving it closes it.

    Errors:
        `DriverError` from `open` for everything that a user can mend: a missing extra, an interface
        that does not exist, a robot of another type, no state within three seconds.
    """

    packets: Packets

    def open(self) -> None:
        """Connects, and waits for the first state. Sends no command."""

    def read(self, timeout_s: float = 0.0) -> StateMessage | None:
        """The newest state that arrived since the last call, waiting for one up to `timeout_s`; None if there is
        none. States that fail the checks of `Packets.rejected` are counted and never returned."""

    def write(self, command: NDArray[Any]) -> None:
        """Sends (1,) of `fastmimic.robot.state.COMMAND` to the motors."""

    def close(self) -> None:
        """Disconnects; sends nothing. Closing twice is allowed."""

    def __enter__(self) -> Self:
        self.open()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def damping_command(damping: float = 3.0) -> NDArray[Any]:
    """(1,) of `COMMAND`: no torque, no stiffness, `damping` N·m·s/rad on every joint: the robot sinks to the ground."""
    command = np.zeros(1, COMMAND)
    command["damping"] = damping
    return command
