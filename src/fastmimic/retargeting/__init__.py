"""Turns a clip into a motion of the robot."""
