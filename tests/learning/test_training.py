"""Training: it learns, it goes on as if it had not stopped, and what it writes is what it learnt."""

from functools import partial
from pathlib import Path

import numpy as np
import pytest

for library in ("torch", "rsl_rl", "tensorboard", "onnx"):
    pytest.importorskip(library, reason=f"{library} is not installed: pip install 'fastmimic[rl]'")

from fastmimic.base.errors import CheckpointError, ConfigError  # noqa: E402
from fastmimic.cli import main  # noqa: E402
from fastmimic.learning import training  # noqa: E402
from fastmimic.learning.config import OBSERVATION_SIZE  # noqa: E402
from fastmimic.learning.learner import Learner, TrainingSettings  # noqa: E402
from fastmimic.learning.policy import Policy  # noqa: E402
from fastmimic.learning.training import TrainingFolder  # noqa: E402
from fastmimic.motion.motion import Motion  # noqa: E402
from fastmimic.robot import Robot  # noqa: E402
from fastmimic.runs.loading import load_motion  # noqa: E402
from learning.hand_made import actions_of  # noqa: E402

briefly = partial(training.evaluate_policy, duration_s=0.4, perturbed_episodes=1)
SMALL = TrainingSettings(robots=6, horizon=8, hidden=(16,), epochs=2, minibatches=2, episode_s=0.5)


@pytest.fixture(scope="module")
def motion(robot: Robot) -> Motion:
    return load_motion("side-step", robot)


def weights(policy: Policy) -> np.ndarray:
    return np.concatenate([a.ravel() for a in (*policy.weights, *policy.biases, policy.mean, policy.deviation)])


def test_the_reward_rises(robot: Robot, motion: Motion) -> None:
    """In 6000 steps; episodes are short, so that all parts of them are met alike from the beginning."""
    settings = TrainingSettings(
        robots=32, horizon=16, hidden=(64,), discount=0.9, epochs=5, desired_kl=0.05, minibatches=2, episode_s=0.5
    )
    learner = Learner(robot, motion, settings)
    rewards = [learner.iterate().reward for _ in range(12)]
    learner.close()
    assert np.mean(rewards[-3:]) > np.mean(rewards[:3]) + 0.02


def test_resuming_is_exact(robot: Robot, motion: Motion, tmp_path: Path) -> None:
    per = SMALL.steps_per_iteration
    straight, stopped = TrainingFolder.at(tmp_path / "straight"), TrainingFolder.at(tmp_path / "stopped")
    whole = training.train(robot, motion, 6 * per, straight, SMALL, evaluate_every=2 * per, evaluate=briefly)
    training.train(robot, motion, 3 * per, stopped, SMALL, evaluate_every=2 * per, threads=2, evaluate=briefly)
    rest = training.train(robot, motion, 6 * per, stopped, SMALL, evaluate_every=2 * per, resume=True, evaluate=briefly)
    assert [e.steps for e in whole] == [2 * per, 4 * per, 6 * per]
    assert [e.steps for e in rest] == [2 * per, 3 * per, 4 * per, 6 * per]
    later = {e.steps: e for e in rest}
    assert all(
        (e.reward_mean, e.reward_mean_perturbed) == (later[e.steps].reward_mean, later[e.steps].reward_mean_perturbed)
        for e in whole
    )
    a, b = (folder.load()["learner"]["algorithm"]["actor_state_dict"] for folder in (straight, stopped))
    assert all(np.array_equal(a[name].numpy(), b[name].numpy()) for name in a)


def test_a_folder_holds_the_best_policy_and_its_course(robot: Robot, motion: Motion, tmp_path: Path) -> None:
    per = SMALL.steps_per_iteration
    found = training.train(
        robot, motion, 3 * per, TrainingFolder.at(tmp_path), SMALL, evaluate_every=per, evaluate=briefly
    )
    policy = Policy.load(tmp_path / "policy.npz")
    best = max(found, key=lambda e: e.reward_mean + e.reward_mean_perturbed)
    assert policy.training["steps"] == best.steps
    assert policy.about["library"] == "rsl-rl"
    assert (policy.robot, policy.motion, policy.samples) == ("a1", "side-step", motion.n_samples)
    again = briefly(policy, robot, motion, 0, {"wall_s": 0.0, "cpu_s": 0.0})
    assert (again.reward_mean, again.reward_mean_perturbed) == (best.reward_mean, best.reward_mean_perturbed)
    assert len((tmp_path / "evaluations.csv").read_text().splitlines()) == 4
    assert list((tmp_path / "tensorboard").glob("events.out.tfevents.*"))


def test_the_policy_is_the_librarys_network(robot: Robot, motion: Motion) -> None:
    import torch

    learner = Learner(robot, motion, SMALL)
    learner.iterate()
    seen = np.random.default_rng(0).normal(size=(4, OBSERVATION_SIZE)).astype(np.float32)
    with torch.no_grad():
        expected = learner._algorithm.get_policy()(learner._tensors(seen)).numpy()
    assert actions_of(learner.policy(), seen) == pytest.approx(expected, abs=1e-4)
    onnx = learner.onnx()
    learner.close()
    runtime = pytest.importorskip("onnxruntime", reason="onnxruntime is not installed")
    answer = runtime.InferenceSession(onnx).run(["actions"], {"obs": seen})[0]
    assert answer == pytest.approx(expected, abs=1e-5)


TINY = ("--robots", "4", "--hidden", "8", "--threads", "1", "--device", "cpu")


def test_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "run"
    arguments = ["train", "side-step", "--steps", "100", *TINY, "--out", str(out)]
    assert main(arguments) == 0
    assert {"policy.npz", "policy.onnx", "checkpoint.pt", "config.json", "evaluations.csv"} <= {
        file.name for file in out.iterdir()
    }
    assert main(["evaluate", "side-step", "--policy", str(out / "policy.npz"), "--duration", "0.5"]) == 0
    capsys.readouterr()

    def refused(*more: str) -> str:
        assert main([*arguments, *more]) == 2
        return capsys.readouterr().err

    assert "holds a training; --resume goes on with it" in refused()
    assert "a training of other settings (seed 0)" in refused("--resume", "--seed", "1")
    assert "give one of them" in refused("--resume", "--overwrite")
    assert "device 'cuda:9' cannot be used" in refused("--overwrite", "--device", "cuda:9")
    assert main([*arguments, "--resume"]) == 0  # nothing is left to do
    (out / "checkpoint.pt").write_bytes(b"nothing")
    assert "damaged checkpoint" in refused("--resume")
    assert main([*arguments, "--overwrite"]) == 0
    (out / "checkpoint.pt").unlink()  # as after Ctrl-C within the first minute
    assert "holds no training to resume" in refused("--resume")
    assert main(arguments) == 0
    (out / "config.json").write_text("{}")
    assert "of something else; choose another --out" in refused("--overwrite")


def test_settings_out_of_range_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="robots must be at least 1"):
        TrainingSettings(robots=0)
    with pytest.raises(ConfigError, match="hidden layers need a width"):
        TrainingSettings(hidden=())
    with pytest.raises(CheckpointError, match="no checkpoint to resume from"):
        TrainingFolder.at(tmp_path).load()
