"""Whether a robot's sensors can be believed: against each other in every period, and by a lean before it steps.

In every period the gyroscope is held against the orientation, the accelerometer against gravity, the speed of each
joint against its angle, and nothing may stand still while something moves. What these cannot tell (axes that are
swapped, a mounting that is turned, torques in other units) the robot finds out while it stands: it leans in roll,
pitch and yaw on four feet, and legs, IMU and torques must tell of the same movement.
"""

import math
from typing import Any, Final

import numpy as np

from fastmimic.base.arrays import Array, Records
from fastmimic.base.conventions import GRAVITY, JOINT_NAMES
from fastmimic.base.jit import floats, inlined, integers, kernel, record_dtype
from fastmimic.base.rotations import matrix_from_quat, quat_conjugate, quat_from_rotvec, quat_multiply, rotvec_from_quat
from fastmimic.base.vectors import quat_turned
from fastmimic.robot import Robot
from fastmimic.robot.kinematics import foot_positions, inverse_kinematics
from fastmimic.robot.state import READING

IMU, JOINT, TORQUE = "imu", "joint_sensor", "torque_sensor"  # as in `StopReason`
LEAN_S: Final = 1.8
_TURN_S, _SLIP_S, _GRAVITY_S = 2.0, 0.2, 0.5  # time constants in which differences are forgotten
_SOON_S, _SOON = 0.03, 0.3  # of a turn that comes at once, which may be this share of the limit
_UNTIMELY: Final = 0.3  # share of a joint's movement that angle and speed may differ by: states arrive irregularly
_GAP_S: Final = 0.01  # after a longer gap between two states, what happened meanwhile is not judged
_MOTOR_S, _GIVES, _ASKED = 0.1, 0.08, 0.1  # a mean torque over this time, shares of the commanded one, and of its limit
_SLOW: Final = 0.3  # share of a joint's speed limit, beyond which its motor may have no torque left
_STILL: Final = 10  # readings of the same bits in a row; an IMU of 100 Hz gives five
_IMU_WORDS: Final = "orientation", "gyroscope", "accelerometer"
_LEAST_MOVE: Final = 0.01  # rad, root mean square; a joint that moves less in the lean tells nothing
_SHARE: Final = 0.5  # by which a movement may be smaller or greater than another sensor's
_LOAD: Final = 0.5, 1.8  # shares of the weight that the legs may bear by their torques, standing
_MOVING_LOAD: Final = 0.3, 2.5  # the same, as a mean over `_LOAD_S` of the motion
_LOAD_S: Final = 0.4
_AXES: Final = "roll", "pitch", "yaw"

Doubt = tuple[str, str]  # what cannot be believed (`IMU`, `JOINT` or `TORQUE`), and a line that says why


_JOINT_SUMS: Final = dict.fromkeys(("slip", "path", "beyond", "wanted_then", "asked", "given"), 12)
_SUMS: Final = record_dtype(
    [*floats(turn=3, turn_soon=3, **_JOINT_SUMS, accel=3, joints_then=(15, 12)), *integers(still=15)]
)
"""What readings add up to: the orientation's turn beyond the gyroscope's, rad, in `_TURN_S` and in `_SOON_S`; of each
joint, its angle beyond its speed's integral, its way, and the former beyond a share of the latter, rad; the mean
acceleration in the world, m/s²; the mean torques commanded and given, shares of the limit. Of 15 readings, the IMU's
three and by joint: for how many in a row it has had the same bits, and the joints and its joint's command when it last
changed, rad."""


@inlined
def _small_turn(before: Any, after: Any) -> tuple[float, float, float]:
    """Rotation vector between two quaternions, body frame, to first order in the angle."""
    a, b, c, d, w, x, y, z = before[0], before[1], before[2], before[3], after[0], after[1], after[2], after[3]
    turned = 2.0 * math.copysign(1.0, a * w + b * x + c * y + d * z)
    p, q, r = a * x - b * w - c * z + d * y, a * y + b * z - c * w - d * x, a * z - b * y + c * x - d * w
    return turned * p, turned * q, turned * r


@kernel
def _compare(sums: Any, nows: Any, lasts: Any, bits: Any, former: Any, commands: Any, limits: Any, dt: float) -> None:
    """Adds up what the sensors say differently in a reading (1,) of `READING` and the last one, and their bits; to the
    first reading `dt`, the time since the last one, s, is infinite. `limits` (2, 12): torque, N·m, and speed, rad/s."""
    s, now, last, command, first = sums[0], nows[0], lasts[0], commands[0], math.isinf(dt)
    half = 0.0 if first else 0.5 * dt
    for i in range(15):
        same = not first
        if i < 3:
            for k in range(0 if i == 0 else 1 + 3 * i, 4 + 3 * i):
                same = same and bits[k] == former[k]
        else:
            j = i - 3
            same = same and now.joint_pos[j] == last.joint_pos[j] and now.joint_vel[j] == last.joint_vel[j]
            s.wanted_then[j] = s.wanted_then[j] if same else command.joint_pos[j]
        s.still[i] = s.still[i] + 1 if same else 0
        for k in range(0 if same else 12):
            s.joints_then[i, k] = now.joint_pos[k]
    if not (first or 0.0 < dt <= _GAP_S):
        return
    turn, slip, mean = math.exp(-dt / _TURN_S), math.exp(-dt / _SLIP_S), math.exp(-dt / _GRAVITY_S)
    motor, soon = math.exp(-dt / _MOTOR_S), math.exp(-dt / _SOON_S)
    told, turned = quat_turned(now.quat, now.accel), _small_turn(last.quat, now.quat)
    for k in range(3):
        s.accel[k] = mean * s.accel[k] + (1.0 - mean) * told[k]
        unlike = turned[k] - half * (last.gyro[k] + now.gyro[k])
        s.turn[k], s.turn_soon[k] = turn * (s.turn[k] + unlike), soon * (s.turn_soon[k] + unlike)
    for j in range(12):
        went, moved = half * (last.joint_vel[j] + now.joint_vel[j]), now.joint_pos[j] - last.joint_pos[j]
        s.slip[j] = slip * (s.slip[j] + moved - went)
        s.path[j] = slip * (s.path[j] + max(abs(moved), abs(went)))
        s.beyond[j] = max(abs(s.slip[j]) - _UNTIMELY * s.path[j], abs(moved - went))
        if abs(now.joint_vel[j]) < _SLOW * limits[1, j]:
            asked = command.torque[j] + command.stiffness[j] * (command.joint_pos[j] - now.joint_pos[j])
            asked += command.damping[j] * (command.joint_vel[j] - now.joint_vel[j])
            asked = min(abs(asked), abs(command.torque[j]))  # a late state spoils what the stiffness asks for
            s.asked[j] = motor * s.asked[j] + (1.0 - motor) * asked / limits[0, j]
            s.given[j] = motor * s.given[j] + (1.0 - motor) * abs(now.torque[j]) / limits[0, j]


class Senses:
    """Compares the sensors of one robot with each other, period by period."""

    def __init__(self, turn: float, gravity: float, slip: float, frozen: float, motors: Array) -> None:
        """`turn`: of the orientation beyond the gyroscope's, rad; `gravity`: of the mean acceleration beyond gravity, a
        share of it; `slip`: of a joint's angle beyond its speed's integral and a share of its way, rad; `frozen`: of
        other joints while an IMU's reading stands still, or of a joint's leg or command while the joint's does, rad;
        `motors` (2, 12): greatest torque, N·m, infinite if motors are not judged, and speed, rad/s."""
        self._motors = motors
        self._turn_limit, self._gravity_limit, self._slip_limit, self._frozen = turn, gravity, slip, frozen
        self.reset()

    def reset(self) -> None:
        self._last: Records | None = None
        self._sums = np.zeros(1, _SUMS)
        of = {name: self._sums[name][0] for name in _SUMS.names or ()}
        self._turn, self._beyond, self._mean, self._still = of["turn"], of["beyond"], of["accel"], of["still"]
        self._soon = of["turn_soon"]
        self._asked, self._given = of["asked"], of["given"]
        self._joints_then, self._wanted_then = of["joints_then"], of["wanted_then"]

    def check(self, reading: Records, command: Records, elapsed_s: float) -> Doubt | None:
        """What is wrong with a reading (1,) of `READING`, None if it fits. It came `elapsed_s` after the last one, 0 if
        it is that. `command` (1,) of `COMMAND` is the last one."""
        if self._last is not None and elapsed_s == 0.0:
            return None
        last, elapsed_s = (reading, math.inf) if self._last is None else (self._last, elapsed_s)
        bits = reading.view(np.int64), last.view(np.int64)
        _compare(self._sums, reading, last, *bits, command, self._motors, elapsed_s)
        self._last = reading.copy()
        return self._frozen_sensor(reading[0], command["joint_pos"][0]) or self._contradiction()

    def _frozen_sensor(self, now: Any, wanted: Array) -> Doubt | None:
        """A sensor that gives the same bits while others, or the command, say that something moves."""
        if max(self._still.tolist()) < _STILL:
            return None
        long = self._still >= _STILL
        travelled = np.abs(now["joint_pos"] - self._joints_then)
        moved = travelled.max(1)
        for i in np.flatnonzero(long[:3] & (moved[:3] > self._frozen)):
            return IMU, f"the {_IMU_WORDS[i]} has stood still while joints moved by {moved[i]:.2f} rad"
        of_leg = travelled[3:].reshape(12, 4, 3)[np.arange(12), np.arange(12) // 3].max(1)
        moved = np.maximum(of_leg, np.abs(wanted - self._wanted_then))
        for j in np.flatnonzero(long[3:] & (moved > self._frozen)):
            return JOINT, f"{JOINT_NAMES[j]} has stood still while its leg, or its command, moved by {moved[j]:.2f} rad"
        return None

    def _contradiction(self) -> Doubt | None:
        """Two sensors that say different things."""
        for sum_, limit in ((self._turn, self._turn_limit), (self._soon, _SOON * self._turn_limit)):
            if (turn := math.hypot(*sum_.tolist())) > limit:
                return IMU, f"orientation and gyroscope differ by {turn:.2g} rad; {limit:g} are allowed"
        off = math.dist(self._mean.tolist(), (0.0, 0.0, GRAVITY)) / GRAVITY
        if off > self._gravity_limit:
            mean = ", ".join(f"{value:.1f}" for value in self._mean)
            said = f"the accelerometer's mean is ({mean}) m/s² by the orientation; (0, 0, {GRAVITY:.1f}) is gravity"
            return IMU, f"{said}: turned, upside down, or in other units?"
        beyond = max(self._beyond.tolist())
        if beyond > self._slip_limit:
            said = f"angle and speed differ by {beyond:.2f} rad; {self._slip_limit:g} are allowed"
            return JOINT, f"{JOINT_NAMES[int(np.argmax(self._beyond))]}: {said}"
        dead = (self._asked > _ASKED) & (self._given < _GIVES * self._asked)
        if dead.any():
            return TORQUE, f"{JOINT_NAMES[int(np.argmax(dead))]}: its motor gives nothing of the torque commanded"
        return None


class Lean:
    """The lean of a standing robot in roll, pitch and yaw: the postures of its way, and what the sensors tell of it."""

    def __init__(self, robot: Robot, stand: Array, angle: float) -> None:
        """`stand` (12,) are the joints of the standing posture, rad; `angle` is how far it leans, rad."""
        self._robot, self._angle = robot, angle
        self._feet = foot_positions(robot, stand)
        self._weight = robot.mass * GRAVITY
        centred = self._feet - self._feet.mean(0)
        # feet that stay where they are: seen from a trunk turned by r they move by −r × p
        rows = np.cross(centred[:, None, :], np.eye(3)[None], axis=-1)  # (4, 3, 3): p × e of the unit rotation e
        self._to_rotation = np.linalg.pinv(rows.transpose(0, 2, 1).reshape(12, 3))
        self.begin()

    def begin(self) -> None:
        self._told: list[tuple[Any, Array, float, float]] = []

    def posture(self, share: float) -> Array:
        """The joints (12,), rad, at a share in [0, 1] of the lean."""
        turned = self._feet @ matrix_from_quat(quat_from_rotvec(self._rotation(share)))
        return inverse_kinematics(self._robot, turned)[0]

    def add(self, reading: Records, wanted: Array, elapsed_s: float, load: float) -> None:
        """Takes in a state (1,) of `READING`, the commanded joints (12,), and the `load` that the torques tell, N,
        NaN if none."""
        self._told.append((reading[0].copy(), wanted.copy(), elapsed_s, load))

    def verdict(self, ground: Array, ground_limit: float) -> Doubt | None:
        """What cannot be believed after the lean; None if all sensors tell of the same movement. The plane of the feet
        is turned by `ground` (2,) from the IMU's level, rad, which may be `ground_limit`."""
        readings, commanded, times, loads = zip(*self._told, strict=True)
        seen, dt = np.array(list(readings), READING), np.array(times)[:, None]
        joints, wanted = _moved(seen["joint_pos"]), _moved(np.array(commanded))
        travelled = _moved(np.cumsum(seen["joint_vel"] * dt, 0))
        feet = foot_positions(self._robot, seen["joint_pos"])
        turned = rotvec_from_quat(quat_multiply(quat_conjugate(seen["quat"][:1]), seen["quat"]))
        return (
            _joint_doubt(joints, wanted, "angle", "command")
            or _joint_doubt(travelled, joints, "speed", "angle")
            or self._imu_doubt(feet, turned, "orientation")
            or self._imu_doubt(feet, np.cumsum(seen["gyro"] * dt, 0), "gyroscope")
            or _load_doubt(float(np.mean(loads)) / self._weight, _LOAD)
            or _ground_doubt(float(np.hypot(*ground)), ground_limit)
        )

    def _rotation(self, share: float) -> Array:
        """Rotation vector (3,) of the trunk: one sine about each axis after the other."""
        rotation, at = np.zeros(3), min(3.0 * share, 3.0 - 1e-9)
        axis = int(at)
        rotation[axis] = self._angle * math.sin(2.0 * math.pi * (at - axis)) * math.sin(math.pi * (at - axis))
        return rotation

    def _imu_doubt(self, feet: Array, turned: Array, what: str) -> Doubt | None:
        """Whether the trunk turned as the legs say, by (t, 4, 3) feet and (t, 3) rotations."""
        centred = feet - feet.mean(1, keepdims=True)
        legs = _moved((centred - centred[0]).reshape(len(feet), 12) @ self._to_rotation.T)
        told = np.linalg.lstsq(legs, _moved(turned), rcond=None)[0]
        if np.abs(told - np.eye(3)).max() < _SHARE:
            return None
        shares = ", ".join(f"{axis} {value:.2f}" for axis, value in zip(_AXES, np.diag(told), strict=True))
        return IMU, f"the {what} does not turn as the legs do ({shares} of theirs): turned, frozen, or in other units?"


class LoadCheck:
    """Whether the torques of the legs bear the robot's weight on average, as it moves."""

    def __init__(self, robot: Robot) -> None:
        self._weight, self._mean = robot.mass * GRAVITY, 1.0

    def check(self, load: float, dt: float) -> Doubt | None:
        """Takes in what the legs bear, N; NaN if that is not known."""
        if math.isnan(load):
            return None
        self._mean += dt / _LOAD_S * (load / self._weight - self._mean)
        return _load_doubt(self._mean, _MOVING_LOAD)


def _load_doubt(share: float, limits: tuple[float, float]) -> Doubt | None:
    if math.isnan(share) or limits[0] < share < limits[1]:
        return None
    return TORQUE, f"by their torques the legs bear {share:.2f} of the robot's weight"


def _ground_doubt(angle: float, limit: float) -> Doubt | None:
    said = f"the IMU's level and the plane of the feet are {angle:.2f} rad apart; {limit:g} are allowed"
    return None if angle <= limit else (IMU, f"{said}: a slope, or an IMU that is turned?")


def _moved(values: Array) -> Array:
    """A movement (t, k) about its mean."""
    return values - values.mean(0)


def _joint_doubt(joints: Array, others: Array, what: str, other: str) -> Doubt | None:
    """Whether joints (t, 12) moved as others say."""
    squares = (others**2).mean(0)
    tells = squares > _LEAST_MOVE**2
    share = np.where(tells, (joints * others).mean(0) / np.where(tells, squares, 1.0), 1.0)
    j = int(np.argmax(np.abs(share - 1.0)))
    if abs(share[j] - 1.0) < _SHARE:
        return None
    return JOINT, f"{JOINT_NAMES[j]}: its {what} moved by {share[j]:.2f} of its {other}: frozen, or another joint's?"
