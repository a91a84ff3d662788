"""Whether a robot's sensors can be believed: against each other in every period, and by a lean before it steps.

In every period the gyroscope is held against the orientation, the accelerometer against gravity, the speed of each
joint against its angle, and nothing may stand still while something moves. What these cannot tell (axes that are
swapped, a mounting that is turned, torques in other units) the robot finds out while it stands: it leans in roll,
pitch and yaw on four feet, and legs, IMU and torques must tell of the same movement.
"""

import math
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from fastmimic.base.arrays import Array
from fastmimic.base.conventions import GRAVITY, JOINT_NAMES
from fastmimic.base.rotations import (
    matrix_from_quat,
    quat_conjugate,
    quat_from_rotvec,
    quat_multiply,
    rotvec_from_quat,
)
from fastmimic.robot import Robot
from fastmimic.robot.kinematics import foot_positions, inverse_kinematics
from fastmimic.robot.state import READING

IMU, JOINT, TORQUE = "imu", "joint_sensor", "torque_sensor"  # as in `StopReason`
LEAN_S: Final = 1.8
_TURN_S, _SLIP_S, _GRAVITY_S = 2.0, 0.2, 0.5  # time constants in which differences are forgotten
_UNTIMELY: Final = 0.3  # share of a joint's movement that angle and speed may differ by: states arrive irregularly
_GAP_S: Final = 0.01  # after a longer gap between two states, what happened meanwhile is not judged
_STILL: Final = 10  # readings of the same bits in a row; an IMU of 100 Hz gives five
_IMU_FIELDS: Final = "quat", "gyro", "accel"
_IMU_WORDS: Final = "orientation", "gyroscope", "accelerometer"
_LEAST_MOVE: Final = 0.01  # rad, root mean square; a joint that moves less in the lean tells nothing
_SHARE: Final = 0.5  # by which a movement may be smaller or greater than another sensor's
_LOAD: Final = 0.5, 1.8  # shares of the weight that the legs may bear by their torques, standing
_MOVING_LOAD: Final = 0.3, 2.5  # the same, as a mean over `_LOAD_S` of the motion
_LOAD_S: Final = 0.4
_AXES: Final = "roll", "pitch", "yaw"

Doubt = tuple[str, str]
"""What cannot be believed (`IMU`, `JOINT` or `TORQUE`), and a line that says why."""


class Senses:
    """Compares the sensors of one robot with each other, period by period."""

    def __init__(self, turn: float, gravity: float, slip: float, frozen: float) -> None:
        """`turn`: of the orientation beyond the gyroscope's, rad; `gravity`: of the mean acceleration beyond gravity, a
        share of it; `slip`: of a joint's angle beyond its speed's integral and a share of its way, rad; `frozen`: of
        other joints while an IMU's reading stands still, or of a joint's leg or command while the joint's does, rad."""
        self._turn_limit, self._gravity_limit, self._slip_limit, self._frozen = turn, gravity, slip, frozen
        self.reset()

    def reset(self) -> None:
        self._last: NDArray[Any] | None = None
        self._turn, self._slip, self._path = np.zeros(3), np.zeros(12), np.zeros(12)
        self._still = np.zeros(15, np.int64)  # readings in a row of the same bits: of the IMU's three, and by joint

    def check(self, reading: NDArray[Any], wanted: Array, elapsed_s: float) -> Doubt | None:
        """What is wrong with a reading (1,) of `READING`, None if it fits. It came `elapsed_s` after the last one, 0 if
        it is that. `wanted` (12,) are the joint angles of the last command, rad."""
        now = reading[0]
        if self._last is None:
            self._begin(now, wanted)
        elif elapsed_s == 0.0:
            return None
        else:
            self._compare(now, self._last, elapsed_s)
        found = self._frozen_sensor(now, wanted) or self._contradiction()
        self._last = now.copy()
        return found

    def _begin(self, now: Any, wanted: Array) -> None:
        self._mean = _in_world(now["quat"].tolist(), now["accel"].tolist())
        self._joints_then = np.tile(now["joint_pos"], (15, 1))  # when each of the readings changed
        self._wanted_then = wanted.copy()  # when the joint's reading changed

    def _compare(self, now: Any, last: Any, elapsed_s: float) -> None:
        """Adds up what the sensors say differently since the last reading."""
        self._still += 1
        for i, name in enumerate(_IMU_FIELDS):
            if now[name].tobytes() != last[name].tobytes():
                self._still[i] = 0
        joints = (now["joint_pos"] != last["joint_pos"]) | (now["joint_vel"] != last["joint_vel"])
        self._still[3:][joints] = 0
        self._joints_then[self._still == 0] = now["joint_pos"]
        if not 0.0 < elapsed_s <= _GAP_S:
            return
        turn, slip, mean = (math.exp(-elapsed_s / time) for time in (_TURN_S, _SLIP_S, _GRAVITY_S))
        turned = _small_turn(last["quat"].tolist(), now["quat"].tolist())
        self._turn = turn * (self._turn + turned - 0.5 * elapsed_s * (last["gyro"] + now["gyro"]))
        went = 0.5 * elapsed_s * (last["joint_vel"] + now["joint_vel"])
        moved = now["joint_pos"] - last["joint_pos"]
        self._slip = slip * (self._slip + moved - went)
        self._path = slip * (self._path + np.maximum(np.abs(moved), np.abs(went)))
        self._mean = mean * self._mean + (1.0 - mean) * _in_world(now["quat"].tolist(), now["accel"].tolist())

    def _frozen_sensor(self, now: Any, wanted: Array) -> Doubt | None:
        """A sensor that gives the same bits while others, or the command, say that something moves."""
        np.copyto(self._wanted_then, wanted, where=self._still[3:] == 0)
        if self._still.max() < _STILL:
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
        turn = math.hypot(*self._turn.tolist())
        if turn > self._turn_limit:
            return IMU, f"orientation and gyroscope differ by {turn:.2f} rad; {self._turn_limit:g} are allowed"
        off = math.dist(self._mean.tolist(), (0.0, 0.0, GRAVITY)) / GRAVITY
        if off > self._gravity_limit:
            mean = ", ".join(f"{value:.1f}" for value in self._mean)
            said = f"the accelerometer's mean is ({mean}) m/s² by the orientation; (0, 0, {GRAVITY:.1f}) is gravity"
            return IMU, f"{said}: turned, upside down, or in other units?"
        beyond = np.abs(self._slip) - _UNTIMELY * self._path
        j = int(np.argmax(beyond))
        if beyond[j] > self._slip_limit:
            said = f"angle and speed differ by {beyond[j]:.2f} rad; {self._slip_limit:g} are allowed"
            return JOINT, f"{JOINT_NAMES[j]}: {said}"
        return None


class Lean:
    """The lean of a standing robot in roll, pitch and yaw: the postures of its way, and what the sensors tell of it."""

    def __init__(self, robot: Robot, stand: Array, angle: float) -> None:
        """`stand` (12,) are the joints of the standing posture, rad; `angle` is how far it leans, rad."""
        self._robot, self._angle = robot, angle
        self._feet = foot_positions(robot, stand[None])[0]
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
        return inverse_kinematics(self._robot, turned[None])[0][0]

    def add(self, reading: NDArray[Any], wanted: Array, elapsed_s: float, load: float) -> None:
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
        feet = np.stack([foot_positions(self._robot, q[None])[0] for q in seen["joint_pos"]])
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
        said = f"the {what} does not turn as the legs do ({shares} of theirs)"
        return IMU, f"{said}: turned, frozen, or in other units?"


class LoadCheck:
    """Whether the torques of the legs bear the robot's weight on average, as it moves."""

    def __init__(self, robot: Robot) -> None:
        self._weight = robot.mass * GRAVITY
        self.reset()

    def reset(self) -> None:
        self._mean = 1.0

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


def _small_turn(before: list[float], after: list[float]) -> Array:
    """Rotation vector (3,) between two quaternions, body frame, to first order in the angle."""
    (a, b, c, d), (w, x, y, z) = before, after
    turned = 2.0 * math.copysign(1.0, a * w + b * x + c * y + d * z)
    return np.array(
        [
            turned * (a * x - b * w - c * z + d * y),
            turned * (a * y + b * z - c * w - d * x),
            turned * (a * z - b * y + c * x - d * w),
        ]
    )


def _in_world(quat: list[float], vector: list[float]) -> Array:
    """A vector of the body's frame in the world's."""
    (w, x, y, z), (a, b, c) = quat, vector
    p, q, r = 2.0 * (y * c - z * b), 2.0 * (z * a - x * c), 2.0 * (x * b - y * a)
    return np.array([a + w * p + y * r - z * q, b + w * q + z * p - x * r, c + w * r + x * q - y * p])


def _ground_doubt(angle: float, limit: float) -> Doubt | None:
    if angle <= limit:
        return None
    said = f"the IMU's level and the plane of the feet are {angle:.2f} rad apart; {limit:g} are allowed"
    return IMU, f"{said}: a slope, or an IMU that is turned?"


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
    said = f"{JOINT_NAMES[j]}: its {what} moved by {share[j]:.2f} of its {other}"
    return JOINT, f"{said}: frozen, or another joint's?"
