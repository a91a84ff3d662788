"""Whether the robot may go on: every state and every command is held against the limits before it counts."""

from dataclasses import dataclass
from enum import Enum
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from fastmimic.base.conventions import JOINT_NAMES
from fastmimic.base.jit import inlined, kernel, record_dtype
from fastmimic.deploy.safety_limits import SafetyLimits
from fastmimic.reference.table import CLOCK, SAMPLE
from fastmimic.robot import Robot


class StopReason(Enum):
    """Why a deployment ended. The first ones end it as planned, the others by damping."""

    DURATION = "duration"
    CYCLES = "cycles"
    END = "end"
    """Of a motion that does not repeat."""
    ASKED = "asked"
    """By a person, to sit down."""
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
    DRIVER = "driver"
    """The driver failed."""

    @property
    def planned(self) -> bool:
        """Whether the robot has sat down by itself."""
        return self in (StopReason.DURATION, StopReason.CYCLES, StopReason.END, StopReason.ASKED)


@dataclass(frozen=True)
class Violation:
    """What ended a deployment before its time: the reason, and a line that says what was found and what is allowed."""

    reason: StopReason
    text: str


_LIMITS: Final = record_dtype(
    [
        ("lower", "f8", (12,)),
        ("upper", "f8", (12,)),
        ("range_lower", "f8", (12,)),
        ("range_upper", "f8", (12,)),
        ("speed", "f8", (12,)),
        ("most_speed", "f8", (12,)),
        ("torque", "f8", (12,)),
        ("most_torque", "f8", (12,)),
        ("peak_torque", "f8", (12,)),
        ("torque_time", "f8"),
        ("tilt", "f8"),
        ("height_least", "f8"),
        ("height_most", "f8"),
        ("stiffness", "f8"),
        ("damping", "f8"),
        ("dt", "f8"),
    ]
)
"""Limits and robot as the kernels read them; `range_` and `most_` are where a state is a violation, the others where a
command is cut."""

_FINE, _NOT_FINITE, _POSITION, _SPEED, _PEAK, _TORQUE, _TILT, _HEIGHT = range(8)
_JOINT_CHECKS: Final = {
    _POSITION: (StopReason.JOINT_POSITION, "angle", "rad"),
    _SPEED: (StopReason.JOINT_VELOCITY, "speed", "rad/s"),
    _PEAK: (StopReason.TORQUE, "torque", "N·m"),
    _TORQUE: (StopReason.TORQUE, "torque", "N·m"),
}


@inlined
def _finite(reading: Any) -> bool:
    total = 0.0
    for k in range(4):
        total += reading.quat[k] + reading.foot_force[k]
    for k in range(3):
        total += reading.gyro[k] + reading.accel[k]
    for j in range(12):
        total += reading.joint_pos[j] + reading.joint_vel[j] + reading.torque[j]
    return bool(np.isfinite(total))


@inlined
def _tilt(quat: Any, reference: Any) -> float:
    """Angle between the verticals of two orientations (4,), rad, whatever their headings."""
    w, x, y, z = quat[0], quat[1], quat[2], quat[3]
    a, b, e, f = reference[0], reference[1], reference[2], reference[3]
    # the world's vertical in either body frame
    ux, uy, uz = 2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)
    vx, vy, vz = 2 * (b * f - a * e), 2 * (e * f + a * b), 1 - 2 * (b * b + e * e)
    c = ux * vx + uy * vy + uz * vz
    return np.arccos(min(max(c, -1.0), 1.0))


@kernel
def _check_state(limits: Any, readings: Any, table: Any, clock: Any, strained: Any) -> tuple[int, int, float, float]:
    """What is wrong with a state, as (check, joint, value, limit).

    Args:
        limits: (1,) of `_LIMITS`.
        readings: (1,) of `READING`.
        table, clock: (t,) of `SAMPLE` and (1,) of `CLOCK`, where the reference is.
        strained: (12,) how long each motor has been near its limit, s; changed.
    """
    limit, reading = limits[0], readings[0]
    if not _finite(reading):
        return _NOT_FINITE, 0, 0.0, 0.0
    for j in range(12):
        q, dq, torque = reading.joint_pos[j], abs(reading.joint_vel[j]), abs(reading.torque[j])
        if q < limit.range_lower[j]:
            return _POSITION, j, q, limit.range_lower[j]
        if q > limit.range_upper[j]:
            return _POSITION, j, q, limit.range_upper[j]
        if dq > limit.most_speed[j]:
            return _SPEED, j, dq, limit.most_speed[j]
        if torque > limit.peak_torque[j]:
            return _PEAK, j, torque, limit.peak_torque[j]
        strained[j] = strained[j] + limit.dt if torque > limit.most_torque[j] else 0.0
        if strained[j] > limit.torque_time:
            return _TORQUE, j, torque, limit.most_torque[j]
    tilt = _tilt(reading.quat, table[clock[0].sample].root_quat)
    if not tilt <= limit.tilt:
        return _TILT, 0, tilt, limit.tilt
    return _FINE, 0, 0.0, 0.0


@kernel
def _check_estimate(limits: Any, observations: Any, table: Any, clock: Any) -> tuple[int, float, float, float]:
    """What is wrong with an estimate, as (check, height, least, greatest); arguments as above."""
    observation, height = observations[0], table[clock[0].sample].root_pos[2]
    total = 0.0
    for k in range(3):
        total += observation.root_pos[k] + observation.lin_vel[k] + observation.ang_vel[k]
    for k in range(4):
        total += observation.root_quat[k]
    if not np.isfinite(total):
        return _NOT_FINITE, 0.0, 0.0, 0.0
    least, most = limits[0].height_least * height, limits[0].height_most * height
    found = observation.root_pos[2]
    return _FINE if least <= found <= most else _HEIGHT, found, least, most


@inlined
def _cut(value: float, low: float, high: float) -> float:
    return min(max(value, low), high)


@kernel
def _cut_command(records: Any, commands: Any) -> int:
    """Cuts a command (1,) to what the robot can, in place; returns how many numbers were changed, −1 if one is not
    finite."""
    limits, command, cut = records[0], commands[0], 0
    for j in range(12):
        q, dq, torque = command.joint_pos[j], command.joint_vel[j], command.torque[j]
        kp, kd = command.stiffness[j], command.damping[j]
        if not np.isfinite(q + dq + torque + kp + kd):
            return -1
        command.joint_pos[j] = _cut(q, limits.lower[j], limits.upper[j])
        command.joint_vel[j] = _cut(dq, -limits.speed[j], limits.speed[j])
        command.torque[j] = _cut(torque, -limits.torque[j], limits.torque[j])
        command.stiffness[j] = _cut(kp, 0.0, limits.stiffness)
        command.damping[j] = _cut(kd, 0.0, limits.damping)
        cut += int(command.joint_pos[j] != q) + int(command.joint_vel[j] != dq) + int(command.torque[j] != torque)
        cut += int(command.stiffness[j] != kp) + int(command.damping[j] != kd)
    return cut


class Guard:
    """Holds states and commands of one robot against the limits. Nothing that it does depends on anything else.

    Attributes:
        cut: how many numbers of the last command were beyond what the robot can.
    """

    def __init__(self, robot: Robot, limits: SafetyLimits, rate_hz: float) -> None:
        self.limits = limits
        record = np.zeros(1, _LIMITS)
        record["lower"], record["upper"] = robot.joint_lower, robot.joint_upper
        record["range_lower"] = robot.joint_lower - limits.joint_margin
        record["range_upper"] = robot.joint_upper + limits.joint_margin
        record["speed"] = robot.joint_speed_limit
        record["most_speed"] = limits.joint_speed * robot.joint_speed_limit
        record["torque"] = robot.torque_limit
        record["most_torque"] = limits.torque * robot.torque_limit
        record["peak_torque"] = limits.torque_peak * robot.torque_limit
        record["tilt"] = limits.tilt
        record["height_least"], record["height_most"] = limits.height_least, limits.height_most
        record["torque_time"], record["dt"] = limits.torque_time_s, 1.0 / rate_hz
        record["stiffness"], record["damping"] = limits.stiffness_most, limits.damping_most
        self._record = record
        self._strained = np.zeros(12)
        self._upright, self._still = np.zeros(1, SAMPLE), np.zeros(1, CLOCK)
        self._upright["root_quat"] = 1.0, 0.0, 0.0, 0.0
        self.cut = 0

    def reset(self) -> None:
        """Forgets how long motors have been near their limits."""
        self._strained[:] = 0.0

    def check_age(self, age_s: float) -> Violation | None:
        """The age of the newest state, s."""
        if age_s <= self.limits.stale_s:
            return None
        return Violation(
            StopReason.STALE_STATE,
            f"no state of the robot for {1e3 * age_s:.0f} ms; {1e3 * self.limits.stale_s:.0f} are allowed",
        )

    def check_lateness(self, late_s: float) -> Violation | None:
        """By how much a command goes out after its period's end, s."""
        if late_s <= self.limits.overrun_s:
            return None
        return Violation(
            StopReason.OVERRUN,
            f"a command was {1e3 * late_s:.1f} ms late; {1e3 * self.limits.overrun_s:.0f} are allowed",
        )

    def check_state(
        self, reading: NDArray[Any], table: NDArray[Any] | None = None, clock: NDArray[Any] | None = None
    ) -> Violation | None:
        """A state.

        Args:
            reading: (1,) of `READING`.
            table: (t,) of `SAMPLE`, whose trunk's tilt the robot's should be near; None for upright.
            clock: (1,) of `CLOCK`, where in it.
        """
        followed = table if table is not None else self._upright
        at = clock if clock is not None else self._still
        what, joint, value, limit = _check_state(self._record, reading, followed, at, self._strained)
        if what == _FINE:
            return None
        if what == _NOT_FINITE:
            return Violation(StopReason.NOT_FINITE, "a state of the robot is not finite")
        if what == _TILT:
            whose = "from the vertical" if table is None else "from the reference's"
            return Violation(StopReason.TILT, f"the trunk's tilt is {value:.2f} rad {whose}; {limit:g} are allowed")
        reason, name, unit = _JOINT_CHECKS[what]
        took = f" for more than {self.limits.torque_time_s:g} s" if what == _TORQUE else ""
        return Violation(reason, f"{JOINT_NAMES[joint]}: {name} {value:.2f} {unit}, beyond {limit:.2f} {unit}{took}")

    def check_estimate(self, observation: NDArray[Any], table: NDArray[Any], clock: NDArray[Any]) -> Violation | None:
        """What the controller is told, (1,) of `OBSERVATION`, beside the reference as above."""
        what, height, least, most = _check_estimate(self._record, observation, table, clock)
        if what == _FINE:
            return None
        if what == _NOT_FINITE:
            return Violation(StopReason.NOT_FINITE, "the estimate of the robot's state is not finite")
        return Violation(
            StopReason.HEIGHT, f"the base is {height:.3f} m above the ground; {least:.3f} to {most:.3f} m are allowed"
        )

    def check_solver(self, failed_in_a_row: int) -> Violation | None:
        """Failures of the controller's optimisation in a row."""
        if failed_in_a_row <= self.limits.qp_failures:
            return None
        return Violation(
            StopReason.QP_FAILURE,
            f"the controller's forces could not be computed {failed_in_a_row} times in a row;"
            f" {self.limits.qp_failures} are allowed",
        )

    def check_posture(self, reading: NDArray[Any], target: NDArray[np.float64]) -> Violation | None:
        """Whether the joints of a state are where they should be, (12,) rad."""
        error = np.abs(reading["joint_pos"][0] - target)
        joint = int(np.argmax(error))
        if error[joint] <= self.limits.posture:
            return None
        return Violation(
            StopReason.POSTURE,
            f"{JOINT_NAMES[joint]}: {error[joint]:.2f} rad off the standing posture; {self.limits.posture:g} are"
            " allowed",
        )

    def cut_command(self, command: NDArray[Any]) -> Violation | None:
        """Cuts a command (1,) of `COMMAND` to what the robot can, in place."""
        self.cut = _cut_command(self._record, command)
        if self.cut >= 0:
            return None
        return Violation(StopReason.NOT_FINITE, "a command of the controller is not finite")


class DryRunGuard(Guard):
    """Notes what is beyond the limits and lets it pass: for a robot that gets no commands and so is not where they
    would have it.

    Attributes:
        noted: the first of each kind.
    """

    def __init__(self, robot: Robot, limits: SafetyLimits, rate_hz: float) -> None:
        super().__init__(robot, limits, rate_hz)
        self.noted: dict[StopReason, Violation] = {}

    def check_lateness(self, late_s: float) -> Violation | None:
        self._note(super().check_lateness(late_s))
        return None

    def check_state(
        self, reading: NDArray[Any], table: NDArray[Any] | None = None, clock: NDArray[Any] | None = None
    ) -> Violation | None:
        self._note(super().check_state(reading, table, clock))
        return None

    def check_estimate(self, observation: NDArray[Any], table: NDArray[Any], clock: NDArray[Any]) -> Violation | None:
        self._note(super().check_estimate(observation, table, clock))
        return None

    def check_solver(self, failed_in_a_row: int) -> Violation | None:
        self._note(super().check_solver(failed_in_a_row))
        return None

    def check_posture(self, reading: NDArray[Any], target: NDArray[np.float64]) -> Violation | None:
        self._note(super().check_posture(reading, target))
        return None

    def _note(self, found: Violation | None) -> None:
        if found is not None:
            self.noted.setdefault(found.reason, found)
