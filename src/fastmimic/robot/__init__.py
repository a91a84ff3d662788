"""A robot's geometry, inertia and limits, and its kinematics and dynamics."""

from fastmimic.robot.robot import ROBOT_CHOICES, ROBOT_NAMES, Robot, load_robot

__all__ = ["ROBOT_CHOICES", "ROBOT_NAMES", "Robot", "load_robot"]
