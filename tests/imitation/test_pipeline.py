"""The main job as a library call: what goes in, what comes out, and what is refused."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from control.motions import gait
from fastmimic.base.errors import CheckpointError, ConfigError
from fastmimic.episode.metrics import swing_clearance
from fastmimic.episode.reward import TERMS
from fastmimic.imitation.evaluate import evaluate
from fastmimic.imitation.imitate import Imitation, imitate
from fastmimic.motion.motion import Motion
from fastmimic.robot import Robot
from fastmimic.runs.loading import load_motion
from searches import QUICK_CHOICE

DURATION = 0.6
QUICK = {"duration_s": DURATION, "iterations": 2, "population": 4, "seed": 1, "choice": QUICK_CHOICE}


@pytest.fixture(scope="module")
def motion(robot: Robot) -> Motion:
    return gait(robot, (0.3, 0.05), 0.4, n_samples=200)


@pytest.fixture(scope="module")
def imitation(motion: Motion, robot: Robot) -> Imitation:
    return imitate(motion, robot, workers=2, **QUICK)


class TestImitate:
    def test_the_result_is_a_motion_that_carries_its_demonstration(
        self, imitation: Imitation, motion: Motion, tmp_path: Path
    ) -> None:
        assert imitation.motion.demonstration is motion
        assert imitation.demonstration is motion
        imitation.motion.save(tmp_path / "motion.npz")
        assert Motion.load(tmp_path / "motion.npz").demonstration is not None

    def test_before_and_after_are_scored_against_the_same_demonstration(
        self, imitation: Imitation, motion: Motion, robot: Robot
    ) -> None:
        assert imitation.before.log is not None
        assert imitation.after.log is not None
        for log in (imitation.before.log, imitation.after.log):
            np.testing.assert_array_equal(log.demonstration["joint_pos"][0, 0], motion.joint_pos[1])
        again = evaluate(imitation.motion, robot, duration_s=DURATION)
        assert again.rollout.reward[0] == imitation.after.reward[0]
        alone = evaluate(motion, robot, duration_s=DURATION)
        assert alone.rollout.reward[0] == imitation.before.reward[0]

    @pytest.mark.parametrize(("watched", "given"), [(True, False), (False, False), (True, True)])
    def test_who_waits_sees_progress(
        self,
        watched: bool,
        given: bool,
        motion: Motion,
        robot: Robot,
        monkeypatch: pytest.MonkeyPatch,
        capsys: pytest.CaptureFixture[str],
    ) -> None:
        monkeypatch.setattr("fastmimic.imitation.imitate.is_watched", lambda: watched)
        own: dict[str, Any] = {"progress": lambda step: None} if given else {}
        imitate(motion, robot, **QUICK, **own)
        assert ("iteration 2/2" in capsys.readouterr().err) == (watched and not given)

    def test_an_optimised_motion_is_optimised_anew_against_its_demonstration(
        self, imitation: Imitation, motion: Motion, robot: Robot
    ) -> None:
        again = imitate(imitation.motion, robot, workers=1, **QUICK)
        assert again.demonstration is motion
        assert again.values.tobytes() == imitation.values.tobytes(), "and any number of workers finds the same"
        assert again.after.reward[0] == imitation.after.reward[0]

    def test_without_optimisation_the_demonstration_is_the_result(self, motion: Motion, robot: Robot) -> None:
        plain = imitate(motion, robot, method="mbc", duration_s=DURATION)
        assert plain.motion is motion
        assert plain.parameters == ()
        assert plain.history is None
        assert plain.evaluations == plain.iterations == 0
        metrics = plain.metrics()
        assert metrics["parameters"] == []
        assert metrics["reward"]["before"] == metrics["reward"]["after"] > 0.8

    def test_a_motion_that_does_not_repeat_is_done_once_and_optimised(self, robot: Robot, tmp_path: Path) -> None:
        """From the clip to a saved motion that runs again: one cycle of a trot, once."""
        once = load_motion("trot", robot, cycle=False)
        assert once.cycle is None
        result = imitate(once, robot, workers=1, **QUICK)
        whole = (once.n_samples - 1) / once.rate_hz
        assert result.duration_s == result.after.duration_s == pytest.approx(whole)
        assert result.motion.cycle is None
        assert result.demonstration is once
        assert result.motion.provenance.as_dict()["dmp"]["primitive"] == "discrete"
        assert not result.after.fell[0]
        assert result.after.reward[0] > 0.9
        result.motion.save(tmp_path / "once.npz")
        again = evaluate(tmp_path / "once.npz", robot, episodes=3)
        assert again.rollout.duration_s == pytest.approx(whole)
        assert again.rollout.reward[0] == result.after.reward[0]
        with pytest.raises(ConfigError, match="cycle cannot be applied to 'trot': it is already a robot motion"):
            load_motion(tmp_path / "once.npz", robot, cycle=False)

    def test_a_run_can_be_resumed(self, imitation: Imitation, motion: Motion, robot: Robot, tmp_path: Path) -> None:
        path = tmp_path / "checkpoint.npz"
        shorter = {**QUICK, "iterations": 1}
        imitate(motion, robot, checkpoint=path, **shorter)
        resumed = imitate(motion, robot, checkpoint=path, resume=True, **QUICK)
        assert resumed.values.tobytes() == imitation.values.tobytes()
        with pytest.raises(CheckpointError, match="of another problem"):
            imitate(motion, robot, checkpoint=path, resume=True, config="paper", **QUICK)

    def test_the_configuration_matters(self, motion: Motion, robot: Robot) -> None:
        results = [imitate(motion, robot, method="mbc", duration_s=DURATION, config=c) for c in ("default", "paper")]
        assert results[0].before.reward[0] != results[1].before.reward[0]
        assert [r.metrics()["config"] for r in results] == ["default", "paper"]


class TestMetrics:
    def test_they_are_json_without_numbers_that_json_does_not_know(self, imitation: Imitation) -> None:
        text = json.dumps(imitation.metrics(), allow_nan=False)
        assert json.loads(text)["motion"] == "synthetic"

    def test_every_figure_is_there(self, imitation: Imitation) -> None:
        metrics = imitation.metrics()
        for key in ("motion", "robot", "method", "seed", "duration_s", "evaluations", "iterations", "wall_s"):
            assert key in metrics
        for key in (
            *("reward", "fell", "drift_m_per_s", "early_contacts_per_s", "stance_slip_m"),
            *("foot_z_rmse_m", "foot_x_rmse_m"),
        ):
            assert {"before", "after"} <= set(metrics[key])
        assert set(metrics["reward"]["components_before"]) == set(TERMS)
        assert {len(v) for v in metrics["swing_clearance_m"].values()} == {4}
        assert set(metrics["swing_clearance_m"]) == {"demonstration", "before", "after"}
        assert isinstance(metrics["fell"]["after"], bool)
        assert {"python", "fastmimic", "mujoco", "daqp", "cma", "numba", "numpy"} == set(metrics["versions"])

    def test_figures_are_those_of_the_rollouts(self, imitation: Imitation, motion: Motion, robot: Robot) -> None:
        metrics = imitation.metrics()
        for when, rollout in (("before", imitation.before), ("after", imitation.after)):
            assert metrics["reward"][when] == rollout.reward[0]
            weighted = sum(
                w * metrics["reward"][f"components_{when}"][name]
                for name, w in zip(TERMS, (0.25, 0.05, 0.1, 0.3, 0.3), strict=True)
            )
            assert weighted == pytest.approx(rollout.reward[0])
            log = rollout.log
            assert log is not None
            from fastmimic.robot.kinematics import foot_positions

            error = foot_positions(robot, log.observation["joint_pos"][0]) - log.demonstration["foot_pos"][0]
            assert metrics["foot_z_rmse_m"][when] == pytest.approx(np.sqrt(np.mean(error[..., 2] ** 2)))
            assert metrics["foot_x_rmse_m"][when] == pytest.approx(np.sqrt(np.mean(error[..., 0] ** 2)))
        np.testing.assert_allclose(
            metrics["swing_clearance_m"]["demonstration"], swing_clearance(motion, robot.foot_radius)
        )

    def test_parameters_are_within_their_bounds(self, imitation: Imitation) -> None:
        parameters = imitation.metrics()["parameters"]
        assert len(parameters) == 8
        for p, value in zip(parameters, imitation.values, strict=True):
            assert set(p) == {"name", "unit", "lower", "upper", "initial", "value"}
            assert p["lower"] <= p["value"] == value <= p["upper"]


class TestEvaluate:
    def test_episodes_are_perturbed_but_the_first(self, motion: Motion, robot: Robot) -> None:
        result = evaluate(motion, robot, episodes=3, duration_s=0.3, seed=2)
        rewards = result.rollout.reward
        assert rewards.shape == (3,)
        assert rewards[0] == evaluate(motion, robot, duration_s=0.3).rollout.reward[0]
        assert len(set(rewards)) == 3

    def test_the_seed_decides(self, motion: Motion, robot: Robot) -> None:
        a, b, c = (evaluate(motion, robot, episodes=2, duration_s=0.2, seed=s).rollout.reward for s in (5, 5, 6))
        np.testing.assert_array_equal(a, b)
        assert a[0] == c[0]
        assert a[1] != c[1]

    def test_the_summary(self, motion: Motion, robot: Robot) -> None:
        result = evaluate(motion, robot, episodes=3, duration_s=DURATION)
        figures = json.loads(json.dumps(result.as_dict(), allow_nan=False))
        r = result.rollout
        assert figures["reward_mean"] == pytest.approx(r.reward.mean())
        assert figures["reward_std"] == pytest.approx(r.reward.std())
        assert figures["episodes"] == 3
        assert figures["fell"] == 0.0
        assert set(figures["components"]) == set(TERMS)
        assert len(figures["swing_clearance_m"]) == 4
        np.testing.assert_allclose(figures["swing_clearance_m"], r.clearance.mean(axis=0))
        assert {"drift_m_per_s", "foot_z_rmse_m", "foot_x_rmse_m"} <= set(figures)

    def test_episodes_too_short_for_a_swing_have_no_clearance(self, motion: Motion, robot: Robot) -> None:
        figures = evaluate(motion, robot, episodes=2, duration_s=0.01).as_dict()
        assert figures["swing_clearance_m"] == [None] * 4
        json.dumps(figures, allow_nan=False)

    @pytest.mark.parametrize(
        ("settings", "message"),
        [
            ({"episodes": 0}, "episodes must be at least 1, found 0"),
            ({"duration_s": 0.0}, "duration must be positive"),
            ({"duration_s": float("nan")}, "duration must be positive"),
            ({"seed": -1}, "seed must not be negative, found -1"),
            ({"config": "papre"}, "unknown configuration 'papre'.*did you mean 'paper'"),
        ],
    )
    def test_settings_out_of_range_are_refused(
        self, motion: Motion, robot: Robot, settings: dict[str, object], message: str
    ) -> None:
        with pytest.raises(ConfigError, match=message):
            evaluate(motion, robot, **settings)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"method": "mbc-dpm"}, "unknown method 'mbc-dpm'.*did you mean 'mbc-dmp'"),
        ({"duration_s": -1.0}, "duration must be positive"),
        ({"iterations": 0}, "iterations must be at least 1"),
        ({"population": 2}, "population must be at least 4"),
        ({"workers": 0}, "workers must be at least 1"),
        ({"config": "fast"}, "unknown configuration 'fast'"),
    ],
)
def test_settings_out_of_range_are_refused(
    motion: Motion, robot: Robot, settings: dict[str, object], message: str
) -> None:
    with pytest.raises(ConfigError, match=message):
        imitate(motion, robot, **{**QUICK, **settings})  # type: ignore[arg-type]
