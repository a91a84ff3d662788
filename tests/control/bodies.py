"""Robots of which only the size counts."""

from types import SimpleNamespace
from typing import Any

import numpy as np

from fastmimic.robot.robot import A1_JOINT_INERTIA, A1_LEG_LENGTH_M


def body(mass: float, joint_inertia: float = A1_JOINT_INERTIA) -> Any:
    """One of that mass, kg, whose joints have to move so much, kg·m²."""
    return SimpleNamespace(mass=mass, joint_inertia=np.full(12, joint_inertia), leg_length=A1_LEG_LENGTH_M)
