"""A pushed robot steps earlier than its motion does, and an undisturbed one never."""

from dataclasses import replace

import numpy as np
import pytest

from fastmimic.control.config import ControllerConfig, pack_config
from fastmimic.control.controller import gains_of
from fastmimic.control.joint_commands import keep_in_reach
from fastmimic.episode.loop import ClosedLoop
from fastmimic.episode.plan import Start, nominal_start
from fastmimic.reference.standing import standing
from fastmimic.reference.table import GAIN_SAMPLES
from fastmimic.robot import Robot
from fastmimic.robot.kinematics import foot_positions, leg_inverse
from fastmimic.robot.state import pack_model
from fastmimic.runs.loading import load_motion
from fastmimic.simulation.conditions import Conditions, Disturbance

ROBOTS = 16
PUSHED_AT_S = 0.4


def pushed(robot: Robot, config: ControllerConfig, speed: float) -> tuple[np.ndarray, float]:
    """Which robots stay up for 2 s after a push to the right that changes their speed, and their greatest haste."""
    motion = load_motion("turn", robot)
    sample = np.arange(ROBOTS) * motion.n_samples // ROBOTS
    start = Start(sample, np.zeros((ROBOTS, 12)), np.zeros((ROBOTS, 3)), np.zeros(ROBOTS, np.int64))
    conditions = Conditions(disturbances=(Disturbance("side-push", (-speed * robot.mass,), PUSHED_AT_S),))
    loop = ClosedLoop(robot, motion, ROBOTS, config, conditions=conditions)
    loop.place(start)
    most = 0.0
    for _ in range(1200):
        loop.apply(loop.control())
        most = max(most, float(loop.controller.memory["haste"].max()))
        loop.score()
    return loop.scorer.tallies["fallen"] == 0, most


def in_own_time() -> ControllerConfig:
    config = ControllerConfig()
    return replace(config, gait=replace(config.gait, most_haste=0.0))


def test_an_undisturbed_robot_keeps_the_motions_time(robot: Robot) -> None:
    up, most = pushed(robot, ControllerConfig(), 0.0)
    assert up.all()
    assert most == 0.0


@pytest.mark.slow
def test_steps_in_time_catch_robots_that_fall_otherwise(robot: Robot) -> None:
    up, most = pushed(robot, ControllerConfig(), 1.4)
    fallen, none = pushed(robot, in_own_time(), 1.4)
    assert most == ControllerConfig().gait.most_haste
    assert none == 0.0
    assert up.sum() >= fallen.sum() + 4


def test_the_trunk_follows_standing_feet_that_made_haste(robot: Robot) -> None:
    """It stayed beside them for as long as they stood, and fell into the next step of one side."""
    motion = standing(robot)
    loop = ClosedLoop(robot, motion, 1, ControllerConfig())
    loop.place(nominal_start(1))
    loop.controller.memory["lag"][:] = (0.0, 0.02)
    found = []
    for _ in range(750):
        loop.apply(loop.control())
        loop.score()
        found.append(float(loop.simulation.observation["root_pos"][0, 1]))
    assert max(map(abs, found)) > 0.008
    assert abs(found[-1]) < 0.002


def test_a_robot_that_stands_is_not_hurried_to_a_step_far_ahead(robot: Robot) -> None:
    """It would run through the second in which an animal sits, and then on in haste."""
    motion = load_motion("jump", robot)
    landing = gains_of(motion, robot, ControllerConfig())["landing"]
    stands = int(np.flatnonzero(landing < 0.5)[0]) * GAIN_SAMPLES
    conditions = Conditions(disturbances=(Disturbance("side-push", (-0.2 * robot.mass,), 0.02),))
    loop = ClosedLoop(robot, motion, 1, ControllerConfig(), conditions=conditions)
    loop.place(nominal_start(1))
    for _ in range(stands):
        loop.apply(loop.control())
        loop.score()
        assert loop.controller.memory["haste"][0] == 0.0
    assert stands > 100
    assert loop.scorer.tallies["fallen"][0] == 0


@pytest.mark.nojit
def test_a_foot_beyond_reach_keeps_its_height(robot: Robot) -> None:
    config, model = pack_config(ControllerConfig(), robot)[0], pack_model(robot)[0]
    tilt = np.array([[1.0, 0.0, 0.0], [0.0, np.cos(0.2), -np.sin(0.2)], [0.0, np.sin(0.2), np.cos(0.2)]])
    for leg in range(4):
        foot = foot_positions(robot, np.tile([0.0, 0.8, -1.6], 4)[None])[0, leg]
        near = foot.copy()
        keep_in_reach(config, model, tilt, leg, near)
        np.testing.assert_array_equal(near, foot)
        far = foot + tilt.T @ np.array([0.3, 0.1, 0.0])
        moved = far.copy()
        keep_in_reach(config, model, tilt, leg, moved)
        assert tilt[2] @ moved == pytest.approx(tilt[2] @ foot, abs=1e-9)
        assert np.linalg.norm(moved - foot) < np.linalg.norm(far - foot)
        below = np.array([*(robot.geometry[leg][[0, 1]] + [robot.geometry[leg][4], 0.0]), -1.0])
        keep_in_reach(config, model, np.eye(3), leg, below)
        assert np.isfinite(below).all()
        knee = leg_inverse(robot.geometry[leg], *moved)[2]
        assert knee == pytest.approx(robot.joint_upper[3 * leg + 2] - ControllerConfig().joint_margin, abs=1e-6)
