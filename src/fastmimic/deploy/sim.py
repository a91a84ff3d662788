"""A robot in this process: MuJoCo behind the drivers' interface, with sensors, a wire, and a watchdog of its own."""

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from fastmimic.base.errors import ConfigError
from fastmimic.deploy.driver import Packets, RobotDriver, StateMessage, damping_command
from fastmimic.deploy.loop_clock import LoopClock, VirtualClock
from fastmimic.deploy.simulated_link import LinkFaults, Receiver, SimulatedLink
from fastmimic.estimation.reading import READING
from fastmimic.reference.standing import rising_path, standing_gains
from fastmimic.robot import Robot
from fastmimic.robot.state import COMMAND, OBSERVATION
from fastmimic.simulation.conditions import Conditions, episode_generator
from fastmimic.simulation.disturbances import make_world
from fastmimic.simulation.sensors import Sensors
from fastmimic.simulation.simulators import make_simulation

STARTS: Final = ("lying", "standing")
WATCHDOG_S: Final = 0.02
"""Without a command for that long the motors only damp."""
_SENSORS: Final = 1  # number of the random stream, as in imitation/observer.py
_SETTLE_S: Final = 0.5
_MOST_BEHIND_S: Final = 0.25
_BLOCK: Final = 4096


class SimDriver(RobotDriver):
    """One simulated robot. Time passes in it when it is read from, up to the clock's present moment: with a
    `VirtualClock` in lock step with whoever reads, with a `RealClock` in real time.

    Attributes:
        packets: of the states, and of the commands sent.
        tick: control periods since it was opened; the sequence number of the newest state.
        damped: whether its watchdog has the motors damp.
    """

    def __init__(
        self,
        robot: Robot,
        clock: LoopClock | None = None,
        *,
        rate_hz: float = 500.0,
        conditions: Conditions | None = None,
        link: LinkFaults | None = None,
        start: str = "lying",
    ) -> None:
        """
        Args:
            robot: which.
            clock: a virtual one if None.
            rate_hz: of its states.
            conditions: its sensors, its world and the seed of both.
            link: faults of the wire to it and from it.
            start: one of `STARTS`.

        Raises:
            ConfigError: no such start, or conditions that the simulator does not realise.
        """
        if start not in STARTS:
            raise ConfigError(f"a simulated robot starts {' or '.join(STARTS)}, not '{start}'")
        self.robot = robot
        self._clock: LoopClock = clock if clock is not None else VirtualClock()
        self._conditions = conditions if conditions is not None else Conditions(observe="sensors")
        self._link = link if link is not None else LinkFaults()
        self._dt = 1.0 / rate_hz
        self._start = start
        self._simulation = make_simulation(robot, 1, self._conditions, control_rate_hz=rate_hz)
        gravity = make_world(self._conditions.disturbances, 1, self._conditions.simulator).gravity
        self._sensors = Sensors(robot, 1, rate_hz, self._conditions.sensors, gravity)
        self._damping = damping_command()
        self._idle = self._damping.copy()  # until there is a first command
        if start == "standing":
            self._idle["joint_pos"], self._idle["stiffness"] = robot.home_joint_pos, standing_gains(robot)[0]
        self._open = False
        self._reset()

    def _reset(self) -> None:
        self.packets = Packets()
        self.tick, self.damped = 0, False
        self._states, self._commands = SimulatedLink(self._link, self._dt, 0), SimulatedLink(self._link, self._dt, 1)
        self._from_robot = Receiver(READING, self.packets)
        self._at_robot = Receiver(COMMAND)
        self._command = self._idle.copy()
        self._commanded: float | None = None
        self._truth = np.zeros(_BLOCK, OBSERVATION)

    @property
    def truth(self) -> NDArray[Any]:
        """(tick + 1,) of `OBSERVATION`: the robot's true states, by the sequence number of the state message."""
        return self._truth[: self.tick + 1]

    def open(self) -> None:
        """Lays the robot down, or has it stand, and sends its first state."""
        self._reset()
        self._lay_down()
        generator = episode_generator(self._conditions.seed, 0, _SENSORS)
        reading = self._sensors.reset([generator], self._simulation.observation)
        self._truth[0] = self._simulation.observation[0]
        self._epoch = self._clock.now()
        self._states.send(self._epoch - self._link.latency_s, 0, reading)
        self._open = True

    def read(self, timeout_s: float = 0.0) -> StateMessage | None:
        """The newest state; `timeout_s` is time that the simulated robot gets to send one."""
        assert self._open
        end = self._clock.now() + timeout_s
        while True:
            now = self._clock.now()
            self._catch_up(now)
            newest = None
            for message in self._states.arrived(now):
                state = self._from_robot.take(message)
                newest = state if state is not None else newest
            if newest is not None or now >= end:
                return newest
            self._clock.sleep_until(min(now + self._dt, end))

    def write(self, command: NDArray[Any]) -> None:
        """Sends a command (1,) of `COMMAND`."""
        assert self._open
        self._commands.send(self._clock.now(), self.packets.sent, command)
        self.packets.sent += 1

    def close(self) -> None:
        """Ends it."""
        self._open = False

    def _catch_up(self, now: float) -> None:
        """Simulates the control periods up to now."""
        behind = now - self._epoch - self.tick * self._dt
        if behind > _MOST_BEHIND_S:  # nobody looked: the robot stood still meanwhile
            self._epoch += behind - self._dt
        while self._epoch + (self.tick + 1) * self._dt <= now + 1e-9:
            self._advance(self._epoch + self.tick * self._dt)

    def _advance(self, began: float) -> None:
        """One control period, with the commands that have arrived at its beginning."""
        for message in self._commands.arrived(began):
            taken = self._at_robot.take(message)
            if taken is not None:
                self._command, self._commanded = taken.reading, began
        self.damped = self._commanded is not None and began - self._commanded > WATCHDOG_S
        motors = self._sensors.to_motors(self._damping if self.damped else self._command)
        truth = self._simulation.step(motors)
        self.tick += 1
        if self.tick >= len(self._truth):
            self._truth = np.concatenate([self._truth, np.zeros(len(self._truth), OBSERVATION)])
        self._truth[self.tick] = truth[0]
        self._states.send(began + self._dt, self.tick, self._sensors.measure(truth, motors))

    def _lay_down(self) -> None:
        """On its belly with folded legs, or standing on the floor; at rest."""
        robot = self.robot
        path, height = rising_path(robot, robot.home_joint_pos)
        joints = path[0]
        if self._start == "standing":
            joints, height = robot.home_joint_pos, robot.home_height
        position, zero = np.array([[0.0, 0.0, height]]), np.zeros((1, 3))
        self._simulation.reset(position, np.array([[1.0, 0, 0, 0]]), joints[None], zero, zero, np.zeros((1, 12)))
        for _ in range(round(_SETTLE_S / self._dt)):
            self._simulation.step(self._idle)
