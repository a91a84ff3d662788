"""A robot's geometry, inertia and limits, and its kinematics and dynamics."""

from fastmimic.robot.builtin import ROBOT_CHOICES, ROBOT_NAMES, load_robot
from fastmimic.robot.robot import Robot

__all__ = ["ROBOT_CHOICES", "ROBOT_NAMES", "Robot", "load_robot"]
