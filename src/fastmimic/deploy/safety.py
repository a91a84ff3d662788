"""The safety checks: every state before the controller sees it, every command before it is sent."""

from dataclasses import dataclass
from enum import Enum
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from fastmimic.base.configuration import pack, record_fields
from fastmimic.base.conventions import JOINT_NAMES
from fastmimic.base.jit import inlined, kernel, record_dtype
from fastmimic.deploy.safety_limits import SafetyLimits
from fastmimic.reference.table import CLOCK, SAMPLE
from fastmimic.robot import Robot


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
    DRIVER = "driver"  # it failed

    @property
    def planned(self) -> bool:
        """Whether the robot sat down by itself."""
        return self in (StopReason.DURATION, StopReason.CYCLES, StopReason.END, StopReason.ASKED)


@dataclass(frozen=True)
class Violation:
    """The reason of an early end, and a line with the value and its limit."""

    reason: StopReason
    text: str


_LIMITS: Final = record_dtype(
    [
        ("joint_lower", "f8", (12,)),
        ("joint_upper", "f8", (12,)),
        ("speed_limit", "f8", (12,)),
        ("torque_limit", "f8", (12,)),
        ("dt", "f8"),
        *record_fields(SafetyLimits),
    ]
)
"""Limits of the robot, the period, and `SafetyLimits`, as the kernels read them."""

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
    """A state's violation (check, joint, value, limit); updates `strained` (12,), s near the limit of each motor."""
    limit, reading = limits[0], readings[0]
    if not _finite(reading):
        return _NOT_FINITE, 0, 0.0, 0.0
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


@kernel
def _check_estimate(limits: Any, observations: Any, table: Any, clock: Any) -> tuple[int, float, float, float]:
    """An estimate's violation as (check, height, least, greatest)."""
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
    """Checks states and commands of one robot against the limits; `cut` counts the numbers cut in the last command."""

    def __init__(self, robot: Robot, limits: SafetyLimits, rate_hz: float) -> None:
        self.limits = limits
        record = np.zeros(1, _LIMITS)
        record["joint_lower"], record["joint_upper"] = robot.joint_lower, robot.joint_upper
        record["speed_limit"], record["torque_limit"] = robot.joint_speed_limit, robot.torque_limit
        record["dt"] = 1.0 / rate_hz
        pack(limits, record)
        self._record = record
        self._strained = np.zeros(12)
        self._upright, self._still = np.zeros(1, SAMPLE), np.zeros(1, CLOCK)
        self._upright["root_quat"] = 1.0, 0.0, 0.0, 0.0
        self.cut = 0

    def reset(self) -> None:
        self._strained[:] = 0.0

    def check_age(self, age_s: float) -> Violation | None:
        """Checks the age of the newest state, s."""
        if age_s <= self.limits.stale_s:
            return None
        text = f"no state of the robot for {1e3 * age_s:.0f} ms; {1e3 * self.limits.stale_s:.0f} are allowed"
        return Violation(StopReason.STALE_STATE, text)

    def check_lateness(self, late_s: float) -> Violation | None:
        """Checks how long after its period's end a command is sent, s."""
        if late_s <= self.limits.overrun_s:
            return None
        text = f"a command was {1e3 * late_s:.1f} ms late; {1e3 * self.limits.overrun_s:.0f} are allowed"
        return self._found(StopReason.OVERRUN, text)

    def check_state(
        self, reading: NDArray[Any], table: NDArray[Any] | None = None, clock: NDArray[Any] | None = None
    ) -> Violation | None:
        """Checks a state (1,) of `READING`, its tilt against the reference: `table` (t,) of `SAMPLE`, None for upright,
        at `clock` (1,) of `CLOCK`."""
        followed = table if table is not None else self._upright
        at = clock if clock is not None else self._still
        what, joint, value, limit = _check_state(self._record, reading, followed, at, self._strained)
        if what == _FINE:
            return None
        if what == _NOT_FINITE:
            return self._found(StopReason.NOT_FINITE, "a state of the robot is not finite")
        if what == _TILT:
            origin = "from the vertical" if table is None else "from the reference's"
            text = f"the trunk's tilt is {value:.2f} rad {origin}; {limit:g} are allowed"
            return self._found(StopReason.TILT, text)
        reason, name, unit = _JOINT_CHECKS[what]
        took = f" for more than {self.limits.torque_time_s:g} s" if what == _TORQUE else ""
        return self._found(reason, f"{JOINT_NAMES[joint]}: {name} {value:.2f} {unit}, beyond {limit:.2f} {unit}{took}")

    def check_estimate(self, observation: NDArray[Any], table: NDArray[Any], clock: NDArray[Any]) -> Violation | None:
        """Checks the controller's input, (1,) of `OBSERVATION`, against the reference."""
        what, height, least, most = _check_estimate(self._record, observation, table, clock)
        if what == _FINE:
            return None
        if what == _NOT_FINITE:
            return self._found(StopReason.NOT_FINITE, "the estimate of the robot's state is not finite")
        text = f"the base is {height:.3f} m above the ground; {least:.3f} to {most:.3f} m are allowed"
        return self._found(StopReason.HEIGHT, text)

    def check_solver(self, failed_in_a_row: int) -> Violation | None:
        """Checks the number of consecutive failures of the stance QP."""
        if failed_in_a_row <= self.limits.qp_failures:
            return None
        text = f"the stance QP failed {failed_in_a_row} times in a row; {self.limits.qp_failures} are allowed"
        return self._found(StopReason.QP_FAILURE, text)

    def check_posture(self, reading: NDArray[Any], target: NDArray[np.float64]) -> Violation | None:
        """Checks that the joints are near a posture (12,), rad."""
        error = np.abs(reading["joint_pos"][0] - target)
        joint = int(np.argmax(error))
        if error[joint] <= self.limits.posture:
            return None
        found = f"{error[joint]:.2f} rad off the standing posture; {self.limits.posture:g} are allowed"
        return self._found(StopReason.POSTURE, f"{JOINT_NAMES[joint]}: {found}")

    def cut_command(self, command: NDArray[Any]) -> Violation | None:
        """Cuts a command (1,) of `COMMAND` to the limits, in place."""
        self.cut = _cut_command(self._record, command)
        if self.cut >= 0:
            return None
        return Violation(StopReason.NOT_FINITE, "a command of the controller is not finite")

    def _found(self, reason: StopReason, text: str) -> Violation | None:
        return Violation(reason, text)


class DryRunGuard(Guard):
    """For dry runs: keeps the first violation of each kind in `noted` and does not stop."""

    def __init__(self, robot: Robot, limits: SafetyLimits, rate_hz: float) -> None:
        super().__init__(robot, limits, rate_hz)
        self.noted: dict[StopReason, Violation] = {}

    def _found(self, reason: StopReason, text: str) -> Violation | None:
        self.noted.setdefault(reason, Violation(reason, text))
        return None
