"""Whether a robot on the wire can be the one that is meant."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from fastmimic.robot import Robot

BEYOND_LIMITS: Final = 0.3
"""Rad, by which an encoder may be off."""


def impossible_joint(robot: Robot, joint_pos: NDArray[np.float64]) -> str:
    """What a user is told if a joint is where this robot's cannot be; empty if all can.

    Args:
        robot: the one that is meant.
        joint_pos: (12,) rad.
    """
    off = np.maximum(robot.joint_lower - joint_pos, joint_pos - robot.joint_upper)
    j = int(np.argmax(off))
    if off[j] <= BEYOND_LIMITS:
        return ""
    return (
        f"{robot.joint_names[j]} is at {joint_pos[j]:.2f} rad, outside the {robot.name}'s {robot.joint_lower[j]:.2f} …"
        f" {robot.joint_upper[j]:.2f} rad: another robot, or its joints are not calibrated"
    )
