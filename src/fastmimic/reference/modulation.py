"""The modulation of a running motion: its limits, and the motion at other speeds.

One rule gives the limits of all motions. With its constants the motions stayed upright in `benchmarks/play.py`, with a
margin; see docs/viewer.md. At another speed a motion has the same contacts in another time. Accelerations grow with the
square of the speed and the weight does not. The cycle is therefore made executable for some speeds, and interpolated
between them.
"""

from dataclasses import astuple, dataclass, replace
from itertools import pairwise
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from fastmimic.base.errors import MotionError
from fastmimic.motion.motion import Motion
from fastmimic.reference.course import course_of
from fastmimic.robot import Robot
from fastmimic.trajectory.config import TrajectoryConfig
from fastmimic.trajectory.executable import nearest_executable

SPEED: Final = (0.9, 1.25)  # factors on the phase's rate
JOINT_SPEED_SHARE: Final = 1.1  # largest share of the joints' speed limit in a higher reference
TURN: Final = 1.0  # largest added turn rate, rad/s
TURN_ACCELERATION: Final = 0.6  # largest added centripetal acceleration, at the highest speed, m/s²
TURN_ANGLE: Final = 0.3  # largest turn of the body over a foot from mid-stance to lift-off, rad
LIFT: Final = (0.5, 1.5)  # factors on the swing height


@dataclass(frozen=True)
class Limits:
    """Ranges of a modulation: speed factor, added turn rate (rad/s) and factor on the swing height."""

    speed: tuple[float, float] = (1.0, 1.0)
    turn: tuple[float, float] = (0.0, 0.0)
    lift: tuple[float, float] = (1.0, 1.0)

    def within(self, other: "Limits") -> "Limits":
        """The intersection of both."""
        pairs = zip(astuple(self), astuple(other), strict=True)
        return Limits(*((max(a[0], b[0]), min(a[1], b[1])) for a, b in pairs))

    def hold(self, speed: float, turn: float, lift: float, slack: float = 0.0) -> bool:
        """Whether a modulation is within the ranges."""
        return all(
            low - slack <= value <= high + slack
            for (low, high), value in zip(astuple(self), (speed, turn, lift), strict=True)
        )


def limits_of(course: NDArray[Any], joint_vel: NDArray[np.float64], robot: Robot) -> Limits:
    """Limits of a cyclic motion from its `COURSE` (t,) and joint velocities (t, 12), rad/s. The joints' speeds limit
    the swing height. The turn of a foot under the body and the centripetal acceleration limit the turn rate. A
    motion in which a foot never lifts off is not modulated."""
    if course["contact"].all(axis=0).any():
        return Limits()
    used = float(np.max(np.abs(joint_vel) / robot.joint_speed_limit))
    room = max(1.0, JOINT_SPEED_SHARE / max(used, 1e-9))
    travel = float(np.hypot(*course["travel"].T).max())
    arc = float(np.abs(course["since_middle"]).max())
    turn = min(TURN, TURN_ANGLE / max(arc, 1e-9), TURN_ACCELERATION / max(SPEED[1] * travel, 1e-9))
    return Limits(SPEED, (-turn, turn), (LIFT[0], min(LIFT[1], room)))


_RATES: Final = {
    **dict.fromkeys(("lin_vel", "ang_vel", "travel"), 1),
    **dict.fromkeys(("lin_acc", "ang_acc", "leg_lin_acc", "leg_ang_acc"), 2),
}
_BLENDED: Final = ("step", "turn", "root_z", "tilt", *_RATES, "foot", "lift")


@dataclass(frozen=True, eq=False)
class Tempo:
    """A cycle at several speeds: ascending factors with 1 among them, and for each a course (t,) of `COURSE` in the
    motion's own time, which the stream scales."""

    speeds: tuple[float, ...]
    courses: tuple[NDArray[Any], ...]

    def changed(self, speed: float, own: NDArray[Any]) -> NDArray[Any]:
        """An optimised motion at another speed: `own` (t,) keeps its difference from this demonstration."""
        return _moved(self.at(speed), self.at(1.0), own, 1.0)

    def at(self, speed: float) -> NDArray[Any]:
        """The course for a speed; at 1 that of the motion itself."""
        if speed in self.speeds:
            return self.courses[self.speeds.index(speed)]
        speed = min(max(speed, self.speeds[0]), self.speeds[-1])
        for (low, high), (a, b) in zip(pairwise(self.speeds), pairwise(self.courses), strict=True):
            if low <= speed <= high:
                return _moved(a, a, b, (speed - low) / (high - low))
        return self.courses[self.speeds.index(1.0)]


def make_tempo(robot: Robot, motion: Motion, speeds: tuple[float, ...]) -> Tempo:
    """Makes a cyclic demonstration, not an optimised motion, executable at `speeds` other than 1. A speed at which no
    motion keeps the limits is left out."""
    found = {1.0: course_of(motion, robot)}
    for speed in speeds:
        try:
            course = course_of(at_speed(robot, motion, speed), robot)
        except MotionError:
            continue
        for name, power in _RATES.items():
            course[name] /= speed**power
        course["since_middle"] *= speed
        found[speed] = course
    order = tuple(sorted(found))
    return Tempo(order, tuple(found[speed] for speed in order))


def at_speed(robot: Robot, motion: Motion, speed: float) -> Motion:
    """The executable motion nearest to a cycle that is `speed` times as fast, in as many samples; its rate is no longer
    the robot's. Raises `MotionError` if there is none."""
    rates = {
        name: speed * getattr(motion, name) for name in ("rate_hz", "joint_vel", "root_lin_vel_w", "root_ang_vel_w")
    }
    config = TrajectoryConfig(keep_time=True, keep_speed=True)
    return nearest_executable(robot, replace(motion, **rates), config).motion


def _moved(course: NDArray[Any], a: NDArray[Any], b: NDArray[Any], share: float) -> NDArray[Any]:
    """A course moved by a share of the way from `a` to `b`, all (t,) of `COURSE`."""
    out = course.copy()
    for name in _BLENDED:
        out[name] += share * (b[name] - a[name])
    return out
