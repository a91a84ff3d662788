"""The order of legs and joints, used everywhere (see the package docstring for the rest)."""

from typing import Final

LEGS: Final = ("FR", "FL", "RR", "RL")
JOINTS_PER_LEG: Final = ("abduction", "hip", "knee")
JOINT_NAMES: Final = tuple(f"{leg}_{joint}" for leg in LEGS for joint in JOINTS_PER_LEG)
LEFT: Final = (False, True, False, True)
FRONT: Final = (True, True, False, False)
GRAVITY: Final = 9.81
