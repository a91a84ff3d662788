"""A motion."""

import pytest

from fastmimic.motion.motion import Motion
from fastmimic.robot import Robot
from fastmimic.runs.loading import load_motion


@pytest.fixture(scope="session")
def trot(a1: Robot) -> Motion:
    return load_motion("trot", a1)
