"""The order of legs and joints, and the bounds of motions, used everywhere (see the package docstring for the rest)."""

from typing import Final

LEGS: Final = ("FR", "FL", "RR", "RL")
JOINTS_PER_LEG: Final = ("abduction", "hip", "knee")
JOINT_NAMES: Final = tuple(f"{leg}_{joint}" for leg in LEGS for joint in JOINTS_PER_LEG)
LEFT: Final = (False, True, False, True)
FRONT: Final = (True, True, False, False)
GRAVITY: Final = 9.81
GROUND_FRICTION: Final = 0.8  # of the simulated floor, sliding
LARGEST: Final = 1e5  # in m, rad and per second; a larger number in a motion means a damaged file
RATE_RANGE_HZ: Final = (1.0, 10_000.0)  # of a motion
