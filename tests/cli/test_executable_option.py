"""`--executable`: the nearest motion that the robot can execute, by optimal control."""

import json
from pathlib import Path

import numpy as np

from cli.running import TINY, Run
from fastmimic.motion.motion import Motion


def test_retarget_says_what_gave_and_evaluate_scores_against_the_animal(run: Run, in_folder: Path) -> None:
    done = run("retarget", "turn", "--executable", "--out", "turn.npz")
    assert done.status == 0, done.err
    assert "executable: speed × " in done.out
    motion = Motion.load("turn.npz")
    assert motion.animal is not None
    assert np.abs(motion.root_pos_w - motion.animal.root_pos_w).max() > 1e-3
    done = run("evaluate", "turn.npz", "--duration", "0.6", "--episodes", "2", "--json")
    found = json.loads(done.out)
    assert 0.9 < found["reward_animal"] < found["reward_mean"]
    assert "reward against the animal" in run("evaluate", "turn.npz", "--duration", "0.2").out
    assert "reward_animal" not in json.loads(run("evaluate", "trot", "--duration", "0.2", "--json").out)


def test_imitate_optimises_an_executable_motion(run: Run, in_folder: Path) -> None:
    done = run("imitate", "turn", "--executable", *TINY, "--out", "out")
    assert done.status == 0, done.err
    assert "reward against the animal" in done.out
    rewards = json.loads(Path("out/metrics.json").read_text())["reward_animal"]
    assert set(rewards) == {"before", "after"}
    assert Motion.load("out/motion.npz").target.animal is not None


def test_a_robot_motion_is_refused(run: Run, in_folder: Path) -> None:
    assert run("retarget", "turn", "--out", "turn.npz").status == 0
    assert "executable cannot be applied to 'turn'" in run("evaluate", "turn.npz", "--executable").error


def test_a_motion_that_does_not_repeat(run: Run) -> None:
    found = json.loads(run("evaluate", "trot", "--discrete", "--executable", "--json").out)
    assert 0.9 < found["reward_animal"] < found["reward_mean"]
