"""A short rollout of a robot, and its take."""

import pytest

from fastmimic.control.config import ControllerConfig
from fastmimic.episode.rollout import Rollout
from fastmimic.imitation.evaluate import evaluate
from fastmimic.motion.motion import Motion
from fastmimic.robot import Robot
from fastmimic.runs.loading import load_motion
from fastmimic.viewer.take import Take, rollout_take

SECONDS = 1.2


@pytest.fixture(scope="session")
def trot(a1: Robot) -> Motion:
    return load_motion("trot", a1)


@pytest.fixture(scope="session")
def rollout(trot: Motion, a1: Robot) -> Rollout:
    return evaluate(trot, a1, duration_s=SECONDS, log=True).rollout


@pytest.fixture(scope="session")
def take(rollout: Rollout, trot: Motion, a1: Robot) -> Take:
    return rollout_take(rollout, trot, a1, ControllerConfig(), "trot")
