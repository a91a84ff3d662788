"""Scaling of parameters from an A1 to another robot. The constants have all digits, so that each ratio of an A1 is
exactly 1; `tests/control/test_config.py` checks them."""

from typing import Final

import numpy as np

from fastmimic.robot.robot import Robot

A1_MASS_KG: Final = 12.453000000000001
A1_JOINT_INERTIA: Final = 0.037411360960741595  # mean of `Robot.joint_inertia`, kg·m²
A1_LEG_LENGTH_M: Final = 0.4


def mass_ratio(robot: Robot) -> float:
    """An A1's mass over the robot's."""
    return A1_MASS_KG / robot.mass


def joint_ratio(robot: Robot) -> float:
    """Joint inertia of the robot over an A1's. Gains in this ratio keep frequency and damping of the legs."""
    return float(np.mean(robot.joint_inertia)) / A1_JOINT_INERTIA


def length_ratio(robot: Robot) -> float:
    """The robot's leg length over an A1's."""
    return robot.leg_length / A1_LEG_LENGTH_M
