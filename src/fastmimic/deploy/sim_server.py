"""A Go2's DDS interface to a simulated body, in real time."""

import dataclasses
import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from threading import Event
from typing import Any, Final

import numpy as np

from fastmimic.base.configuration import check, documented, parameter
from fastmimic.base.errors import ConfigError, DriverError
from fastmimic.base.rotations import roll_pitch_from_quat, yaw_from_quat
from fastmimic.deploy.dds.cyclone import LOOPBACK, Participant, Reader, Writer
from fastmimic.deploy.go2 import messages
from fastmimic.deploy.go2.messages import RATE_HZ, TICKS_PER_STATE, CommandWire, LowCommand, StateWire
from fastmimic.deploy.log import Recorder
from fastmimic.deploy.sim import STARTS, WATCHDOG_S, LinkFaults, SimulatedBody, SimulatedLink
from fastmimic.robot import Robot
from fastmimic.robot.state import COMMAND
from fastmimic.simulation.conditions import Conditions, Disturbance
from fastmimic.simulation.config import SensorConfig
from fastmimic.simulation.simulators import PHYSICS_RATE_HZ

MODE: Final = "normal"  # of the active motion service
MOST_BEHIND_S: Final = 0.05  # delay that is caught up; the real-time factor shows the rest
_PER_STATE: Final = round(PHYSICS_RATE_HZ / RATE_HZ)
_LINK_S: Final = 1.0 / RATE_HZ  # part of the sensors' assumed latency; here the real connection adds it
_LOOK_S: Final = 0.5  # for another robot
_SERVICE_PERIOD: Final = 20  # physics steps between two polls of the services


@documented
@dataclass(frozen=True, kw_only=True)
class SimSettings:
    """Settings of a simulated robot. `states` and `commands` are the faults of its link."""

    domain: int = parameter(0, low=None, about="DDS domain")
    interface: str = LOOPBACK
    start: str = parameter(STARTS[0], choices=STARTS, about="how it starts")
    sensors: SensorConfig | None = None
    seed: int = parameter(0, low=None, about="seed of the sensors' errors")
    disturbances: tuple[Disturbance, ...] = ()
    states: LinkFaults = field(default_factory=LinkFaults)
    commands: LinkFaults = field(default_factory=LinkFaults)
    watchdog_s: float = parameter(WATCHDOG_S, above=0.0, unit="s", about="after which motors without commands damp")
    dead_after_s: float = math.inf  # time of a simulated failure: silence and damping

    def __post_init__(self) -> None:
        check(self, "robot-sim: ")
        if not self.dead_after_s >= 0:
            raise ConfigError(f"robot-sim: dead_after_s must not be negative, found {self.dead_after_s:g}")


@dataclass
class SimCounts:
    """Messages, from the robot's side. Those lost or corrupted are so by faults of the link."""

    states_sent: int = 0
    states_lost: int = 0
    states_corrupted: int = 0
    commands_received: int = 0  # obeyed
    commands_rejected: int = 0  # with a wrong checksum, head or level, or not finite
    commands_ignored: int = 0  # received while the motion service was active
    commands_lost: int = 0
    damped: int = 0  # how often the motors began to damp because commands stopped


def go2_body(robot: Robot, settings: SimSettings) -> SimulatedBody:
    sensors = settings.sensors
    if sensors is None:
        usual = SensorConfig()
        names = ("imu_latency_s", "joint_latency_s", "foot_latency_s")
        sensors = dataclasses.replace(usual, **{name: getattr(usual, name) - _LINK_S for name in names})
    conditions = Conditions(observe="sensors", disturbances=settings.disturbances, sensors=sensors)
    body = SimulatedBody(robot, conditions, PHYSICS_RATE_HZ, settings.start, settings.watchdog_s)
    body.reset(np.random.default_rng(settings.seed))
    return body


class SimServer:
    """A simulated robot with a Go2's DDS interface. `realtime_factor` is simulated time per second, ≤ 1."""

    def __init__(self, robot: Robot, settings: SimSettings = SimSettings(), log: Recorder | None = None) -> None:
        """`log` takes the ground truth, rows of `fastmimic.deploy.log.GROUND_TRUTH`. Raises `DriverError` like
        `Participant`, and if there is another robot."""
        self.settings = settings
        self.counts, self.realtime_factor = SimCounts(), 1.0
        self._log = log
        self._participant = Participant(self.settings.domain, self.settings.interface)
        try:
            self.body = go2_body(robot, self.settings)
            _check_alone(self._participant)
            self._connect(self._participant)
        except BaseException:
            self.close()
            raise

    def _connect(self, participant: Participant) -> None:
        settings = self.settings
        self._reader = Reader(participant, messages.LOW_COMMAND_TOPIC, LowCommand, 16)
        self._writer = Writer(participant, messages.LOW_STATE_TOPIC, messages.LowState)
        self._state = StateWire(np.zeros(1, np.dtype(messages.LowState)))
        self._state.clear()
        self._out = SimulatedLink(settings.states, 1.0 / RATE_HZ, 0)
        self._in = SimulatedLink(settings.commands, 1.0 / RATE_HZ, 1)
        self._received = CommandWire(np.zeros(1, np.dtype(LowCommand)))
        self._command = np.zeros(1, COMMAND)
        self._tick = self._heard = 0
        self._was_damped = True
        self.body.sensors.to_motors(self._command)  # compiles it before it is needed in real time
        service = self.body.service
        handlers: dict[str, dict[int, Callable[[], Any]]] = {
            messages.MOTION_SWITCHER: {
                messages.CHECK_MODE: lambda: {"form": "0", "name": MODE if service.active else ""},
                messages.SELECT_MODE: lambda: service.take_over(self.body.observation["joint_pos"][0]),
                messages.RELEASE_MODE: lambda: setattr(service, "active", False),
            },
            messages.SPORT: {
                messages.STAND_UP: lambda: service.stand_up() if service.active else None,
                messages.STAND_DOWN: lambda: service.lie_down() if service.active else None,
            },
        }
        self.services = {name: messages.ServiceServer(participant, name, found) for name, found in handlers.items()}

    def run(self, stop: Event, duration_s: float = math.inf, report: Callable[[Any], None] = lambda sim: None) -> None:
        """Runs in real time until `stop` is set or for `duration_s` simulated; calls `report` every second."""
        dt = 1.0 / PHYSICS_RATE_HZ
        if self._log is not None:
            self._log.start()
        begin = due = time.perf_counter()
        next_report, reported = 1.0, (begin, self.body.time)
        while not stop.is_set() and self.body.time < duration_s - 0.5 * dt:
            now = time.perf_counter()
            if now < due:
                time.sleep(due - now)
                continue
            due = max(due + dt, now - MOST_BEHIND_S)
            self._receive()
            self.body.step()
            if self.body.steps % _PER_STATE == 0:
                self._publish()
            self._send()
            if self.body.time >= next_report:
                next_report += 1.0
                now = time.perf_counter()
                self.realtime_factor = min(1.0, (self.body.time - reported[1]) / max(now - reported[0], 1e-9))
                reported = now, self.body.time
                report(self)
        self.realtime_factor = min(1.0, self.body.time / max(time.perf_counter() - begin, 1e-9))

    def summary(self) -> dict[str, Any]:
        """The run's figures, JSON-serialisable."""
        truth = self.body.observation[0]
        quat = truth["root_quat"]
        return {
            "duration_s": round(self.body.time, 3),
            "realtime_factor": round(self.realtime_factor, 4),
            **dataclasses.asdict(self.counts),
            "damped_s": round(self.body.damped_s, 3),
            "motion_service": self.body.service.active,
            "fell": self.body.fell,
            "base_pos": [round(float(v), 4) for v in truth["root_pos"]],
            "base_rpy": [round(float(v), 4) for v in (*roll_pitch_from_quat(quat), yaw_from_quat(quat))],
        }

    def close(self) -> None:
        """Leaves the domain; may be called twice."""
        self._participant.close()

    @property
    def _dead(self) -> bool:
        return self.body.time >= self.settings.dead_after_s

    def _receive(self) -> None:
        now = self.body.time
        for i in range(self._reader.take()):
            if self._reader.valid[i]:
                self._heard += 1
                self._in.send(now, self._heard, self._reader.samples[i : i + 1])
        self.counts.commands_lost = self._in.lost
        for packet in self._in.arrived(now):
            self._received.record[...] = np.frombuffer(packet.content, self._received.record.dtype)
            if not self._dead:
                self._obey()
        if self.body.steps % _SERVICE_PERIOD == 0 and not self._dead:
            for server in self.services.values():
                server.poll()

    def _obey(self) -> None:
        """Obeys the command received if it is intact and the motion service is not active."""
        if not self._received.intact(0):
            self.counts.commands_rejected += 1
        elif self.body.service.active:
            self.counts.commands_ignored += 1
        else:
            self.counts.commands_received += 1
            self._received.read(0, self._command)
            self.body.obey(self._command)

    def _publish(self) -> None:
        body = self.body
        reading = body.measure()
        self._tick += TICKS_PER_STATE
        self.counts.damped += int(body.damped and not self._was_damped)
        self._was_damped = body.damped
        if self._log is not None:
            row = self._log.next_row()
            row["time_s"], row["tick"], row["observation"] = body.time, self._tick, body.observation[0]
            row["command"], row["damped"], row["service"] = body.command[0], body.damped, body.service.active
        if not self._dead:
            self._state.write(reading, self._tick)
            self._out.send(body.time, self._tick, self._state.record)

    def _send(self) -> None:
        """Publishes the states that have passed the link."""
        record = self._writer.record
        assert record is not None
        for packet in self._out.arrived(self.body.time):
            record[...] = np.frombuffer(packet.content, record.dtype)
            self.counts.states_sent += int(self._writer.write())
        self.counts.states_lost, self.counts.states_corrupted = self._out.lost, self._out.corrupted


def _check_alone(participant: Participant) -> None:
    """Raises `DriverError` if another robot publishes states in the domain."""
    end = time.monotonic() + _LOOK_S
    while time.monotonic() < end:
        if participant.publishers(messages.LOW_STATE_TOPIC):
            where = f"in DDS domain {participant.domain} on '{participant.interface}'"
            raise DriverError(f"another robot publishes states {where}: use another domain")
        time.sleep(0.02)
