"""Every clip becomes the nearest motion that the robot can execute; `--no-executable` stops at the kinematic motion."""

import json
from pathlib import Path

import numpy as np

from cli.running import TINY, Run
from fastmimic.motion.motion import Motion


def test_retarget_says_what_gave_and_evaluate_scores_against_the_animal(run: Run, in_folder: Path) -> None:
    done = run("retarget", "turn", "--out", "turn.npz")
    assert done.status == 0, done.err
    assert "executable: speed × " in done.out
    motion = Motion.load("turn.npz")
    assert motion.animal is not None
    assert np.abs(motion.root_pos_w - motion.animal.root_pos_w).max() > 1e-3
    done = run("evaluate", "turn.npz", "--duration", "0.6", "--episodes", "2", "--json")
    found = json.loads(done.out)
    assert 0.9 < found["reward_animal"] < found["reward_mean"]
    assert "reward against the animal" in run("evaluate", "turn.npz", "--duration", "0.2").out


def test_the_kinematic_motion_is_the_animal_of_the_executable_one(run: Run, in_folder: Path) -> None:
    assert "executable" not in run("retarget", "turn", "--no-executable", "--out", "kinematic.npz").out
    assert run("retarget", "turn", "--out", "turn.npz").status == 0
    kinematic, executable = Motion.load("kinematic.npz"), Motion.load("turn.npz")
    assert kinematic.animal is None
    assert executable.animal is not None
    found = executable.animal.foot_pos_b.mean(axis=0)
    np.testing.assert_allclose(found, kinematic.foot_pos_b.mean(axis=0), atol=1e-3)
    done = run("evaluate", "trot", "--no-executable", "--duration", "0.2", "--json")
    assert "reward_animal" not in json.loads(done.out)


def test_imitate_optimises_an_executable_motion(run: Run, in_folder: Path) -> None:
    done = run("imitate", "turn", *TINY, "--out", "out")
    assert done.status == 0, done.err
    assert "reward against the animal" in done.out
    rewards = json.loads(Path("out/metrics.json").read_text())["reward_animal"]
    assert set(rewards) == {"before", "after"}
    assert Motion.load("out/motion.npz").target.animal is not None


def test_a_robot_motion_is_refused(run: Run, in_folder: Path) -> None:
    assert run("retarget", "turn", "--out", "turn.npz").status == 0
    assert "executable cannot be applied to 'turn'" in run("evaluate", "turn.npz", "--no-executable").error


def test_a_motion_that_does_not_repeat(run: Run) -> None:
    found = json.loads(run("evaluate", "trot", "--discrete", "--json").out)
    assert 0.9 < found["reward_animal"] < found["reward_mean"]


def test_the_user_decides_whether_a_clip_repeats(run: Run) -> None:
    asked = ("evaluate", "trot", "--frames", "0:20", "--no-executable")
    assert "run once" in run(*asked).err  # its end does not lead back to its beginning
    assert "per cycle" in run(*asked, "--cycle").err
    assert "drop one of the two" in run(*asked, "--cycle", "--discrete").error
