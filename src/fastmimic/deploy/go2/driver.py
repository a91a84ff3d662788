"""The driver of a Go2 over DDS, and of whatever speaks its wire: `fastmimic robot-sim`, unitree_mujoco."""

import time
from collections.abc import Callable
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from fastmimic.base.errors import DriverError
from fastmimic.deploy.dds import LOOPBACK, Participant, Reader, Writer
from fastmimic.deploy.driver import Packets, RobotDriver, StateMessage
from fastmimic.deploy.go2 import messages
from fastmimic.deploy.go2.messages import TICKS_PER_STATE, CommandWire, LowCommand, Received, StateWire
from fastmimic.deploy.go2.services import release_motion_service
from fastmimic.deploy.identity import impossible_joint
from fastmimic.estimation.reading import READING
from fastmimic.robot import Robot
from fastmimic.robot.kinematics import foot_positions

FIRST_STATE_S: Final = 3.0
"""Within which the first state has to come."""
_JUDGED: Final = 50  # states that are looked at before the driver is open
_DEPTH: Final = 64  # states that wait at most until they are read: 0.13 s
_LISTEN_S: Final = 0.3  # for somebody else's commands
_LYING: Final = 0.6  # share of the height in the home pose


class Go2Driver(RobotDriver):
    """A `RobotDriver`.

    States are rejected whose checksum is wrong, that are not finite or have no orientation, that are from another
    publisher than the first one, or whose tick is not above the last one's. Two kinds of publisher differ from a robot:
    one that never fills in a checksum (0 in the first states; unitree_mujoco in Python) is not held to it, and one that
    never counts ticks is counted for.

    Args:
        robot: which it is expected to be.
        domain: DDS domain; 0 for robots.
        interface: network interface to the robot; `lo` for a simulated one.
        release: let the robot's own motion service, if it has one that is active, lie it down and let go of the motors.
            Without, nothing is asked of it, and whatever it runs goes on: for reading only.
        say: is told what happens while it opens.

    Attributes:
        packets: see `Packets`. `lost` goes by ticks of 1 ms and states of 500 Hz.
        released: name of the motion service's mode that was released, or None.
    """

    def __init__(
        self,
        robot: Robot,
        *,
        domain: int = 0,
        interface: str = LOOPBACK,
        release: bool = True,
        say: Callable[[str], None] = lambda text: None,
    ) -> None:
        self._robot = robot
        self._domain, self._interface = domain, interface
        self._release, self._say = release, say
        self.packets = Packets()
        self.released: str | None = None
        self._participant: Participant | None = None

    def open(self) -> None:
        """Connects, has the motion service let go, and waits for the first states. Sends no command to the motors.

        Raises:
            DriverError: see `RobotDriver`; two robots in one domain; or somebody else who commands this one.
        """
        participant = Participant(self._domain, self._interface)
        self._participant = participant
        try:
            self._reader = Reader(participant, messages.LOW_STATE_TOPIC, messages.LowState, _DEPTH)
            self._writer = Writer(participant, messages.LOW_COMMAND_TOPIC, LowCommand)
            assert self._writer.record is not None
            self._command = CommandWire(self._writer.record)
            self._command.clear()
            self._state = StateWire(self._reader.samples)
            self._checked = self._counted = True
            self._sequence, self._writer_of_states = -1, 0
            self._await_states()
            if self._release:
                self.released = release_motion_service(participant, self._lies, self._say)
                self._check_alone(participant)
            self._reader.take()  # what arrived meanwhile is old
            self._sequence = -1
            self.packets = Packets()
        except BaseException:
            self.close()
            raise

    def read(self, timeout_s: float = 0.0) -> StateMessage | None:
        """See `RobotDriver`."""
        newest = self._newest(self._reader.take())
        if newest is None and timeout_s > 0:
            end = time.perf_counter() + timeout_s
            while newest is None and (left := end - time.perf_counter()) > 0:
                self._reader.wait(left)
                newest = self._newest(self._reader.take())
        return None if newest is None else StateMessage(newest, self._sequence, time.perf_counter())

    def write(self, command: NDArray[Any]) -> None:
        """See `RobotDriver`.

        Raises:
            DriverError: the command is not finite; nothing was sent.
        """
        if not np.isfinite(command.view(np.float64)).all():
            raise DriverError("a command that is not finite was not sent to the motors")
        self._command.write(command)
        if self._writer.write():
            self.packets.sent += 1

    def close(self) -> None:
        """See `RobotDriver`."""
        if self._participant is not None:
            self._participant.close()
            self._participant = None

    def _newest(self, taken: int) -> NDArray[Any] | None:
        """Counts what was taken; (1,) of `READING` of the newest state in it that is good."""
        newest, packets = None, self.packets
        for i in range(taken):
            if not self._reader.valid[i]:
                continue
            reading = np.zeros(1, READING)
            state = self._state.read(i, reading)
            if not state.sound or (self._checked and state.checksum != state.expected):
                packets.rejected += 1
                continue
            writer = int(self._reader.publication[i])
            if self._sequence < 0:
                self._writer_of_states = writer
            elif writer != self._writer_of_states:
                packets.rejected += 1
                continue
            tick = state.tick if self._counted else self._sequence + 1
            if tick <= self._sequence:
                packets.rejected += 1
                continue
            if self._counted and self._sequence >= 0:
                packets.lost += max(0, (tick - self._sequence) // TICKS_PER_STATE - 1)
            self._sequence = tick
            packets.received += 1
            newest = reading
        return newest

    def _await_states(self) -> None:
        """Waits for the first states, and judges by them who is there."""
        end = time.monotonic() + FIRST_STATE_S
        seen: list[Received] = []
        reading, outside, writers = np.zeros(1, READING), "", set()
        while time.monotonic() < end:
            self._reader.wait(min(0.1, max(0.0, end - time.monotonic())))
            for i in range(self._reader.take()):
                state = self._state.read(i, reading)
                if not self._reader.valid[i] or not state.sound:
                    continue
                writers.add(int(self._reader.publication[i]))
                outside = impossible_joint(self._robot, reading["joint_pos"][0])
                if not outside:
                    seen.append(state)
            if len(seen) >= _JUDGED:
                break
        if len(writers) > 1:
            raise DriverError(
                f"{len(writers)} robots publish states in DDS domain {self._domain} on '{self._interface}':"
                " take another domain for one of them"
            )
        if not seen:
            raise DriverError(outside or self._silence())
        last = seen[-1]
        self._checked = any(state.checksum != 0 for state in seen)
        if self._checked and all(state.checksum != state.expected for state in seen):  # one alone may be damaged
            raise DriverError(
                f"the states in DDS domain {self._domain} have wrong checksums ({last.checksum:#010x}, expected"
                f" {last.expected:#010x}): another kind of robot or another version of its messages"
            )
        self._counted = any(state.tick != 0 for state in seen)

    def _check_alone(self, participant: Participant) -> None:
        """Raises `DriverError` if somebody else commands the motors."""
        reader = Reader(participant, messages.LOW_COMMAND_TOPIC, LowCommand)
        end, heard = time.monotonic() + _LISTEN_S, False
        while not heard and (left := end - time.monotonic()) > 0:
            reader.wait(left)
            heard = bool(reader.valid[: reader.take()].any())
        reader.close()
        if heard:
            raise DriverError(
                f"somebody else sends commands to the motors of the robot in DDS domain {self._domain} on"
                f" '{self._interface}': end that first"
            )

    def _lies(self) -> bool:
        """Whether the legs are folded."""
        self._sequence = -1  # for this it does not matter how old a state is that comes next
        state = self.read(FIRST_STATE_S)
        if state is None:
            raise DriverError("the robot's states stopped")
        feet = foot_positions(self._robot, state.reading["joint_pos"])[0]
        height = self._robot.foot_radius - float(feet[:, 2].mean())
        return height < _LYING * self._robot.home_height

    def _silence(self) -> str:
        """Why no state came."""
        assert self._participant is not None
        where = f"in DDS domain {self._domain} on '{self._interface}'"
        others = set(self._participant.publishers(messages.LOW_STATE_TOPIC)) - {messages.LowState.typename}
        if others:
            return (
                f"the robot {where} is not of the Go2's family: its {messages.LOW_STATE_TOPIC} is"
                f" {', '.join(sorted(others))}, expected {messages.LowState.typename}"
            )
        if self._reader.matched():
            return f"a robot is {where}, but no good state came within {FIRST_STATE_S:g} s: is something in between?"
        return (
            f"no robot's state within {FIRST_STATE_S:g} s {where}: is it on, is this the interface that it is on, and"
            " the domain? ('fastmimic robot-sim' is a robot to rehearse with)"
        )
