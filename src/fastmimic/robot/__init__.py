"""Which robot: its geometry, inertia and limits, and the kinematics and dynamics of its legs."""

from fastmimic.robot.builtin import ROBOT_CHOICES, ROBOT_NAMES, load_robot
from fastmimic.robot.robot import Robot

__all__ = ["ROBOT_CHOICES", "ROBOT_NAMES", "Robot", "load_robot"]
