"""Recovery: the controller's reference yields to a robot that was pushed, and is nobody's business otherwise."""

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from control.motions import gait
from fastmimic.base.errors import ConfigError
from fastmimic.control.config import ControllerConfig, default_config, pack_config
from fastmimic.control.config_parts import RecoveryConfig
from fastmimic.episode.loop import run_episodes
from fastmimic.episode.plan import Start
from fastmimic.episode.rollout import Rollout
from fastmimic.motion.motion import Motion
from fastmimic.reference.table import advance_clocks, advance_recovering, make_clocks, reference_table
from fastmimic.robot import Robot
from fastmimic.robot.state import OBSERVATION
from fastmimic.runs.loading import load_motion
from fastmimic.simulation.conditions import Conditions, Disturbance


@pytest.fixture(scope="module")
def motion(robot: Robot) -> Motion:
    return gait(robot, (0.4, 0.0), 0.0, n_samples=200)


def with_recovery(**settings: Any) -> ControllerConfig:
    return dataclasses.replace(default_config(), recovery=RecoveryConfig(enabled=True, **settings))


class Walk:
    """One clock, and a robot that is where and as fast as it is told, relative to its reference's start."""

    def __init__(self, robot: Robot, motion: Motion, config: ControllerConfig) -> None:
        self.config = pack_config(config, robot)
        self.tables = reference_table(motion, robot)[None]
        self.clocks, self.seen = make_clocks(motion, 1), np.zeros(1, OBSERVATION)

    def steps(self, count: int, velocity_error: float, aside: float = 0.0) -> NDArray[Any]:
        for _ in range(count):
            ref = self.tables[0, self.clocks["sample"][0]]
            self.seen["lin_vel"][0] = ref["lin_vel"]
            self.seen["lin_vel"][0, 1] += velocity_error
            self.seen["root_pos"][0, :2] = self.clocks["origin"][0, :2] + ref["root_pos"][:2]
            self.seen["root_pos"][0, 1] = aside
            advance_recovering(self.config, self.clocks, self.tables, self.seen)
        return self.clocks[0]


class TestClock:
    def test_goes_as_ever_where_nothing_is_wrong(self, robot: Robot, motion: Motion) -> None:
        walk = Walk(robot, motion, with_recovery(phase_rate=0.0))
        plain = walk.clocks.copy()
        for _ in range(450):
            walk.steps(1, 0.1)
            advance_clocks(plain, walk.tables, walk.seen["root_pos"])
        assert plain.tobytes() == walk.clocks.tobytes()

    def test_begins_above_one_error_and_ends_below_another(self, robot: Robot, motion: Motion) -> None:
        walk = Walk(robot, motion, with_recovery())
        found = [int(walk.steps(1, error)["recovering"]) for error in (0.3, 0.4, 0.3, 0.2, 0.1, 0.3)]
        assert found == [0, 1, 1, 1, 0, 0]

    def test_the_reference_comes_to_the_robot(self, robot: Robot, motion: Motion) -> None:
        walk = Walk(robot, motion, with_recovery(resync_time=0.02))
        assert walk.steps(1, 0.0, 0.5)["origin"][1] == 0.0
        after = walk.steps(10, 0.5, 0.5)  # one time constant
        assert 0.5 * (1 - np.exp(-1)) < after["origin"][1] < 0.5
        assert after["jump"] == pytest.approx(after["origin"][1], rel=1e-4)
        assert walk.steps(1, 0.5, 0.5)["lag"] == 0.0

    def test_a_clock_that_waits_catches_up(self, robot: Robot, motion: Motion) -> None:
        walk = Walk(robot, motion, with_recovery(phase_rate=0.0, catch_up=0.2))
        walk.steps(10, 0.0)
        waited = walk.steps(20, 0.5)
        assert int(waited["sample"]) == 10
        assert waited["lag"] == pytest.approx(-20)
        caught_up = walk.steps(100, 0.0)
        assert int(caught_up["sample"]) == pytest.approx(130, abs=1)


def pushed(
    robot: Robot, motion: Motion, config: ControllerConfig, observe: str = "truth", push: float = 0.0
) -> Rollout:
    conditions = Conditions(observe=observe, disturbances=(Disturbance("side-push", (push,), 0.5),))
    start = Start(np.array([60]), np.zeros((1, 12)), np.zeros((1, 3)))
    return run_episodes(robot, motion, start=start, duration_s=2.5, config=config, conditions=conditions, log=True)


class TestEpisodes:
    @pytest.mark.parametrize("observe", ["truth", "sensors"])
    def test_without_a_push_not_a_bit_is_another(self, robot: Robot, motion: Motion, observe: str) -> None:
        off = pushed(robot, motion, default_config(), observe)
        on = pushed(robot, motion, with_recovery(foothold_feedback=(0.1, 0.1), phase_rate=0.0), observe)
        assert off.log is not None
        assert on.log is not None
        assert off.log.observation.tobytes() == on.log.observation.tobytes()
        assert off.reward == on.reward

    def test_pushes_are_survived_that_fell_the_robot_without(self, data_folder: Path, robot: Robot) -> None:
        trot = load_motion("dog:trot", robot)
        pushes = np.repeat([-10.0, -8.0, 4.0], 6)
        sample = np.tile(np.random.default_rng(0).integers(trot.n_samples, size=6), 3)
        start = Start(sample, np.zeros((18, 12)), np.zeros((18, 3)))
        conditions = Conditions(disturbances=(Disturbance("side-push", tuple(pushes.tolist()), 0.5),))
        off, on = (
            run_episodes(robot, trot, start=start, duration_s=2.5, config=config, conditions=conditions).fell
            for config in (default_config(), with_recovery())
        )
        assert (off & ~on).sum() >= 3
        assert on.sum() < off.sum()

    def test_the_reward_keeps_the_demonstrations_clock(self, robot: Robot, motion: Motion) -> None:
        found = pushed(robot, motion, with_recovery(), push=2.0)
        assert found.log is not None
        expected = (60 + 1 + np.arange(found.log.demonstration.shape[1])) % motion.n_samples
        table = reference_table(motion, robot)
        assert np.array_equal(found.log.demonstration["joint_pos"][0], table["joint_pos"][expected])


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"start_error": 0.1, "end_error": 0.2}, "end_error must not be above"),
        ({"phase_rate": 3.0}, "phase_rate must be in \\[0, 2\\]"),
        ({"catch_up": 1.0}, "catch_up must be in \\[0, 1\\)"),
        ({"resync_time": -1.0}, "resync_time must not be negative"),
    ],
)
def test_one_line_for_what_cannot_be(settings: dict[str, float], said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        with_recovery(**settings)
