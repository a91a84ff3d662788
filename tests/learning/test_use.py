"""A policy where a method can be given: in the closed loop, `evaluate` and `compare`."""

import csv
import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest

from fastmimic.base.errors import ConfigError, OutputError, PolicyError
from fastmimic.cli import main
from fastmimic.episode.loop import run_episodes
from fastmimic.episode.plan import perturbed_start
from fastmimic.experiments.compare import ComparisonPlan, choose_policies, prepare
from fastmimic.experiments.comparison_run import ComparisonFolder, ComparisonSettings, Row
from fastmimic.experiments.measurement import comparison_table
from fastmimic.imitation.evaluate import evaluate
from fastmimic.imitation.imitate import imitate
from fastmimic.imitation.methods import METHODS, PAPER_METHODS
from fastmimic.learning.policy import controlled_by
from fastmimic.motion.motion import Motion
from fastmimic.report.experiment_figures import write_comparison
from fastmimic.robot import Robot
from fastmimic.runs.loading import load_motion
from learning.hand_made import follower
from searches import QUICK_CHOICE

TINY = ComparisonSettings(
    duration_s=0.6, iterations=2, population=4, evaluation_s=0.8, perturbed_episodes=2, choice=QUICK_CHOICE
)


@pytest.fixture(scope="module")
def motion(robot: Robot) -> Motion:
    return load_motion("side-step", robot)


@pytest.fixture(scope="module")
def policy_file(robot: Robot, motion: Motion, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("policy") / "policy.npz"
    follower(robot, motion).save(path)
    return path


def run(plan: ComparisonPlan, out: Path) -> list[Row]:
    return prepare(plan, out, keep=True, prepared=lambda name: None).perform(1, lambda *_: None)


class TestInTheClosedLoop:
    def test_a_policy_made_by_hand_tracks_the_motion(self, robot: Robot, motion: Motion) -> None:
        rollout = run_episodes(
            robot, motion, duration_s=2.0, controller=controlled_by(follower(robot, motion)), log=True
        )
        assert not rollout.fell[0]
        assert rollout.reward[0] > 0.4
        assert rollout.components(0)["pose"] > 0.5
        assert rollout.log is not None
        feet_leave = rollout.log.stance.any(axis=1) & ~rollout.log.stance.all(axis=1)
        assert feet_leave.all()  # the gait planner sees every foot swing and stand

    def test_standing_would_not(self, robot: Robot, motion: Motion) -> None:
        still = follower(robot, motion)
        still = dataclasses.replace(still, weights=(0 * still.weights[0],), biases=(0 * still.biases[0],))
        rollout = run_episodes(robot, motion, duration_s=2.0, controller=controlled_by(still))
        assert rollout.components(0)["pose"] < 0.45

    def test_robots_do_not_depend_on_each_other(self, robot: Robot, motion: Motion) -> None:
        controller = controlled_by(follower(robot, motion))
        start = perturbed_start(3, motion.n_samples, np.random.default_rng(0))
        together = run_episodes(robot, motion, start=start, duration_s=0.5, controller=controller)
        alone = run_episodes(robot, motion, start=start.part(slice(2, 3)), duration_s=0.5, controller=controller)
        assert together.reward[2] == alone.reward[0]

    def test_a_policy_that_falls_ends_the_episode(self, robot: Robot, motion: Motion) -> None:
        curl = follower(robot, motion)
        curl = dataclasses.replace(curl, weights=(0 * curl.weights[0],), biases=(0 * curl.biases[0] + 10,))
        rollout = run_episodes(robot, motion, controller=controlled_by(curl), duration_s=3.0)
        assert rollout.fell[0]
        assert rollout.reward[0] < 0.3

    def test_it_is_for_its_own_motion(self, robot: Robot, motion: Motion) -> None:
        with pytest.raises(PolicyError, match="imitates 'side-step', not 'trot'"):
            run_episodes(robot, load_motion("trot", robot), controller=controlled_by(follower(robot, motion)))


class TestEvaluate:
    def test_the_figures_are_those_of_the_policy(
        self, robot: Robot, motion: Motion, policy_file: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        assert main(["evaluate", "side-step", "--policy", str(policy_file), "--duration", "1", "--json"]) == 0
        figures = json.loads(capsys.readouterr().out)
        direct = evaluate(motion, robot, duration_s=1.0, controller=controlled_by(follower(robot, motion)))
        assert figures["method"] == "rl"
        assert figures["reward_mean"] == pytest.approx(float(direct.rollout.reward[0]), abs=1e-5)
        assert figures["reward_mean"] < evaluate(motion, robot, duration_s=1.0).rollout.reward[0]

    @pytest.mark.parametrize(
        ("arguments", "message"),
        [
            (("trot",), "the policy imitates 'side-step', not 'trot'"),
            (("side-step", "--robot", "go1"), "the policy is for robot 'a1', not for 'go1'"),
            (("side-step", "--method", "mbc"), "method 'mbc' does not use a policy"),
        ],
    )
    def test_a_policy_that_does_not_fit_is_one_line(
        self, arguments: tuple[str, ...], message: str, policy_file: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        assert main(["evaluate", *arguments, "--policy", str(policy_file)]) == 2
        said = capsys.readouterr()
        assert said.out == ""
        assert message in said.err
        assert len(said.err.splitlines()) == 1

    def test_of_an_optimised_motion_it_imitates_the_demonstration(self, robot: Robot, motion: Motion) -> None:
        other = dataclasses.replace(motion, joint_pos=motion.joint_pos + 0.1, demonstration=motion)
        controller = controlled_by(follower(robot, motion))
        rewards = [evaluate(m, robot, duration_s=0.5, controller=controller).rollout.reward[0] for m in (motion, other)]
        assert rewards[0] == rewards[1]

    def test_without_a_policy_there_is_none(self, motion: Motion, robot: Robot) -> None:
        with pytest.raises(ConfigError, match="method 'rl' needs a trained policy"):
            evaluate(motion, robot, method="rl", duration_s=0.5)
        with pytest.raises(ConfigError, match="method 'rl' needs a trained policy"):
            imitate(motion, robot, method="rl", duration_s=0.5)


class TestTrain:
    def test_a_missing_library_is_one_line(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
    ) -> None:
        monkeypatch.setattr("fastmimic.learning.learner.find_spec", lambda name: None if name == "torch" else name)
        assert main(["train", "trot", "--out", str(tmp_path / "run")]) == 2
        assert "training needs torch; install it with: pip install 'fastmimic[rl]'" in capsys.readouterr().err
        assert not (tmp_path / "run").exists()


class TestCompare:
    @pytest.mark.slow
    def test_a_policy_is_a_row_at_the_papers_place(self, policy_file: Path, tmp_path: Path) -> None:
        policies = choose_policies([policy_file.parent], ["side-step"])
        plan = ComparisonPlan(TINY, ("side-step",), ("mbc", "rl"), seeds=1, ablations=False, policies=policies)
        rows = run(plan, tmp_path)
        write_comparison(ComparisonFolder.at(tmp_path), plan, rows)
        with (tmp_path / "results.csv").open() as file:
            written = {row["method"]: row for row in csv.DictReader(file)}
        assert list(written) == ["rl", "mbc"]
        assert float(written["rl"]["reward_mean"]) > 0.3
        assert written["rl"]["parameters"].startswith("policy=")
        assert "| `side-step` | RL |" in (tmp_path / "table.md").read_text()
        assert (tmp_path / "comparison.png").stat().st_size > 10_000
        assert list(METHODS)[: 1 + len(PAPER_METHODS)] == ["rl", *PAPER_METHODS]

        # the others' rows do not know of it
        alone = ComparisonPlan(TINY, ("side-step",), ("mbc",), seeds=1, ablations=False)
        prepared = prepare(alone, tmp_path, keep=True, prepared=lambda name: None)
        assert not prepared.tasks
        assert [row["method"] for row in prepared.kept] == ["rl"]

    def test_another_policy_is_another_run(
        self, robot: Robot, motion: Motion, policy_file: Path, tmp_path: Path
    ) -> None:
        methods = ("rl",)
        first = ComparisonPlan(TINY, ("side-step",), methods, 1, False, choose_policies([policy_file], ["side-step"]))
        run(first, tmp_path / "out")
        changed = follower(robot, motion)
        changed.biases[0][0] += 0.1
        changed.save(tmp_path / "changed.npz")
        second = ComparisonPlan(
            TINY, ("side-step",), methods, 1, False, choose_policies([tmp_path / "changed.npz"], ["side-step"])
        )
        with pytest.raises(OutputError, match="a finished run of another policy"):
            prepare(second, tmp_path / "out", keep=True, prepared=lambda name: None)

    def test_seeds_of_training_are_seeds(self, robot: Robot, motion: Motion, policy_file: Path, tmp_path: Path) -> None:
        follower(robot, motion, seed=1).save(tmp_path / "b" / "policy.npz")
        chosen = choose_policies([tmp_path, policy_file], ["side-step"])
        assert [(run.motion, run.seed) for run in chosen] == [("side-step", 0), ("side-step", 1)]
        other = follower(robot, motion, seed=1)
        other.biases[0][0] += 1
        other.save(tmp_path / "c" / "policy.npz")
        with pytest.raises(ConfigError, match="two policies for 'side-step', both of seed 1"):
            choose_policies([tmp_path, policy_file], ["side-step"])

    def test_what_a_row_cost_includes_the_training(self, robot: Robot, motion: Motion, tmp_path: Path) -> None:
        took = {"steps": 50, "episodes": 3, "wall_s": 1000.0, "cpu_s": 900.0, "simulated_s": 70.0}
        policy = dataclasses.replace(follower(robot, motion), about={"training": took})
        policy.save(tmp_path / "policy.npz")
        plan = ComparisonPlan(TINY, ("side-step",), ("rl",), 1, False, choose_policies([tmp_path], ["side-step"]))
        (row,) = run(plan, tmp_path / "out")
        assert 1000.0 < row["wall_s"] < 1100.0
        assert 900.0 < row["cpu_s"] < 1000.0
        assert row["simulated_s"] == pytest.approx(70.0 + TINY.duration_s + 3 * TINY.evaluation_s)
        assert row["evaluations"] == 3
        assert row["parameters"] == f"policy={policy.digest} steps=50"

    def test_the_table_says_what_is_a_policy(self, policy_file: Path, tmp_path: Path) -> None:
        plan = ComparisonPlan(TINY, ("side-step",), ("rl",), 1, False, choose_policies([policy_file], ["side-step"]))
        text = comparison_table(run(plan, tmp_path), 1)
        assert "RL: one policy a motion, trained beforehand" in text

    @pytest.mark.parametrize(
        ("arguments", "message"),
        [
            (("--motions", "side-step", "--methods", "rl"), "method 'rl' needs a trained policy for each motion"),
            (("--motions", "side-step", "--methods", "mbc", "--policy", "{file}"), "policies are for the method 'rl'"),
            (("--motions", "side-step", "trot", "--policy", "{file}"), "no policy for trot"),
            (("--motions", "trot", "--policy", "{file}"), "a policy for 'side-step', not among trot"),
            (("--motions", "side-step", "--robot", "go1", "--policy", "{file}"), "is for robot 'a1', not for 'go1'"),
        ],
    )
    def test_policies_that_do_not_fit_are_one_line(
        self,
        arguments: tuple[str, ...],
        message: str,
        policy_file: Path,
        tmp_path: Path,
        capsys: pytest.CaptureFixture[str],
    ) -> None:
        out = tmp_path / "out"
        given = [text.format(file=policy_file) for text in arguments]
        assert main(["compare", *given, "--out", str(out)]) == 2
        assert message in capsys.readouterr().err.splitlines()[-1]
        assert not out.exists()
