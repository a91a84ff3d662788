"""Haste: the reference's feet advance faster, its root does not."""

from dataclasses import replace

import numpy as np
import pytest

from fastmimic.motion.motion import Motion
from fastmimic.reference.regulator import motion_gains
from fastmimic.reference.regulator_config import RegulatorConfig
from fastmimic.reference.table import (
    GAIN_SAMPLES,
    advance_clocks,
    make_clocks,
    place_clocks,
    reference_table,
    world_root,
)
from fastmimic.robot import Robot
from fastmimic.runs.loading import load_motion

STEPS = 40
AWAY = np.full((1, 2), 99.0)  # where the robot is: used at starts of cycles alone


@pytest.fixture(scope="module")
def trot(robot: Robot) -> Motion:
    return load_motion("trot", robot, executable=False)


def placed(motion: Motion, table: np.ndarray, sample: int) -> np.ndarray:
    clocks = make_clocks(motion, 1)
    place_clocks(clocks, np.array([sample]), table, np.array([[1.0, 2.0, 0.5]]))
    return clocks


def root(table: np.ndarray, clocks: np.ndarray) -> np.ndarray:
    return world_root(table, clocks["sample"], clocks["origin"])[0][0, :2]


@pytest.mark.nojit
def test_feet_advance_faster_and_the_root_at_its_own_pace(trot: Motion, robot: Robot) -> None:
    table = reference_table(trot, robot)
    usual, hasty = placed(trot, table, 5), placed(trot, table, 5)
    for _ in range(STEPS):
        advance_clocks(usual, table[None], AWAY, np.zeros(1))
        advance_clocks(hasty, table[None], AWAY, np.full(1, 0.25))
    assert usual["sample"][0] == 5 + STEPS
    assert hasty["sample"][0] == 5 + STEPS + STEPS // 4
    assert hasty["ahead"][0] == STEPS // 4
    speed = float(np.linalg.norm(trot.root_lin_vel_w[:, :2], axis=1).max())
    assert np.linalg.norm(root(table, hasty) - root(table, usual)) < 0.02 * speed * STEPS * trot.dt
    np.testing.assert_allclose(hasty["origin"] - usual["origin"], np.append(hasty["held"][0], 0.0)[None], atol=1e-12)


@pytest.mark.nojit
def test_a_passage_comes_back_into_its_own_time_and_place(trot: Motion, robot: Robot) -> None:
    once = replace(trot, cycle=None)
    table = reference_table(once, robot)
    usual, hasty = placed(once, table, 0), placed(once, table, 0)
    for step in range(once.n_samples - 10):
        advance_clocks(usual, table[None], AWAY, np.zeros(1))
        advance_clocks(hasty, table[None], AWAY, np.full(1, 0.5 if step < 20 else 0.0))
    assert hasty["ahead"][0] == 0
    assert hasty["sample"][0] == usual["sample"][0]
    np.testing.assert_allclose(root(table, hasty), root(table, usual), atol=2e-3)


def test_a_passage_stays_at_its_end(trot: Motion, robot: Robot) -> None:
    once = replace(trot, cycle=None)
    table = reference_table(once, robot)
    clocks = placed(once, table, once.n_samples - 5)
    for _ in range(20):
        advance_clocks(clocks, table[None], AWAY, np.full(1, 0.5))
    assert clocks["sample"][0] == once.n_samples - 1


def test_gains_know_when_a_foot_lands_next(trot: Motion, robot: Robot) -> None:
    gains = motion_gains(trot, robot, RegulatorConfig())
    lands = np.flatnonzero((trot.contact & ~np.roll(trot.contact, 1, axis=0)).any(axis=1)) * trot.dt
    node_s = GAIN_SAMPLES * trot.dt
    for row, landing in enumerate(gains["landing"]):
        before, following = (row * node_s - lands) % trot.period_s, (lands - row * node_s) % trot.period_s
        if before.min() >= node_s:  # else a foot has landed at this node or since the one before
            assert landing == pytest.approx(following.min(), abs=node_s)
    once = motion_gains(replace(trot, cycle=None), robot, RegulatorConfig())
    assert once["landing"][-1] == 0.0
