"""A simulated robot: its body with sensors, motors, watchdog and motion service, its network link, and its driver."""

import heapq
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

import numpy as np

from fastmimic.base.arrays import Array, Indices, Records
from fastmimic.base.configuration import check, documented, parameter
from fastmimic.base.errors import ConfigError
from fastmimic.deploy.computer import LoopClock, VirtualClock
from fastmimic.deploy.driver import RobotDriver, StateMessage, damping_command
from fastmimic.reference.standing import rising_path, smooth, standing_gains
from fastmimic.robot import Robot
from fastmimic.robot.state import COMMAND, OBSERVATION, READING
from fastmimic.simulation.conditions import Conditions, episode_generator, make_world
from fastmimic.simulation.sensors import Sensors
from fastmimic.simulation.simulators import make_simulation

STARTS: Final = ("lying", "standing")
_RATE_HZ: Final = 500.0  # of the states
WATCHDOG_S: Final = 0.02  # without a command for longer, the motors only damp
_SETTLE_S: Final = 0.5
_MOVE_S: Final = 1.5  # for standing up or lying down
TIPPED: Final = 0.5  # cosine of the tilt beyond which it has fallen
_SENSORS: Final = 1  # number of the random stream, as in the closed loop
_MOST_BEHIND_S: Final = 0.25
_IMPACT: Final = 0.7  # m/s; landing faster on anything but the feet is a fall


class MotionService:
    """The robot's own software: it stands, lies down and gets up. While `active` it commands the motors."""

    def __init__(self, robot: Robot, lying: Array, *, active: bool) -> None:
        self._stand, self._lying = robot.home_joint_pos, lying
        self._from, self._to, self._time = self._stand, self._stand, _MOVE_S
        self._command = np.zeros(1, COMMAND)
        self._command["stiffness"], self._command["damping"] = standing_gains(robot)
        self.active = active

    def lie_down(self) -> None:
        self._move(self._lying)

    def stand_up(self) -> None:
        self._move(self._stand)

    def take_over(self, joints: Array) -> None:
        """Becomes active with the joints at (12,) rad, and stands up."""
        self._command["joint_pos"] = joints
        self.active = True
        self.stand_up()

    def command(self, dt: float) -> Records:
        """(1,) of `COMMAND` for the next dt s."""
        self._time = min(self._time + dt, _MOVE_S)
        share = smooth(self._time / _MOVE_S)
        self._command["joint_pos"] = (1 - share) * self._from + share * self._to
        return self._command

    def _move(self, to: Array) -> None:
        self._from, self._to, self._time = self._command["joint_pos"][0].copy(), to, 0.0


class SimulatedBody:
    """One simulated robot, step by step: `steps` since the start; `observation` (1,) of `OBSERVATION` is its true one.
    Its own motion `service` is active if it starts standing. `command` (1,) of `COMMAND` is what the motors followed in
    the last step; `damped` and `damped_s` tell whether they damp for lack of commands, and for how long in all, s;
    `fell` whether it tipped over or landed on anything but its feet at more than 0.7 m/s."""

    def __init__(
        self, robot: Robot, conditions: Conditions, rate_hz: float, start: str, watchdog_s: float = WATCHDOG_S
    ) -> None:
        """It is stepped at `rate_hz`, its sensors are read at 500 Hz. The motors damp when no command came for
        `watchdog_s`. Raises `ConfigError` if `start` is none of `STARTS`, or the simulator cannot do the conditions."""
        if start not in STARTS:
            raise ConfigError(f"a simulated robot starts {' or '.join(STARTS)}, not '{start}'")
        world = make_world(conditions.disturbances, 1, conditions.simulator)
        self.robot, self.sensors = robot, Sensors(robot, 1, _RATE_HZ, conditions.sensors, world)
        self.simulation = make_simulation(robot, 1, conditions, control_rate_hz=rate_hz)
        self.observation = self.simulation.observation  # the same records in all steps
        self._dt, self._standing, self._watchdog_s = 1.0 / rate_hz, start == "standing", watchdog_s
        self._damping = damping_command()

    def reset(self, generator: np.random.Generator) -> Records:
        """Puts the robot at rest at its start; returns (1,) of `READING`. `generator` draws the sensors' errors."""
        path, height = rising_path(self.robot, self.robot.home_joint_pos)
        joints = path[0]
        self.service = MotionService(self.robot, joints, active=self._standing)
        if self._standing:
            joints, height = self.robot.home_joint_pos, self.robot.home_height
        position, zero = np.array([[0.0, 0.0, height]]), np.zeros((1, 3))
        self.simulation.reset(position, np.array([[1.0, 0, 0, 0]]), joints[None], zero, zero, np.zeros((1, 12)))
        for _ in range(round(_SETTLE_S / self._dt)):
            self.simulation.step(self.service.command(self._dt) if self._standing else self._damping)
        self.command, self._last = self._damping, np.zeros(1, COMMAND)
        self._commanded: int | None = None
        self.steps, self.damped, self.damped_s, self.fell = 0, True, 0.0, False
        return self.sensors.reset([generator], self.observation)

    @property
    def time(self) -> float:
        """Since the start, s."""
        return self.steps * self._dt

    def obey(self, command: Records) -> None:
        """Takes a new command (1,) of `COMMAND`."""
        self._last[...] = command
        self._commanded = self.steps

    def step(self) -> None:
        """Advances one step with the motion service's command, the last one obeyed, or damping."""
        fresh = self._commanded is not None and (self.steps - self._commanded) * self._dt <= self._watchdog_s
        self.damped = not fresh and not self.service.active
        if self.service.active:
            self.command = self.service.command(self._dt)
        else:
            self.command = self._last if fresh else self._damping
        self.damped_s += self._dt if self.damped else 0.0
        falling = -float(self.observation["lin_vel"][0, 2])
        self.simulation.step(self.sensors.to_motors(self.command))
        self.steps += 1
        _, x, y, _ = self.observation["root_quat"][0]
        landed = self.observation["other_contact"][0] > 0 and falling > _IMPACT
        self.fell = self.fell or bool(1 - 2 * (x * x + y * y) < TIPPED or landed)

    def measure(self) -> Records:
        """(1,) of `READING`, delivered by the sensors after this step."""
        return self.sensors.measure(self.observation, self.sensors.command)


@documented
@dataclass(frozen=True, kw_only=True)
class LinkFaults:
    """Faults of a link in one direction; none by default."""

    latency_s: float = parameter(0.0, high=1.0, unit="s", about="latency of every message")
    loss: float = parameter(0.0, high=1.0, about="share of the messages that never arrive")
    duplicate: float = parameter(0.0, high=1.0, about="share of the messages that arrive twice")
    reorder: float = parameter(0.0, high=1.0, about="share of the messages that arrive after the next one")
    corrupt: float = parameter(0.0, high=1.0, about="share of the messages that arrive with a bit flipped")
    not_finite: float = parameter(0.0, high=1.0, about="share of the records sent as NaN")
    seed: int = parameter(0, low=None, about="seed of the faults")

    def __post_init__(self) -> None:
        check(self, "link: ")


class Packet(NamedTuple):
    """A message under way: its arrival, s; its place among those of the same arrival; the sender's count; whether it
    is undamaged, as its checksum tells; the record's bytes."""

    arrival: float
    place: int
    sequence: int
    intact: bool
    content: bytes

    def record(self, kind: np.dtype[Any]) -> tuple[Records, bool]:
        """The record (1,), and whether it is undamaged and finite."""
        found = np.frombuffer(bytearray(self.content), kind)
        return found, self.intact and bool(np.isfinite(found.view(np.float64)).all())


class SimulatedLink:
    """One direction of a link; counts the messages `lost` and `corrupted`."""

    def __init__(self, faults: LinkFaults, period_s: float, stream: int) -> None:
        """`period_s` is the time between two messages, s; `stream` the number of its random stream."""
        self.faults, self._period_s = faults, period_s
        self._rng = np.random.default_rng(np.random.SeedSequence([faults.seed, stream]))
        self._under_way: list[Packet] = []
        self._sent = self.lost = self.corrupted = 0

    def send(self, now: float, sequence: int, record: Records) -> None:
        """Sends a record (1,) at a time in s."""
        faults = self.faults
        lost, doubled, late, flipped, nan = self._rng.random(5)
        if nan < faults.not_finite:
            record = record.copy()
            record.view(np.float64)[:] = np.nan
        content, intact = record.tobytes(), True
        if lost < faults.loss:
            self.lost += 1
            return
        if flipped < faults.corrupt:
            self.corrupted += 1
            intact = False
            at = int(self._rng.integers(len(content)))
            content = content[:at] + bytes([content[at] ^ 0x10]) + content[at + 1 :]
        arrival = now + faults.latency_s + (1.5 * self._period_s if late < faults.reorder else 0.0)
        for _ in range(2 if doubled < faults.duplicate else 1):
            self._sent += 1
            heapq.heappush(self._under_way, Packet(arrival, self._sent, sequence, intact, content))

    def arrived(self, now: float) -> list[Packet]:
        """The packets that have arrived by a time in s, in order."""
        found = []
        while self._under_way and self._under_way[0].arrival <= now + 1e-9:
            found.append(heapq.heappop(self._under_way))
        return found


class SimDriver(RobotDriver):
    """One simulated robot, which advances to the clock's time when it is read: in lock step with a `VirtualClock`, in
    real time with a `LoopClock`. The steps of its `body` are the sequence numbers of the states."""

    def __init__(
        self,
        robot: Robot,
        clock: LoopClock | None = None,
        *,
        conditions: Conditions = Conditions(observe="sensors"),
        faults: LinkFaults = LinkFaults(),
        start: str = "lying",
    ) -> None:
        """`clock` is a virtual one if None; `conditions` the sensors, world and seed; `faults` those of the link in
        both directions; `start` "lying" or "standing". Raises `ConfigError` for another start, and for conditions that
        the simulator cannot realise."""
        super().__init__(robot)
        self._clock: LoopClock = clock if clock is not None else VirtualClock()
        self._conditions, self._faults = conditions, faults
        self._dt = 1.0 / _RATE_HZ
        self.body = SimulatedBody(robot, self._conditions, _RATE_HZ, start)
        self._truth: list[bytes] = []

    def truth_at(self, sequence: Indices) -> Records:
        """(k,) of `OBSERVATION`: the true states of messages by number (k,)."""
        return np.frombuffer(bytearray().join(self._truth[number] for number in sequence.tolist()), OBSERVATION)

    def _connect(self) -> None:
        """Puts the robot at its start and sends its first state."""
        self._states = SimulatedLink(self._faults, self._dt, 0)
        self._commands = SimulatedLink(self._faults, self._dt, 1)
        self._obeyed = -1  # number of the last command
        reading = self.body.reset(episode_generator(self._conditions.seed, 0, _SENSORS))
        self._truth = [self.body.observation.tobytes()]
        self._epoch = self._now()
        self._states.send(self._epoch - self._faults.latency_s, 0, reading)

    def close(self) -> None:
        """Nothing: it ends with the program."""

    def _now(self) -> float:
        return self._clock.now()

    def _wait(self, most_s: float) -> None:
        self._clock.sleep_until(self._now() + min(self._dt, most_s))

    def _send(self, command: Records) -> bool:
        self._commands.send(self._now(), self.packets.sent, command)
        return True

    def _newest(self) -> StateMessage | None:
        now, newest = self._now(), None
        behind = now - self._epoch - self.body.steps * self._dt
        if behind > _MOST_BEHIND_S:  # nothing read it meanwhile: it stood still
            self._epoch += behind - self._dt
        while self._epoch + (self.body.steps + 1) * self._dt <= now + 1e-9:
            self._advance(self._epoch + self.body.steps * self._dt)
        for packet in self._states.arrived(now):
            reading, good = packet.record(READING)
            if self._count(packet.sequence, good=good, step=1):
                newest = StateMessage(reading, packet.sequence, packet.arrival)
        return newest

    def _advance(self, began: float) -> None:
        """Simulates a control period with the commands that have arrived at its beginning."""
        for packet in self._commands.arrived(began):
            command, good = packet.record(COMMAND)
            if good and packet.sequence > self._obeyed:
                self._obeyed, self.body.service.active = packet.sequence, False
                self.body.obey(command)
        self.body.step()
        self._truth.append(self.body.observation.tobytes())
        self._states.send(began + self._dt, self.body.steps, self.body.measure())
