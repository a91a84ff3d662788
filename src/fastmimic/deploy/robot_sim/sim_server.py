"""The simulated robot's computer: real time, its wire, and its account of what happened."""

import math
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from types import TracebackType
from typing import Any, Final, Self

import numpy as np

from fastmimic.base.errors import ConfigError, DriverError
from fastmimic.deploy.dds import LOOPBACK, Participant, Reader, Writer
from fastmimic.deploy.go2 import messages, services
from fastmimic.deploy.go2.messages import TICKS_PER_STATE, CommandWire, LowCommand, StateWire, roll_pitch_yaw
from fastmimic.deploy.robot_sim.faults import Faults, FaultyLine
from fastmimic.deploy.robot_sim.ground_truth import GroundTruthLog
from fastmimic.deploy.robot_sim.simulated_body import COMMAND_TIMEOUT_S, MODE, PHYSICS_RATE_HZ, SimulatedBody, Start
from fastmimic.robot import Robot
from fastmimic.robot.state import COMMAND
from fastmimic.simulation.sensors import SensorConfig

MOST_BEHIND_S: Final = 0.05
"""What it still catches up with on a busy machine; the rest is lost, and the real-time factor says so."""
_LOOK_S: Final = 0.5  # for another robot
_SERVICE_PERIOD: Final = 20  # physics steps between two looks at requests to the services


@dataclass(frozen=True, kw_only=True)
class SimSettings:
    """Of a simulated robot on the wire.

    Attributes:
        domain, interface: of DDS.
        start: how it begins.
        sensors: what it measures with; None for `robot_sensors`.
        seed: of the sensors' errors and of the faults.
        states, commands: faults on the way out and in.
        command_timeout_s: after which motors without commands damp.
        dead_after_s: when it falls silent for good and its motors damp, as if its computer had died.
    """

    domain: int = 0
    interface: str = LOOPBACK
    start: Start = Start.LYING
    sensors: SensorConfig | None = None
    seed: int = 0
    states: Faults = field(default_factory=Faults)
    commands: Faults = field(default_factory=Faults)
    command_timeout_s: float = COMMAND_TIMEOUT_S
    dead_after_s: float = math.inf

    def __post_init__(self) -> None:
        if not (math.isfinite(self.command_timeout_s) and self.command_timeout_s > 0):
            raise ConfigError(f"commands must be able to be on time: found {self.command_timeout_s:g} s for them")
        if not self.dead_after_s >= 0:
            raise ConfigError(f"a robot dies after some seconds, not after {self.dead_after_s:g}")


@dataclass
class SimCounts:
    """Messages, from the robot's side.

    Attributes:
        states_sent: that went onto the wire.
        states_lost: that a fault kept off it.
        commands_received: that were obeyed.
        commands_rejected: that were not: a wrong checksum, head or level, or not finite.
        commands_ignored: that came while the motion service had the motors.
        damped: how often the motors began to damp because commands stopped.
    """

    states_sent: int = 0
    states_lost: int = 0
    commands_received: int = 0
    commands_rejected: int = 0
    commands_ignored: int = 0
    damped: int = 0


class SimServer:
    """A robot on the Go2's wire. A context manager.

    Args:
        robot: whose body.
        settings: see `SimSettings`.
        log: where the truth goes; None for nowhere.

    Attributes:
        body: it.
        counts: see `SimCounts`.
        realtime_factor: simulated time for each second since it began, in (0, 1]; 1 if the machine keeps up.

    Raises:
        DriverError: see `Participant`; or somebody else publishes states in the domain.
    """

    def __init__(self, robot: Robot, settings: SimSettings | None = None, log: GroundTruthLog | None = None) -> None:
        self.settings = settings = settings if settings is not None else SimSettings()
        self.counts = SimCounts()
        self.realtime_factor = 1.0
        self._log = log
        self._participant = participant = Participant(settings.domain, settings.interface)
        try:
            self.body = SimulatedBody(
                robot, settings.start, settings.sensors, settings.seed, settings.command_timeout_s
            )
            _check_alone(participant)
            self._connect(participant)
        except BaseException:
            participant.close()
            raise

    def _connect(self, participant: Participant) -> None:
        """Everything that is said and heard."""
        settings = self.settings
        self._reader = Reader(participant, messages.LOW_COMMAND_TOPIC, LowCommand, 16)
        self._writer = Writer(participant, messages.LOW_STATE_TOPIC, messages.LowState)
        self._state = np.zeros(1, np.dtype(messages.LowState))
        self._wire = StateWire(self._state)
        self._wire.clear()
        rng = np.random.default_rng([settings.seed, 1])
        self._out, self._in = FaultyLine(settings.states, rng), FaultyLine(settings.commands, rng)
        self._received = np.zeros(1, np.dtype(LowCommand))
        self._received_wire = CommandWire(self._received)
        self._command = np.zeros(1, COMMAND)
        self._tick = 0
        self._was_damped = True
        # what is compiled at its first use is so before anybody waits for it
        self._wire.write(self.body.reading, 0)
        self._received_wire.intact(0)
        self.body.sensors.to_motors(self._command)
        self._servers = self._serve(participant)

    def _serve(self, participant: Participant) -> tuple[services.ServiceServer, ...]:
        """The services of its own software."""
        return (
            services.ServiceServer(
                participant,
                services.MOTION_SWITCHER,
                {
                    services.CHECK_MODE: lambda _: {"form": "0", "name": MODE if self.body.service.active else ""},
                    services.SELECT_MODE: lambda _: self._select(),
                    services.RELEASE_MODE: lambda _: self._release(),
                },
            ),
            services.ServiceServer(
                participant,
                services.SPORT,
                {
                    services.STAND_UP: lambda _: self._moved(self.body.service.stand_up),
                    services.STAND_DOWN: lambda _: self._moved(self.body.service.lie_down),
                },
            ),
        )

    def run(
        self,
        stop: threading.Event,
        duration_s: float = math.inf,
        report: Callable[["SimServer"], None] = lambda sim: None,
        every_s: float = 1.0,
    ) -> None:
        """Is a robot, in real time, until `stop` is set or so many s of its own time have passed.

        Args:
            stop: ends it.
            duration_s: s.
            report: called each `every_s` of its own time.
            every_s: s.
        """
        dt = 1.0 / PHYSICS_RATE_HZ
        begin = due = time.perf_counter()
        next_report, reported = every_s, (begin, self.body.time)
        while not stop.is_set() and self.body.time < duration_s - 0.5 * dt:
            now = time.perf_counter()
            if now < due:
                time.sleep(due - now)
                continue
            due = max(due + dt, now - MOST_BEHIND_S)
            self._receive()
            if self.body.step():
                self._measured()
            self._send()
            if self.body.time >= next_report:
                next_report += every_s
                now = time.perf_counter()
                self.realtime_factor = min(1.0, (self.body.time - reported[1]) / max(now - reported[0], 1e-9))
                reported = now, self.body.time
                report(self)
        self.realtime_factor = min(1.0, self.body.time / max(time.perf_counter() - begin, 1e-9))

    def summary(self) -> dict[str, Any]:
        """What happened, in numbers and words that JSON knows."""
        truth, counts = self.body.observation[0], self.counts
        return {
            "duration_s": round(self.body.time, 3),
            "realtime_factor": round(self.realtime_factor, 4),
            "states_sent": counts.states_sent,
            "states_lost": counts.states_lost,
            "states_corrupted": self._out.corrupted,
            "commands_received": counts.commands_received,
            "commands_rejected": counts.commands_rejected,
            "commands_ignored": counts.commands_ignored,
            "commands_lost": self._in.lost,
            "damped": counts.damped,
            "damped_s": round(self.body.damped_s, 3),
            "motion_service": self.body.service.active,
            "fell": self.body.fell,
            "base_pos": [round(float(v), 4) for v in truth["root_pos"]],
            "base_rpy": [round(float(v), 4) for v in roll_pitch_yaw(truth["root_quat"])],
        }

    def close(self) -> None:
        """Leaves the wire; closing twice is allowed."""
        self._participant.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    @property
    def _dead(self) -> bool:
        return self.body.time >= self.settings.dead_after_s

    def _receive(self) -> None:
        now = self.body.time
        for i in range(self._reader.take()):
            if self._reader.valid[i]:
                self._in.push(self._reader.samples[i : i + 1], now)
        for message in self._in.pop(now):
            self._received[...] = message
            if self._dead:
                continue
            if not self._received_wire.intact(0):
                self.counts.commands_rejected += 1
            elif self.body.service.active:
                self.counts.commands_ignored += 1
            else:
                self.counts.commands_received += 1
                self._received_wire.read(0, self._command)
                self.body.obey(self._command)
        if round(now * PHYSICS_RATE_HZ) % _SERVICE_PERIOD == 0 and not self._dead:
            for server in self._servers:
                server.poll()

    def _measured(self) -> None:
        body = self.body
        self._tick += TICKS_PER_STATE
        if body.damped and not self._was_damped:
            self.counts.damped += 1
        self._was_damped = body.damped
        if self._log is not None:
            self._log.add(body.time, self._tick, body.observation, body.command, body.damped, body.service.active)
        if not self._dead:
            self._wire.write(body.reading, self._tick)
            self._out.push(self._state, body.time)

    def _send(self) -> None:
        record = self._writer.record
        assert record is not None
        for message in self._out.pop(self.body.time):
            record[...] = message
            if self._writer.write():
                self.counts.states_sent += 1
        self.counts.states_lost = self._out.lost

    def _release(self) -> dict[str, Any]:
        self.body.service.active = False
        return {}

    def _select(self) -> dict[str, Any]:
        self.body.service.take_over(self.body.observation["joint_pos"][0])
        return {}

    def _moved(self, move: Callable[[], None]) -> dict[str, Any]:
        if self.body.service.active:
            move()
        return {}


def _check_alone(participant: Participant) -> None:
    """Waits until whoever is in the domain can have been found; raises `DriverError` if there is a robot in it."""
    end = time.monotonic() + _LOOK_S
    while time.monotonic() < end:
        if participant.publishers(messages.LOW_STATE_TOPIC):
            raise DriverError(
                f"another robot publishes states in DDS domain {participant.domain} on '{participant.interface}':"
                " take another domain"
            )
        time.sleep(0.02)
