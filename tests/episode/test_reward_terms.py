"""Terms that a user adds to the reward."""

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from fastmimic.base.errors import ConfigError
from fastmimic.episode.loop import run_episodes
from fastmimic.episode.metrics import Metrics
from fastmimic.episode.plan import nominal_start
from fastmimic.episode.reward import REWARD_TERMS, TERMS, WEIGHTS, RewardTerm, reward_weights
from fastmimic.robot import Robot, load_robot
from fastmimic.runs.loading import load_motion


@pytest.fixture(scope="module")
def robot() -> Robot:
    return load_robot("a1")


def level(demonstration: np.ndarray, observation: np.ndarray) -> np.ndarray:
    """1 where the trunk is at the demonstration's height."""
    return np.exp(-100.0 * (demonstration["root_pos"][:, 2] - observation["root_pos"][:, 2]) ** 2)


@pytest.fixture
def added() -> Iterator[None]:
    REWARD_TERMS.register(RewardTerm("level", 0.25, "height of the trunk", function=level))
    yield
    REWARD_TERMS.pop("level")


def rollout(robot: Robot, **options: Any) -> Any:
    motion = load_motion("trot", robot)
    return run_episodes(robot, motion, start=nominal_start(2), duration_s=0.4, log=True, **options)


def test_it_is_added_with_its_weight_and_the_reward_stays_within_one(robot: Robot, added: None) -> None:
    found = rollout(robot)
    assert found.terms.shape == (2, len(TERMS) + 1)
    weights = np.array([*WEIGHTS, 0.25]) / 1.25
    np.testing.assert_allclose(reward_weights(), weights)
    np.testing.assert_allclose(found.reward, found.terms @ weights)
    assert found.log is not None
    np.testing.assert_allclose(found.log.reward.mean(axis=1), found.reward)
    height = found.log.demonstration["root_pos"][0, :, 2] - found.log.observation["root_pos"][0, :, 2]
    np.testing.assert_allclose(found.log.terms[0, :, -1], np.exp(-100.0 * height**2))
    assert Metrics.of(found).components["level"] == pytest.approx(found.terms[0, -1])


def test_what_is_built_in_stays_the_same(robot: Robot) -> None:
    plain = rollout(robot)
    REWARD_TERMS.register(RewardTerm("nothing", 1.0, function=lambda d, o: np.zeros(len(o))))
    try:
        found = rollout(robot)
    finally:
        REWARD_TERMS.pop("nothing")
    np.testing.assert_array_equal(found.terms[:, :-1], plain.terms)
    np.testing.assert_allclose(found.reward, plain.reward / 2)


@pytest.mark.parametrize(
    ("function", "said"),
    [
        (lambda d, o: np.full(len(o), 2.0), r"'bad' must lie in \[0, 1\], found 2 to 2"),
        (lambda d, o: np.zeros(3), r"'bad' gave values of shape \(3,\) for 2 robots"),
    ],
)
def test_a_term_that_is_none_is_refused(robot: Robot, function: Any, said: str) -> None:
    REWARD_TERMS.register(RewardTerm("bad", 1.0, function=function))
    try:
        with pytest.raises(ConfigError, match=said):
            rollout(robot)
    finally:
        REWARD_TERMS.pop("bad")


def test_a_weight_is_positive() -> None:
    with pytest.raises(ConfigError, match="the weight must be positive, found 0"):
        RewardTerm("x", 0.0)
