"""The driver of a Go2 over DDS, and of simulators of its interface: `fastmimic robot-sim`, unitree_mujoco."""

import time
from typing import Any, Final

import numpy as np

from fastmimic.base.arrays import Records
from fastmimic.base.errors import DriverError
from fastmimic.deploy.dds.cyclone import LOOPBACK, Participant, Reader, Writer
from fastmimic.deploy.driver import Packets, RobotDriver, StateMessage, implausible_joint
from fastmimic.deploy.go2 import messages
from fastmimic.robot import Robot
from fastmimic.robot.kinematics import foot_positions
from fastmimic.robot.state import READING

_EXAMINED: Final = 50  # states examined before the driver is open
_DEPTH: Final = 64  # states queued between two reads: 0.13 s
_LISTEN_S: Final = 0.3  # for another program's commands
_LYING: Final = 0.6  # share of the height in the home pose


class Go2Driver(RobotDriver):
    """A `RobotDriver`. With `release`, an active motion service lies the robot down and releases the motors. It rejects
    states with a wrong checksum, without an orientation, from a second publisher, not finite, or with a tick not above
    the last one. For simulators it ignores checksums if the first are 0 (unitree_mujoco in Python), and replaces ticks
    of 0 by a count. `packets.lost` follows from ticks of 1 ms and states at 500 Hz."""

    def __init__(self, robot: Robot, *, domain: int = 0, interface: str = LOOPBACK, **options: Any) -> None:
        """`domain` is 0 for robots; network `interface` is `lo` for a simulated one; `options` as for `RobotDriver`."""
        super().__init__(robot, **options)
        self._domain, self._interface = domain, interface
        self._where = f"in DDS domain {domain} on '{interface}'"
        self._participant: Participant | None = None

    def _connect(self) -> None:
        """Raises `DriverError` also for two robots in the domain or another commanding program."""
        participant = self._participant = Participant(self._domain, self._interface)
        self._reader = Reader(participant, messages.LOW_STATE_TOPIC, messages.LowState, _DEPTH)
        self._writer = Writer(participant, messages.LOW_COMMAND_TOPIC, messages.LowCommand)
        assert self._writer.record is not None
        self._others = Reader(participant, messages.LOW_COMMAND_TOPIC, messages.LowCommand, own=False)
        self._command = messages.CommandWire(self._writer.record)
        self._command.clear()
        self._state = messages.StateWire(self._reader.samples)
        self._checked = self._counted = True
        self._publisher = 0
        self._await_states(participant)
        if self._release:
            messages.release_motion_service(participant, self._lies, self._say)
            self._check_alone()
        self._reader.take()  # states of before are old
        self._heard_others()
        self._sequence, self.packets = -1, Packets()

    def close(self) -> None:
        if self._participant is not None:
            self._participant.close()
            self._participant = None

    def _newest(self) -> StateMessage | None:
        newest = None
        self.packets.foreign += self._heard_others()
        for i in range(self._reader.take()):
            if self._reader.valid[i]:
                reading = np.zeros(1, READING)
                if self._accept(i, self._state.read(i, reading)):
                    newest = reading
        return None if newest is None else StateMessage(newest, self._sequence, self._now())

    def _accept(self, i: int, state: messages.Received) -> bool:
        """Whether state i is good and new; counts it."""
        publisher, first = int(self._reader.publication[i]), self._sequence < 0
        intact = state.sound and (not self._checked or state.checksum == state.expected)
        tick, step = (state.tick, messages.TICKS_PER_STATE) if self._counted else (self._sequence + 1, 0)
        if not self._count(tick, good=intact and (first or publisher == self._publisher), step=step):
            return False
        self._publisher = publisher
        return True

    def _wait(self, most_s: float) -> None:
        self._reader.wait(most_s)

    def _send(self, command: Records) -> bool:
        self._command.write(command)
        return self._writer.write()

    def _await_states(self, participant: Participant) -> None:
        """Waits for the first states and checks their publisher."""
        end = time.monotonic() + self._timeout_s
        seen: list[messages.Received] = []
        reading, problem, publishers = np.zeros(1, READING), "", set()
        while len(seen) < _EXAMINED and time.monotonic() < end:
            self._reader.wait(min(0.1, max(0.0, end - time.monotonic())))
            for i in range(self._reader.take()):
                state = self._state.read(i, reading)
                if self._reader.valid[i] and state.sound:
                    publishers.add(int(self._reader.publication[i]))
                    problem = implausible_joint(self._robot, reading["joint_pos"][0])
                    seen += [] if problem else [state]
        if len(publishers) > 1:
            said = f"{len(publishers)} robots publish states {self._where}"
            raise DriverError(f"{said}: use another domain for one of them")
        if not seen:
            raise DriverError(problem or self._silence(participant))
        last = seen[-1]
        self._checked = any(state.checksum != 0 for state in seen)
        if self._checked and all(state.checksum != state.expected for state in seen):  # a single one may be damaged
            found = f"{last.checksum:#010x}, expected {last.expected:#010x}"
            said = f"the states in DDS domain {self._domain} have wrong checksums ({found})"
            raise DriverError(f"{said}: another kind of robot or another version of its messages")
        self._counted = any(state.tick != 0 for state in seen)

    def _check_alone(self) -> None:
        """Raises `DriverError` if another program commands the motors."""
        end = time.monotonic() + _LISTEN_S
        while (left := end - time.monotonic()) > 0:
            self._others.wait(left)
            if self._heard_others():
                said = f"another program sends commands to the motors of the robot {self._where}"
                raise DriverError(f"{said}: end it first")

    def _heard_others(self) -> int:
        """The number of commands of other programs since the last call."""
        return int(self._others.valid[: self._others.take()].sum())

    def _lies(self) -> bool:
        """Whether the legs are folded."""
        self._sequence = -1  # a state of any age will do
        state = self.read(self._timeout_s)
        if state is None:
            raise DriverError("the robot's states stopped")
        feet = foot_positions(self._robot, state.reading["joint_pos"])[0]
        height = self._robot.foot_radius - float(feet[:, 2].mean())
        return height < _LYING * self._robot.home_height

    def _silence(self, participant: Participant) -> str:
        others = set(participant.publishers(messages.LOW_STATE_TOPIC)) - {messages.LowState.typename}
        if others:
            found = f"its {messages.LOW_STATE_TOPIC} is {', '.join(sorted(others))}"
            return f"the robot {self._where} is not of the Go2's family: {found}, expected {messages.LowState.typename}"
        within = f"within {self._timeout_s:g} s"
        if self._reader.matched():
            return f"a robot is {self._where}, but no good state came {within}: is the network disturbed?"
        hint = "is the robot on, and are interface and domain right? ('fastmimic robot-sim' simulates one)"
        return f"no robot's state {within} {self._where}: {hint}"
