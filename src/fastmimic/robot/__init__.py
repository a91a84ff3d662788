"""Which robot: its geometry, inertia and limits, and the kinematics and dynamics of its legs."""

from fastmimic.robot.robot import ROBOT_NAMES, Robot, load_robot

__all__ = ["ROBOT_NAMES", "Robot", "load_robot"]
