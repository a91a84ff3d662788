"""The safety limits and their checks: each state before the controller sees it, each command before it is sent."""

import dataclasses
import json
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import Any, Final

import numpy as np

from fastmimic.base.arrays import Array, Records
from fastmimic.base.configuration import changed, check, pack, parameters, record_fields, tabulated
from fastmimic.base.conventions import JOINT_NAMES
from fastmimic.base.errors import ConfigError
from fastmimic.base.files import from_json
from fastmimic.base.jit import floats, inlined, kernel, record_dtype
from fastmimic.deploy.plausibility import Doubt, Senses
from fastmimic.reference.table import CLOCK, SAMPLE
from fastmimic.robot import Robot
from fastmimic.robot.robot import joint_ratio


@tabulated
@dataclass(frozen=True)
class SafetyLimits:
    """Limits of a deployment. Beyond any of them the joints are damped.

    Shares refer to the robot's limits in its model. The defaults are an A1's; `SafetyLimits.of` scales them.
    """

    joint_margin: float = 0.1
    joint_speed: float = 1.5
    torque: float = 0.95
    torque_time_s: float = 0.3
    torque_peak: float = 1.5
    tilt: float = 0.6
    height_least: float = 0.6
    height_most: float = 1.4
    stale_s: float = 0.02
    # In simulation a trot survives a pause of 50 ms, in which the robot's own watchdog damps the motors.
    overrun_s: float = 0.05
    qp_failures: int = 5
    posture: float = 0.25
    sensors_turn: float = 0.1
    sensors_gravity: float = 0.6
    sensors_slip: float = 0.25
    sensors_frozen: float = 0.1
    sensors_ground: float = 0.2
    lean: float = 0.1
    foreign: str = "damp"
    stiffness_most: float = 300.0
    damping_most: float = 20.0
    crouch_s: float = 0.4
    damping: float = 2.2
    damping_s: float = 1.5

    def __post_init__(self) -> None:
        check(self, "safety limit ")
        if self.height_least >= self.height_most:
            least, most = f"height_least ({self.height_least:g})", f"height_most ({self.height_most:g})"
            raise ConfigError(f"safety limit {least} must be below {most}")

    @classmethod
    def of(cls, robot: Robot) -> "SafetyLimits":
        """The defaults for a robot, with gains in proportion to the inertia that its joints move."""
        ratio, an_a1 = joint_ratio(robot), cls()
        gains = {name: ratio * getattr(an_a1, name) for name in ("stiffness_most", "damping_most", "damping")}
        return dataclasses.replace(an_a1, **gains)


def read_limits(robot: Robot, file: str | Path | None = None, settings: Sequence[str] = ()) -> SafetyLimits:
    """A robot's limits, changed by a TOML file and then by texts `name=value`; raises `ConfigError` for bad ones."""
    changes: dict[str, Any] = {}
    if file is not None:
        try:
            found = tomllib.loads(Path(file).read_text(encoding="utf-8"))
            changes = from_json(json.dumps(found, default=str))  # the numbers and types of JSON
        except (OSError, ValueError, RecursionError) as error:
            raise ConfigError(f"{file}: cannot be read as TOML ({error})") from None
    for text in settings:
        name, _, value = (part.strip() for part in text.partition("="))
        known = parameters(SafetyLimits).get(name)
        try:
            changes[name] = value if known is not None and known[0].choices else float(value)
        except ValueError:
            raise ConfigError(f"--limit takes NAME=VALUE, e.g. tilt=0.5; found '{text}'") from None
    where = str(file) if file is not None and not settings else "--limit"
    return changed(SafetyLimits.of(robot), changes, where)


class StopReason(Enum):
    """Why a deployment ended. The first four end it as planned, the others by damping."""

    DURATION = "duration"
    CYCLES = "cycles"
    END = "end"  # of a motion that does not repeat
    ASKED = "asked"  # by a person, to sit down
    KEY = "key"
    SIGNAL = "signal"
    JOINT_POSITION = "joint_position"
    JOINT_VELOCITY = "joint_velocity"
    TORQUE = "torque"
    TILT = "tilt"
    HEIGHT = "height"
    STALE_STATE = "stale_state"
    NOT_FINITE = "not_finite"
    OVERRUN = "overrun"
    QP_FAILURE = "qp_failure"
    POSTURE = "posture"
    IMU = "imu"
    JOINT_SENSOR = "joint_sensor"
    TORQUE_SENSOR = "torque_sensor"
    FOREIGN = "foreign_commands"  # of another program
    DRIVER = "driver"  # it failed
    UNKNOWN = "unknown"  # the log was cut off

    @property
    def planned(self) -> bool:
        """Whether the robot sat down by itself."""
        return self in (StopReason.DURATION, StopReason.CYCLES, StopReason.END, StopReason.ASKED)

    @property
    def crouches(self) -> bool:
        """Whether the robot crouches before it is damped: no key was pressed, and it obeys."""
        return self not in (StopReason.KEY, StopReason.DRIVER, StopReason.FOREIGN, StopReason.NOT_FINITE)


@dataclass(frozen=True)
class Violation:
    """The reason of an early end, and a line with the value and its limit."""

    reason: StopReason
    text: str


_LIMITS: Final = record_dtype(
    [*floats(joint_lower=12, joint_upper=12, speed_limit=12, torque_limit=12, dt=()), *record_fields(SafetyLimits)]
)  # limits of the robot, the period, and `SafetyLimits`, as the kernels read them

_FINE, _POSITION, _SPEED, _PEAK, _TORQUE, _TILT = range(6)
_JOINT_CHECKS: Final = {
    _POSITION: (StopReason.JOINT_POSITION, "angle", "rad"),
    _SPEED: (StopReason.JOINT_VELOCITY, "speed", "rad/s"),
    _PEAK: (StopReason.TORQUE, "torque", "N·m"),
    _TORQUE: (StopReason.TORQUE, "torque", "N·m"),
}
_NUMBER_CHECKS: Final = {
    StopReason.STALE_STATE: ("stale_s", 1e3, "no state of the robot for {:.0f} ms; {:.0f} are allowed"),
    StopReason.OVERRUN: ("overrun_s", 1e3, "a command was {:.1f} ms late; {:.0f} are allowed"),
    StopReason.QP_FAILURE: ("qp_failures", 1, "the stance QP failed {} times in a row; {} are allowed"),
    StopReason.POSTURE: ("posture", 1, "{:.2f} rad off the standing posture; {:g} are allowed"),
}  # the limit of a number, the factor of both in the message, and the message


@inlined
def _tilt(quat: Any, reference: Any) -> float:
    """Angle between the verticals of two orientations (4,), rad, for any headings."""
    w, x, y, z = quat[0], quat[1], quat[2], quat[3]
    a, b, e, f = reference[0], reference[1], reference[2], reference[3]
    # the world's vertical in either body frame
    ux, uy, uz = 2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)
    vx, vy, vz = 2 * (b * f - a * e), 2 * (e * f + a * b), 1 - 2 * (b * b + e * e)
    c = ux * vx + uy * vy + uz * vz
    return np.arccos(min(max(c, -1.0), 1.0))


@kernel
def _check_state(limits: Any, readings: Any, table: Any, clock: Any, strained: Any) -> tuple[int, int, float, float]:
    """A finite state's violation (check, joint, value, limit); updates `strained` (12,), s near each motor's limit."""
    limit, reading = limits[0], readings[0]
    for j in range(12):
        q, dq, torque = reading.joint_pos[j], abs(reading.joint_vel[j]), abs(reading.torque[j])
        lower, upper = limit.joint_lower[j] - limit.joint_margin, limit.joint_upper[j] + limit.joint_margin
        most_speed, most_torque = limit.joint_speed * limit.speed_limit[j], limit.torque * limit.torque_limit[j]
        peak_torque = limit.torque_peak * limit.torque_limit[j]
        if q < lower:
            return _POSITION, j, q, lower
        if q > upper:
            return _POSITION, j, q, upper
        if dq > most_speed:
            return _SPEED, j, dq, most_speed
        if torque > peak_torque:
            return _PEAK, j, torque, peak_torque
        strained[j] = strained[j] + limit.dt if torque > most_torque else 0.0
        if strained[j] > limit.torque_time_s:
            return _TORQUE, j, torque, most_torque
    tilt = _tilt(reading.quat, table[clock[0].sample].root_quat)
    if not tilt <= limit.tilt:
        return _TILT, 0, tilt, limit.tilt
    return _FINE, 0, 0.0, 0.0


@inlined
def _cut(value: float, low: float, high: float) -> float:
    return min(max(value, low), high)


@kernel
def _cut_command(records: Any, commands: Any) -> int:
    """Cuts a command (1,) to the limits, in place; returns how many numbers changed, −1 if one is not finite."""
    limits, command, cut = records[0], commands[0], 0
    for j in range(12):
        q, dq, torque = command.joint_pos[j], command.joint_vel[j], command.torque[j]
        kp, kd = command.stiffness[j], command.damping[j]
        if not np.isfinite(q + dq + torque + kp + kd):
            return -1
        command.joint_pos[j] = _cut(q, limits.joint_lower[j], limits.joint_upper[j])
        command.joint_vel[j] = _cut(dq, -limits.speed_limit[j], limits.speed_limit[j])
        command.torque[j] = _cut(torque, -limits.torque_limit[j], limits.torque_limit[j])
        command.stiffness[j] = _cut(kp, 0.0, limits.stiffness_most)
        command.damping[j] = _cut(kd, 0.0, limits.damping_most)
        cut += int(command.joint_pos[j] != q) + int(command.joint_vel[j] != dq) + int(command.torque[j] != torque)
        cut += int(command.stiffness[j] != kp) + int(command.damping[j] != kd)
    return cut


class Guard:
    """Checks states and commands of one robot against the limits. `cut` counts the numbers cut in the last command. In
    a dry run, `noted` holds the first violation of each kind; only missing states and commands not finite stop it."""

    def __init__(self, robot: Robot, limits: SafetyLimits, rate_hz: float, *, dry: bool = False) -> None:
        self.limits, self.dry = limits, dry
        self.noted: dict[StopReason, Violation] = {}
        self._record = np.zeros(1, _LIMITS)
        self._record["joint_lower"], self._record["joint_upper"] = robot.joint_lower, robot.joint_upper
        self._record["speed_limit"], self._record["torque_limit"] = robot.joint_speed_limit, robot.torque_limit
        self._record["dt"] = 1.0 / rate_hz
        pack(limits, self._record)
        self._strained = np.zeros(12)
        motors = np.stack([np.full(12, np.inf) if dry else robot.torque_limit, robot.joint_speed_limit])
        allowed = limits.sensors_turn, limits.sensors_gravity, limits.sensors_slip, limits.sensors_frozen
        self.senses = Senses(*allowed, motors)
        self._upright, self._still = np.zeros(1, SAMPLE), np.zeros(1, CLOCK)
        self._upright["root_quat"] = 1.0, 0.0, 0.0, 0.0
        self.cut = 0

    def reset(self) -> None:
        self._strained[:] = 0.0
        self.senses.reset()

    @property
    def leans(self) -> bool:
        """Whether the standing robot checks its sensors by a lean; not in a dry run, in which nothing moves."""
        return self.limits.lean > 0 and not self.dry

    def check_number(self, reason: StopReason, value: float, where: str = "") -> Violation | None:
        """Checks a number: age of the newest state, s (`STALE_STATE`); delay of a command beyond its period's end, s
        (`OVERRUN`); consecutive failures of the stance QP (`QP_FAILURE`); distance from a posture, rad (`POSTURE`)."""
        name, factor, text = _NUMBER_CHECKS[reason]
        limit = getattr(self.limits, name)
        if value <= limit:
            return None
        return self._found(reason, where + text.format(factor * value, factor * limit))

    def check_posture(self, reading: Records, target: Array) -> Violation | None:
        """Checks that the joints are near a posture (12,), rad."""
        error = np.abs(reading["joint_pos"][0] - target)
        joint = int(np.argmax(error))
        return self.check_number(StopReason.POSTURE, error[joint], f"{JOINT_NAMES[joint]}: ")

    def check_state(
        self, reading: Records, table: Records | None = None, clock: Records | None = None
    ) -> Violation | None:
        """Checks a state (1,) of `READING`, its tilt against the reference: `table` (t,) of `SAMPLE`, None for upright,
        at `clock` (1,) of `CLOCK`."""
        if not _finite(reading):
            return self._found(StopReason.NOT_FINITE, "a state of the robot is not finite")
        followed = table if table is not None else self._upright
        at = clock if clock is not None else self._still
        what, joint, value, limit = _check_state(self._record, reading, followed, at, self._strained)
        if what == _FINE:
            return None
        if what == _TILT:
            origin = "from the vertical" if table is None else "from the reference's"
            return self._found(StopReason.TILT, f"the trunk's tilt is {value:.2f} rad {origin}; {limit:g} are allowed")
        reason, name, unit = _JOINT_CHECKS[what]
        took = f" for more than {self.limits.torque_time_s:g} s" if what == _TORQUE else ""
        return self._found(reason, f"{JOINT_NAMES[joint]}: {name} {value:.2f} {unit}, beyond {limit:.2f} {unit}{took}")

    def check_doubt(self, doubt: Doubt | None) -> Violation | None:
        return None if doubt is None else self._found(StopReason(doubt[0]), doubt[1])

    def check_estimate(self, observation: Records, table: Records, clock: Records) -> Violation | None:
        """Checks the controller's input, (1,) of `OBSERVATION`, against the reference."""
        if not _finite(observation):
            return self._found(StopReason.NOT_FINITE, "the estimate of the robot's state is not finite")
        reference, height = table["root_pos"][clock["sample"][0], 2], observation["root_pos"][0, 2]
        least, most = self.limits.height_least * reference, self.limits.height_most * reference
        if least <= height <= most:
            return None
        text = f"the base is {height:.3f} m above the ground; {least:.3f} to {most:.3f} m are allowed"
        return self._found(StopReason.HEIGHT, text)

    def cut_command(self, command: Records) -> Violation | None:
        """Cuts a command (1,) of `COMMAND` to the limits, in place."""
        self.cut = _cut_command(self._record, command)
        if self.cut >= 0:
            return None
        return Violation(StopReason.NOT_FINITE, "a command of the controller is not finite")

    def _found(self, reason: StopReason, text: str) -> Violation | None:
        violation = Violation(reason, text)
        if not self.dry or reason is StopReason.STALE_STATE:
            return violation
        self.noted.setdefault(reason, violation)
        return None


def _finite(record: Records) -> bool:
    return bool(np.isfinite(record.view(np.float64)).all())
