"""A motion at another speed: the same poses in another time, with the trunk balanced for that speed. Accelerations grow
with the square of the speed and the weight does not. The cycle is therefore balanced, as in retargeting, for some
speeds, and interpolated between them."""

from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Final

from numpy.typing import NDArray

from fastmimic.motion.motion import Motion
from fastmimic.reference.course import course_of
from fastmimic.retargeting.config import RetargetConfig
from fastmimic.retargeting.consistency import Consistency
from fastmimic.retargeting.cycle import TrunkTrack
from fastmimic.retargeting.pose import solve_pose
from fastmimic.robot import Robot

_RATES: Final = {
    "lin_vel": 1,
    "ang_vel": 1,
    "travel": 1,
    "lin_acc": 2,
    "ang_acc": 2,
    "leg_lin_acc": 2,
    "leg_ang_acc": 2,
}
_TIMES: Final = ("remaining", "since_middle")
_BLENDED: Final = ("step", "turn", "root_z", "tilt", *_RATES, "foot", "lift")


@dataclass(frozen=True, eq=False)
class Tempo:
    """A cycle at several speeds: ascending factors with 1 among them, and for each a course (t,) of `COURSE` in the
    motion's own time, which the stream scales."""

    speeds: tuple[float, ...]
    courses: tuple[NDArray[Any], ...]

    def changed(self, speed: float, own: NDArray[Any]) -> NDArray[Any]:
        """An optimised motion at another speed: `own` (t,) keeps its difference from this demonstration."""
        demonstration = self.at(1.0)
        out = self.at(speed).copy()
        for name in _BLENDED:
            out[name] += own[name] - demonstration[name]
        return out

    def at(self, speed: float) -> NDArray[Any]:
        """The course for a speed; at 1 that of the motion itself."""
        if speed in self.speeds:
            return self.courses[self.speeds.index(speed)]
        speed = min(max(speed, self.speeds[0]), self.speeds[-1])
        for (low, high), (a, b) in zip(pairwise(self.speeds), pairwise(self.courses), strict=True):
            if low <= speed <= high:
                return _between(a, b, (speed - low) / (high - low))
        return self.courses[self.speeds.index(1.0)]


def make_tempo(robot: Robot, motion: Motion, speeds: tuple[float, ...]) -> Tempo:
    """Balances a cyclic demonstration, not an optimised motion, for `speeds` other than 1."""
    found = {1.0: course_of(motion, robot)}
    for speed in speeds:
        course = course_of(at_speed(robot, motion, speed), robot)
        for name, power in _RATES.items():
            course[name] /= speed**power
        for name in _TIMES:
            course[name] *= speed
        found[speed] = course
    order = tuple(sorted(found))
    return Tempo(order, tuple(found[speed] for speed in order))


def at_speed(robot: Robot, motion: Motion, speed: float, config: RetargetConfig | None = None) -> Motion:
    """The cycle `speed` times as fast, in as many samples, with its trunk balanced for that speed. The foot paths stay.
    The motion's rate is no longer the robot's."""
    config = (config or RetargetConfig()).for_robot(robot)
    feet_w = motion.foot_pos_w
    consistency = Consistency(robot, TrunkTrack.of(motion), motion.contact, motion.rate_hz * speed, config)
    balanced = consistency.balanced_over(feet_w)
    pose = solve_pose(robot, balanced, feet_w, float(balanced.root_z.mean()), config)
    return consistency.motion(pose, balanced)


def _between(a: NDArray[Any], b: NDArray[Any], share: float) -> NDArray[Any]:
    out = a.copy()
    for name in _BLENDED:
        out[name] += share * (b[name] - a[name])
    return out
