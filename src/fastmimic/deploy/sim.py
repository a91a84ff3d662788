"""A simulated robot in this process, behind the drivers' interface."""

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from fastmimic.deploy.computer import LoopClock, VirtualClock
from fastmimic.deploy.driver import Packets, RobotDriver, StateMessage
from fastmimic.deploy.simulated_robot import LinkFaults, Receiver, SimulatedBody, SimulatedLink
from fastmimic.robot import Robot
from fastmimic.robot.state import COMMAND, READING
from fastmimic.simulation.conditions import Conditions, episode_generator
from fastmimic.simulation.disturbances import make_world
from fastmimic.simulation.sensors import Sensors
from fastmimic.simulation.simulators import make_simulation

_SENSORS: Final = 1  # number of the random stream, as in the closed loop
_MOST_BEHIND_S: Final = 0.25


class SimDriver(RobotDriver):
    """One simulated robot, which advances to the clock's time when it is read: in lock step with a `VirtualClock`, in
    real time with a `LoopClock`. The steps of its `body` are the sequence numbers of the states."""

    def __init__(
        self,
        robot: Robot,
        clock: LoopClock | None = None,
        *,
        rate_hz: float = 500.0,
        conditions: Conditions | None = None,
        faults: LinkFaults | None = None,
        start: str = "lying",
    ) -> None:
        """`clock` is a virtual one if None; `rate_hz` that of the states; `conditions` the sensors, world and seed;
        `faults` those of the link in both directions; `start` "lying" or "standing". Raises `ConfigError` for another
        start, and for conditions that the simulator cannot realise."""
        super().__init__(robot)
        self._clock: LoopClock = clock if clock is not None else VirtualClock()
        self._conditions = chosen = conditions if conditions is not None else Conditions(observe="sensors")
        self._faults = faults if faults is not None else LinkFaults()
        self._dt = 1.0 / rate_hz
        simulation = make_simulation(robot, 1, chosen, control_rate_hz=rate_hz)
        gravity = make_world(chosen.disturbances, 1, chosen.simulator).gravity
        sensors = Sensors(robot, 1, rate_hz, chosen.sensors, gravity)
        self.body = SimulatedBody(robot, simulation, sensors, rate_hz, start)
        self._is_open = False
        self._truth: list[NDArray[Any]] = []

    @property
    def truth(self) -> NDArray[Any]:
        """(steps + 1,) of `OBSERVATION`: the true states, by the sequence number of the state message."""
        return np.concatenate(self._truth)

    def open(self) -> None:
        """Puts the robot at its start and sends its first state."""
        self.packets = Packets()
        self._states = SimulatedLink(self._faults, self._dt, 0)
        self._commands = SimulatedLink(self._faults, self._dt, 1)
        self._from_robot, self._at_robot = Receiver(READING, self.packets), Receiver(COMMAND)
        reading = self.body.reset(episode_generator(self._conditions.seed, 0, _SENSORS))
        self._truth = [self.body.observation.copy()]
        self._epoch = self._now()
        self._states.send(self._epoch - self._faults.latency_s, 0, reading)
        self._is_open = True

    def close(self) -> None:
        self._is_open = False

    def _now(self) -> float:
        return self._clock.now()

    def _wait(self, most_s: float) -> None:
        self._clock.sleep_until(self._now() + min(self._dt, most_s))

    def _send(self, command: NDArray[Any]) -> bool:
        self._commands.send(self._now(), self.packets.sent, command)
        return True

    def _newest(self) -> StateMessage | None:
        assert self._is_open
        now, newest = self._now(), None
        self._catch_up(now)
        for packet in self._states.arrived(now):
            newest = self._from_robot.take(packet) or newest
        return newest

    def _catch_up(self, now: float) -> None:
        """Simulates the control periods up to now."""
        behind = now - self._epoch - self.body.steps * self._dt
        if behind > _MOST_BEHIND_S:  # nothing read it meanwhile: it stood still
            self._epoch += behind - self._dt
        while self._epoch + (self.body.steps + 1) * self._dt <= now + 1e-9:
            self._advance(self._epoch + self.body.steps * self._dt)

    def _advance(self, began: float) -> None:
        """Simulates a control period with the commands that have arrived at its beginning."""
        for packet in self._commands.arrived(began):
            taken = self._at_robot.take(packet)
            if taken is not None:
                self.body.service.active = False
                self.body.obey(taken.reading)
        self.body.step()
        self._truth.append(self.body.observation.copy())
        self._states.send(began + self._dt, self.body.steps, self.body.measure())
