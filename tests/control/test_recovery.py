"""A robot that is pushed where its motion's next foot does not reach trots until it is back in the motion."""

from dataclasses import replace

import numpy as np
import pytest

from fastmimic.control.config import ControllerConfig
from fastmimic.control.recovery import PIECE_S, recovery_gaits
from fastmimic.episode.loop import ClosedLoop, run_episodes
from fastmimic.episode.plan import Start
from fastmimic.motion.motion import Motion
from fastmimic.reference.table import (
    advance_clocks,
    make_clocks,
    place_clocks,
    reference_table,
    taken_up_at,
    world_root,
)
from fastmimic.robot import Robot
from fastmimic.runs.loading import load_motion
from fastmimic.simulation.conditions import Conditions, Disturbance

ROBOTS = 16
PUSHED_AT_S = 0.4


def own_schedule() -> ControllerConfig:
    config = ControllerConfig()
    return replace(config, gait=replace(config.gait, recovery_steps=False))


def starts(motion: Motion) -> Start:
    sample = np.arange(ROBOTS) * motion.n_samples // ROBOTS
    return Start(sample, np.zeros((ROBOTS, 12)), np.zeros((ROBOTS, 3)), np.zeros(ROBOTS, np.int64))


def pushed(robot: Robot, config: ControllerConfig, speed: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of robots that walk and are pushed to the right: which stay up for 2 s, which took recovery steps, and which are
    back in their motion at the end."""
    motion = load_motion("walk", robot)
    conditions = Conditions(disturbances=(Disturbance("side-push", (-speed * robot.mass,), PUSHED_AT_S),))
    loop = ClosedLoop(robot, motion, ROBOTS, config, conditions=conditions)
    loop.place(starts(motion))
    recovered = np.zeros(ROBOTS, bool)
    for _ in range(1200):
        loop.apply(loop.control())
        recovered |= loop.controller.memory["recovering"] == 1
        loop.score()
    return loop.scorer.tallies["fallen"] == 0, recovered, loop.controller.memory["recovering"] == 0


@pytest.mark.slow
def test_recovery_steps_catch_robots_that_fall_otherwise(robot: Robot) -> None:
    up, recovered, back = pushed(robot, ControllerConfig(), 1.0)
    fallen, never, _ = pushed(robot, own_schedule(), 1.0)
    assert not never.any()
    assert recovered.sum() >= 8
    assert (up & back).sum() >= fallen.sum() + 3


def test_a_pace_is_taken_up_again(robot: Robot) -> None:
    """Its feet stand unlike a trot's: the nearest sample is farther off than a walk's."""
    motion = load_motion("pace", robot)
    push = Disturbance("side-push", (1.0 * robot.mass,), PUSHED_AT_S)
    loop = ClosedLoop(robot, motion, ROBOTS, conditions=Conditions(disturbances=(push,)))
    loop.place(starts(motion))
    recovered = np.zeros(ROBOTS, bool)
    for _ in range(2000):
        loop.apply(loop.control())
        recovered |= loop.controller.memory["recovering"] > 0
        loop.score()
    up = loop.scorer.tallies["fallen"] == 0
    assert recovered.sum() >= 4
    assert up.sum() >= ROBOTS - 2
    assert np.all(loop.controller.memory["recovering"][up] == 0)
    assert np.all(loop.scorer.tallies["jump"][up] < 2.0), "where a motion is taken up is no drift"


def test_a_motion_is_taken_up_in_its_heading_where_the_robot_is(robot: Robot) -> None:
    motion = load_motion("turn", robot)
    table = reference_table(motion, robot)[None]
    clocks = make_clocks(motion, 2)
    place_clocks(clocks, np.array([40, motion.n_samples - 2]), table[0], np.array([[1.0, 2.0, 0.3], [0.0, 0.0, -1.0]]))
    _, before = world_root(table[0], clocks["sample"], clocks["origin"])
    xy = np.array([[1.1, 2.0, 0.0], [0.0, 0.3, 0.0]])
    advance_clocks(clocks, table, xy, np.array([taken_up_at(100), taken_up_at(5)]))
    np.testing.assert_array_equal(clocks["sample"], [101, 6])
    position, after = world_root(table[0], clocks["sample"], clocks["origin"])
    step = np.linalg.norm(motion.root_lin_vel_w[:, :2], axis=1).max() * motion.dt
    assert np.all(np.linalg.norm(position[:, :2] - xy[:, :2], axis=1) < 2 * step)
    np.testing.assert_allclose(np.abs(np.sum(before * after, axis=1)), 1.0, atol=5e-4)
    np.testing.assert_allclose(clocks["jump"], [0.1, 0.3], atol=0.02)


def test_an_undisturbed_robot_keeps_to_its_schedule(robot: Robot) -> None:
    motion = load_motion("walk", robot)
    here, there = (
        run_episodes(robot, motion, start=starts(motion), duration_s=2.0, config=config)
        for config in (ControllerConfig(), own_schedule())
    )
    np.testing.assert_array_equal(here.reward, there.reward)


@pytest.mark.parametrize("name", ["walk", "turn", "side-step"])
def test_the_trot_is_the_motions_own_in_speed_and_posture(robot: Robot, name: str) -> None:
    motion = load_motion(name, robot)
    trots = recovery_gaits(motion, robot, ControllerConfig().regulator)[0]
    assert len(trots) == 1
    assert motion.cycle is not None
    trot, period = trots[0], motion.period_s
    span = len(trot) * motion.dt
    yaw = 2 * np.arctan2(trot["root_quat"][:, 3], trot["root_quat"][:, 0])
    assert (yaw[-1] - yaw[0]) / (span - motion.dt) == pytest.approx(motion.cycle[2] / period, abs=0.01)
    assert trot["root_pos"][:, 2].mean() == pytest.approx(motion.root_pos_w[:, 2].mean(), abs=1e-3)
    assert np.all(trot["contact"].sum(axis=1) >= 2)
    assert np.array_equal(trot["contact"][:, 0], trot["contact"][:, 3]), "diagonal legs step together"
    if name != "turn":
        speed = np.hypot(*(trot["root_pos"][-1] - trot["root_pos"][0])[:2]) / (span - motion.dt)
        assert speed == pytest.approx(np.hypot(*motion.cycle[:2]) / period, abs=0.01)


def test_a_passage_has_a_trot_for_each_second(robot: Robot) -> None:
    cycle = load_motion("walk", robot)
    passage = replace(cycle, cycle=None, animal=None)
    assert len(recovery_gaits(passage, robot, ControllerConfig().regulator)[0]) == max(
        1, round(passage.period_s / PIECE_S)
    )
