"""A robot, a motion and the way into it; made once, since a way takes seconds to make."""

import pytest

from deploy.rig import Rig
from fastmimic.control.config import ControllerConfig
from fastmimic.deploy.sequence import MotionSequence, make_sequence
from fastmimic.motion.motion import Motion
from fastmimic.reference.standing import standing
from fastmimic.robot import Robot
from fastmimic.runs.loading import load_motion


@pytest.fixture(scope="session")
def trot(a1: Robot) -> Motion:
    return load_motion("trot", a1)


@pytest.fixture(scope="session")
def way(a1: Robot, trot: Motion) -> MotionSequence:
    return make_sequence(a1, trot, ControllerConfig())


@pytest.fixture(scope="session")
def standstill(a1: Robot) -> MotionSequence:
    return make_sequence(a1, standing(a1), ControllerConfig())


@pytest.fixture
def trotting(a1: Robot, way: MotionSequence) -> Rig:
    """A deployment of the trot in lock step."""
    return Rig(a1, way)


@pytest.fixture
def stands(a1: Robot, standstill: MotionSequence) -> Rig:
    """A deployment that only stands up, stands and sits down: short."""
    return Rig(a1, standstill)
