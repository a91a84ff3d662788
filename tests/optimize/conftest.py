"""A small optimisation problem: an easy gait, half a second an episode."""

from collections.abc import Callable

import pytest

from control.motions import gait
from fastmimic.motion.motion import Motion
from fastmimic.optimize.problem import ImitationProblem, Objective
from fastmimic.primitive import MotionDmp
from fastmimic.robot import Robot

EPISODE_S = 0.6


@pytest.fixture(scope="session")
def demonstration(robot: Robot) -> Motion:
    return gait(robot, (0.3, 0.05), 0.4, n_samples=200)


@pytest.fixture(scope="session")
def dmp(demonstration: Motion, robot: Robot) -> MotionDmp:
    return MotionDmp.fit(demonstration, robot)


@pytest.fixture(scope="session")
def make_problem(robot: Robot, demonstration: Motion, dmp: MotionDmp) -> Callable[..., ImitationProblem]:
    def make(workers: int = 1, **objective: float) -> ImitationProblem:
        settings = Objective(**{"duration_s": EPISODE_S, **objective})
        return ImitationProblem(robot, demonstration, dmp, objective=settings, workers=workers)

    return make


@pytest.fixture(scope="session")
def problem(make_problem: Callable[..., ImitationProblem]) -> ImitationProblem:
    return make_problem()
