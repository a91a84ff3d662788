"""The closed loop with sensors: nothing but readings reaches the controller, and randomness is the episodes' own."""

import dataclasses

import numpy as np
import pytest

from control.motions import gait, turned
from fastmimic.episode.loop import ClosedLoop
from fastmimic.episode.plan import Start, nominal_start, perturbed_start
from fastmimic.episode.rollout import Rollout
from fastmimic.motion.motion import Motion
from fastmimic.robot import Robot
from fastmimic.simulation.conditions import Conditions
from fastmimic.simulation.config import ideal_sensors

STEPS = 400
SENSED = Conditions(observe="sensors", seed=4)


@pytest.fixture(scope="module")
def motion(robot: Robot) -> Motion:
    return turned(gait(robot, (0.3, 0.05), 0.4), 0.9)


@pytest.fixture(scope="module")
def start(motion: Motion) -> Start:
    return perturbed_start(3, motion.n_samples, np.random.default_rng(0))


@pytest.fixture(scope="module")
def sensed(robot: Robot, motion: Motion, start: Start) -> Rollout:
    return ClosedLoop(robot, motion, 3, conditions=SENSED).run(None, start, STEPS)


def figures(rollout: Rollout, rows: slice = slice(None)) -> list[bytes]:
    """All numbers of some episodes, bit for bit, those of the estimate as well."""
    assert rollout.estimation is not None
    names = [f.name for f in dataclasses.fields(Rollout) if f.name not in ("duration_s", "log", "parts", "estimation")]
    found = [getattr(rollout, name)[rows].tobytes() for name in names]
    its = rollout.estimation
    return found + [getattr(its, f.name)[rows].tobytes() for f in dataclasses.fields(its)]


class Poisoned(ClosedLoop):
    """A loop whose simulation says NaN whenever neither the sensors measure nor the reward is counted."""

    def run(self, *args: object, **kwargs: object) -> Rollout:
        assert self.observer is not None
        truth, sensors, hidden = self.simulation.observation, self.observer.sensors, [None]

        def hide() -> None:
            hidden[0] = truth.copy()
            for name in truth.dtype.names:
                truth[name] = np.nan

        def reset(generators: object, observation: np.ndarray) -> np.ndarray:
            assert observation is truth
            reading = type(sensors).reset(sensors, generators, observation)
            hide()
            return reading

        def measure(observation: np.ndarray, commands: np.ndarray) -> np.ndarray:
            assert np.isfinite(observation["root_pos"]).all()
            reading = type(sensors).measure(sensors, observation, commands)
            if hidden[0] is not None:
                hide()
            return reading

        def score() -> None:
            assert np.isnan(truth["root_pos"]).all(), "the controller and the estimator had this to look at"
            truth[...] = hidden[0]
            ClosedLoop.score(self)
            hide()

        sensors.reset, sensors.measure, self.score = reset, measure, score  # type: ignore[method-assign]
        return super().run(*args, **kwargs)  # type: ignore[arg-type]


def test_the_truth_does_not_reach_the_controller(robot: Robot, motion: Motion, start: Start, sensed: Rollout) -> None:
    """Were anything of it read behind the sensors, it would be NaN there, and the robot would fall."""
    poisoned = Poisoned(robot, motion, 3, conditions=SENSED).run(None, start, STEPS)
    assert figures(poisoned) == figures(sensed)
    assert not poisoned.fell.any()


def test_with_the_truth_nothing_changes(robot: Robot, motion: Motion, start: Start) -> None:
    plain = ClosedLoop(robot, motion, 3).run(None, start, 100)
    seeded = ClosedLoop(robot, motion, 3, conditions=Conditions(seed=9)).run(None, start, 100)
    assert plain.reward.tobytes() == seeded.reward.tobytes()
    assert plain.estimation is None


def test_the_robot_imitates_by_its_sensors(sensed: Rollout) -> None:
    assert not sensed.fell.any()
    assert np.all(sensed.reward > 0.8)
    assert sensed.estimation is not None
    assert np.all(sensed.estimation.velocity_rmse < 0.08)
    assert np.all((sensed.estimation.tilt_rmse > 0.001) & (sensed.estimation.tilt_rmse < 0.02))


def test_n_episodes_at_once_are_n_single_ones(robot: Robot, motion: Motion, start: Start, sensed: Rollout) -> None:
    single = ClosedLoop(robot, motion, 1, conditions=SENSED)
    for i in range(3):
        rows = slice(i, i + 1)
        assert figures(single.run(None, start.part(rows), STEPS)) == figures(sensed, rows)


def test_a_loop_can_be_used_again_and_threads_do_not_matter(
    robot: Robot, motion: Motion, start: Start, sensed: Rollout
) -> None:
    loop = ClosedLoop(robot, motion, 3, conditions=SENSED, threads=2)
    loop.run(None, nominal_start(3), 50)
    assert figures(loop.run(None, start, STEPS)) == figures(sensed)


def test_the_seed_and_the_episode_decide_what_sensors_get_wrong(robot: Robot, motion: Motion) -> None:
    def rewards(seed: int, stream: list[int] | None = None) -> np.ndarray:
        start = nominal_start(2)
        if stream is not None:
            start = dataclasses.replace(start, stream=np.array(stream))
        return (
            ClosedLoop(robot, motion, 2, conditions=Conditions(observe="sensors", seed=seed))
            .run(None, start, 60)
            .reward
        )

    first = rewards(1)
    assert first[0] != first[1], "the same start, other errors"
    assert (rewards(2) != first).all()
    np.testing.assert_array_equal(rewards(1, [1, 1]), first[[1, 1]])


def test_the_reference_is_synchronised_to_the_estimate(robot: Robot, motion: Motion) -> None:
    """The controller's own clock follows its estimate and the reward's the truth, sample by sample alike."""
    conditions = Conditions(observe="sensors", seed=1, sensors=dataclasses.replace(ideal_sensors(), gyro_bias=0.2))
    loop = ClosedLoop(robot, motion, 1, conditions=conditions)
    loop.run(None, nominal_start(1), motion.n_samples)  # to the start of the second cycle
    assert loop.observer is not None
    own, judge = loop.observer.clocks[0], loop.clocks[0]
    assert own["sample"] == judge["sample"] == 0
    root = loop.table["root_pos"][0, :2]
    turn = own["origin"][2]
    c, s = np.cos(turn), np.sin(turn)
    for clock, where in ((own, loop.observer.estimator.observation), (judge, loop.simulation.observation)):
        there = clock["origin"][:2] + np.array([c * root[0] - s * root[1], s * root[0] + c * root[1]])
        np.testing.assert_allclose(there, where["root_pos"][0, :2], atol=1e-12)
    assert np.abs(own["origin"][:2] - judge["origin"][:2]).max() > 1e-3


def test_the_log_has_what_the_controller_was_told(robot: Robot, motion: Motion, start: Start) -> None:
    loop = ClosedLoop(robot, motion, 3, conditions=SENSED)
    log = loop.run(None, start, 20, log=True).log
    assert log is not None
    assert log.estimate is not None
    assert loop.observer is not None
    np.testing.assert_array_equal(log.estimate["root_pos"][:, -1], loop.observer.estimator.observation["root_pos"])
    assert np.abs(log.estimate["root_pos"] - log.observation["root_pos"]).max() > 0
    truthful = ClosedLoop(robot, motion, 3).run(None, start, 20, log=True).log
    assert truthful is not None
    assert truthful.estimate is None
