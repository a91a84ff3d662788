"""Robots of which only the size counts."""

from types import SimpleNamespace
from typing import Any

import numpy as np

from fastmimic.control.config import REFERENCE_JOINT_INERTIA


def body(mass: float, joint_inertia: float = REFERENCE_JOINT_INERTIA) -> Any:
    """One of that mass, kg, whose joints have to move so much, kg·m²."""
    return SimpleNamespace(mass=mass, joint_inertia=np.full(12, joint_inertia))
