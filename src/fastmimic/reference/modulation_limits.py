"""One rule for the limits of a motion's modulation. With these constants the motions stayed upright in
`benchmarks/play.py`, with a margin; see docs/viewer.md."""

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from fastmimic.robot import Robot

SPEED: Final = (0.9, 1.25)  # factors on the phase's rate
JOINT_SPEED_SHARE: Final = 1.1  # largest share of the joints' speed limit in a faster or higher reference
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
        return Limits(_common(self.speed, other.speed), _common(self.turn, other.turn), _common(self.lift, other.lift))

    def hold(self, speed: float, turn: float, lift: float, slack: float = 0.0) -> bool:
        """Whether a modulation is within the ranges."""
        return all(
            low - slack <= value <= high + slack
            for (low, high), value in zip((self.speed, self.turn, self.lift), (speed, turn, lift), strict=True)
        )


def _common(a: tuple[float, float], b: tuple[float, float]) -> tuple[float, float]:
    return max(a[0], b[0]), min(a[1], b[1])


def limits_of(course: NDArray[Any], joint_vel: NDArray[np.float64], robot: Robot) -> Limits:
    """Limits of a cyclic motion from its `COURSE` (t,) and joint velocities (t, 12), rad/s. The joints' speeds limit
    speed and swing height. The turn of a foot under the body and the centripetal acceleration limit the turn rate. A
    motion in which a foot never lifts off is not modulated."""
    if course["contact"].all(axis=0).any():
        return Limits()
    used = float(np.max(np.abs(joint_vel) / robot.joint_speed_limit))
    room = max(1.0, JOINT_SPEED_SHARE / max(used, 1e-9))
    travel = float(np.hypot(*course["travel"].T).max())
    arc = float(np.abs(course["since_middle"]).max())
    fastest = min(SPEED[1], room)
    turn = min(TURN, TURN_ANGLE / max(arc, 1e-9), TURN_ACCELERATION / max(fastest * travel, 1e-9))
    return Limits((SPEED[0], fastest), (-turn, turn), (LIFT[0], min(LIFT[1], room)))
