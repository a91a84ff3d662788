"""Episodes for learning: the same physics, reward and falls as in every other rollout; any number of threads; exact
resumption."""

import dataclasses

import numpy as np
import pytest

from fastmimic.base.errors import ConfigError, MotionError
from fastmimic.episode.loop import ClosedLoop
from fastmimic.episode.plan import JOINT_NOISE, VELOCITY_NOISE, Start
from fastmimic.learning.config import PolicyConfig
from fastmimic.learning.episodes import Episodes, Outcome
from fastmimic.learning.policy import controlled_by
from fastmimic.motion.motion import Motion
from fastmimic.robot import Robot, load_robot
from fastmimic.runs.loading import load_motion
from fastmimic.simulation.conditions import Range, draw_uniform, parse_range
from learning.hand_made import actions_of, follower

DECIMATION = PolicyConfig().decimation


@pytest.fixture(scope="module")
def motion(robot: Robot) -> Motion:
    return load_motion("side-step", robot)


def noise(n: int, steps: int) -> np.ndarray:
    return np.random.default_rng(5).normal(0, 1.5, (steps, n, 12))


def run(episodes: Episodes, actions: np.ndarray) -> list[Outcome]:
    """All outcomes, copied."""
    found = []
    for action in actions:
        o = episodes.step(action)
        found.append(Outcome(o.seen.copy(), o.reward.copy(), o.fell.copy(), o.ended.copy(), o.final, o.score, o.steps))
    return found


def same(a: list[Outcome], b: list[Outcome]) -> bool:
    return all(
        np.array_equal(getattr(x, name), getattr(y, name))
        for x, y in zip(a, b, strict=True)
        for name in ("seen", "reward", "fell", "ended", "final", "score", "steps")
    )


@pytest.mark.slow
def test_a_policy_earns_in_training_what_it_earns_in_an_evaluation(robot: Robot, motion: Motion) -> None:
    """The closed loop of `fastmimic evaluate` and the episodes of the training are the same. They place robots by other
    sums: a foot that is placed on the ground to the last digit may touch it in one of the two alone, which the first
    step shows. Such robots are compared by their rewards, less strictly."""
    n, steps = 5, 60
    policy = follower(robot, motion)
    episodes = Episodes(robot, motion, n, seed=7)
    draws = np.random.default_rng(7).random((n, 16))
    phase = (draws[:, 0] * motion.n_samples).astype(np.int64)
    start = Start(phase, JOINT_NOISE * (2 * draws[:, 1:13] - 1), VELOCITY_NOISE * (2 * draws[:, 13:] - 1))
    loop = ClosedLoop(robot, motion, n, controller=controlled_by(policy))
    rollout = loop.run(None, start, steps * DECIMATION, log=True)
    assert not rollout.fell.any()
    assert rollout.log is not None
    seen = episodes.reset()
    total, same_start = np.zeros(n), np.ones(n, dtype=bool)
    for step in range(steps):
        outcome = episodes.step(actions_of(policy, seen))
        seen = outcome.seen
        total += outcome.reward
        at = (step + 1) * DECIMATION - 1
        apart = np.abs(episodes.state()["observation"]["joint_pos"] - rollout.log.observation["joint_pos"][:, at])
        if step == 0:
            same_start = apart.max(axis=1) < 1e-12
            assert same_start.sum() >= 3
        assert apart[same_start].max() < 1e-9
        earned = rollout.log.reward[:, at - DECIMATION + 1 : at + 1].mean(axis=1)
        assert outcome.reward[same_start] == pytest.approx(earned[same_start], abs=1e-9)
    assert (total / steps)[same_start] == pytest.approx(rollout.reward[same_start], abs=1e-9)
    assert total / steps == pytest.approx(rollout.reward, abs=1e-2)


def test_the_number_of_threads_does_not_change_a_bit(robot: Robot, motion: Motion) -> None:
    actions = noise(5, 12)
    found = []
    for threads in (1, 3):
        episodes = Episodes(robot, motion, 5, seed=1, threads=threads)
        first = episodes.reset().copy()
        found.append((first, run(episodes, actions)))
        episodes.close()
    assert np.array_equal(found[0][0], found[1][0])
    assert same(found[0][1], found[1][1])
    assert any(o.fell.any() for o in found[0][1])  # some began anew in between


def test_a_state_is_all_that_the_future_depends_on(robot: Robot, motion: Motion) -> None:
    actions = noise(4, 16)
    episodes = Episodes(robot, motion, 4, seed=2, threads=2)
    episodes.reset()
    run(episodes, actions[:8])
    state = episodes.state()
    straight = run(episodes, actions[8:])
    again = Episodes(robot, motion, 4, seed=99)
    again.restore(state)
    assert same(straight, run(again, actions[8:]))
    assert any(o.done.any() for o in straight)
    episodes.close()


def test_falls_and_lengths_end_episodes_and_the_next_begins(robot: Robot, motion: Motion) -> None:
    still = Episodes(robot, motion, 2, duration_s=0.2, perturbed=False, seed=3)
    still.reset()
    outcomes = run(still, np.zeros((6, 2, 12)))
    assert [bool(o.ended.all()) for o in outcomes] == [False, False, False, False, False, True]
    assert outcomes[5].steps.tolist() == [6, 6]
    assert outcomes[5].score == pytest.approx(np.mean([o.reward for o in outcomes], axis=0))
    assert outcomes[5].final.shape == (2, 160)
    assert not np.array_equal(outcomes[5].final, outcomes[5].seen)

    folded = Episodes(robot, motion, 1, seed=4)
    folded.reset()
    legs_up = np.full((40, 1, 12), 10.0)
    outcomes = run(folded, legs_up)
    fall = next(i for i, o in enumerate(outcomes) if o.fell[0])
    total = sum(float(o.reward[0]) for o in outcomes[: fall + 1])
    limit = round(10.0 * PolicyConfig().rate_hz)
    assert outcomes[fall].score[0] == pytest.approx(total / limit)  # the steps after the fall count 0
    assert not outcomes[fall].ended[0]


def test_a_motion_that_ends_ends_its_episodes(robot: Robot, motion: Motion) -> None:
    ends = dataclasses.replace(motion, cycle=None)
    episodes = Episodes(robot, ends, 3, seed=5, perturbed=False)
    episodes.reset()
    clocks = episodes.state()["clocks"]["sample"].copy()
    least = -(-(ends.n_samples - 1 - clocks - DECIMATION + 1) // DECIMATION)
    outcomes = run(episodes, np.zeros((16, 3, 12)))
    first = [next(i for i, o in enumerate(outcomes) if o.done[row]) + 1 for row in range(3)]
    assert first == least.tolist()


def test_robots_can_differ(robot: Robot, motion: Motion) -> None:
    ranges = (Range("friction", 0.3, 1.2), Range("payload", 0.0, 3.0))
    actions = noise(2, 4) * 0
    alike = Episodes(robot, motion, 2, seed=6, perturbed=False)
    differing = Episodes(robot, motion, 2, seed=6, perturbed=False, randomize=ranges)
    divided = Episodes(robot, motion, 2, seed=6, perturbed=False, randomize=ranges, threads=2)
    results = []
    for episodes in (alike, differing, divided):
        episodes.reset()
        results.append(run(episodes, actions))
        episodes.close()
    assert not same(results[0], results[1])
    assert same(results[1], results[2])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("friction=a:b", "written name=lower:upper"),
        ("friction=1.2:0.4", "takes a range within"),
        ("fricton=0.4:1.2", "did you mean 'friction'"),
        ("push=1:2", "cannot differ between robots"),
        ("delay=0:0.01", "cannot differ between robots"),
    ],
)
def test_ranges_that_cannot_be_are_refused(text: str, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        draw_uniform([parse_range(text)], 1, np.random.default_rng())


def test_what_does_not_fit_is_refused(robot: Robot, motion: Motion) -> None:
    with pytest.raises(ConfigError, match="robots must be at least 1"):
        Episodes(robot, motion, 0)
    with pytest.raises(MotionError, match="for robot 'a1', not for 'go1'"):
        Episodes(load_robot("go1"), motion, 1)
    with pytest.raises(ConfigError, match="expected \\(1, 12\\)"):
        Episodes(robot, motion, 1).step(np.zeros((2, 12)))
    with pytest.raises(ConfigError, match="at least a policy step"):
        Episodes(robot, motion, 1, duration_s=0.01)
    with pytest.raises(ConfigError, match="the range of 'friction' is given twice"):
        Episodes(robot, motion, 1, randomize=[Range("friction", 0.4, 1.0)] * 2)
