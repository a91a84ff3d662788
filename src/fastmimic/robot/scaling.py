"""How parameters with the values of an A1 are scaled to another robot.

The constants are the A1's own figures with all their digits: each ratio of an A1 is then exactly 1, and no parameter is
rounded. `tests/control/test_config.py` holds them to its model.
"""

from typing import Final

import numpy as np

from fastmimic.robot.robot import Robot

A1_MASS_KG: Final = 12.453000000000001
A1_JOINT_INERTIA: Final = 0.037411360960741595
"""Mean of `Robot.joint_inertia`, kg·m²."""
A1_LEG_LENGTH_M: Final = 0.4


def mass_ratio(robot: Robot) -> float:
    """An A1's mass over the robot's."""
    return A1_MASS_KG / robot.mass


def joint_ratio(robot: Robot) -> float:
    """What the robot's joints move over what an A1's move: with gains in this ratio, frequency and damping of the legs
    are the same."""
    return float(np.mean(robot.joint_inertia)) / A1_JOINT_INERTIA


def length_ratio(robot: Robot) -> float:
    """The robot's leg length over an A1's."""
    return robot.leg_length / A1_LEG_LENGTH_M
