"""From a clip to a motion of the robot."""
