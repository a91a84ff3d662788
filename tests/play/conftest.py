"""A motion, and a browser."""

import pytest
from fastmimic.runs.loading import load_motion

from browsing import browser
from fastmimic.motion.motion import Motion
from fastmimic.robot import Robot


@pytest.fixture(scope="session")
def trot(a1: Robot) -> Motion:
    return load_motion("trot", a1)


__all__ = ["browser"]
