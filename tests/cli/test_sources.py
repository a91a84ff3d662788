"""Every verb that takes a motion takes the folder of a run."""

import json
from pathlib import Path

import pytest

from cli.running import TINY, Run
from fastmimic.clips.catalogue import open_clip
from fastmimic.dataset.excerpts import find_sources
from fastmimic.motion.motion import Motion
from fastmimic.primitive import MotionDmp
from fastmimic.retargeting.retarget import retarget
from fastmimic.robot import Robot

SHORT = ("--episodes", "1", "--duration", "0.2")
VERBS = {
    "imitate": TINY,
    "evaluate": ("--duration", "0.2"),
    "inspect": (),
    "export": ("--format", "csv", "--out", "out.csv"),
    "stress": ("--methods", "mbc", "--disturbances", "com-x", *SHORT),
    "render": ("--kinematic", "--duration", "0.1", "--size", "160x120", "--out", "out.gif"),
    "deploy": ("--driver", "sim", "--lock-step", "--duration", "0.2"),
    "stitch": ("./trot", "--cycles", "4", "--method", "mbc", "--no-video"),
}


@pytest.fixture(scope="module")
def optimised(robot: Robot) -> Motion:
    """A trot with a foot that lifts otherwise."""
    dmp = MotionDmp.fit(retarget(open_clip("trot"), robot)[0], robot)
    goal = dmp.goal
    goal[dmp.index("FR_foot_z")] += 0.004
    return dmp.motion(goal)


@pytest.fixture
def folder(optimised: Motion, in_folder: Path) -> str:
    """The folder of an optimised trot, called like a name that is something else."""
    for name in ("run", "trot"):
        optimised.save(in_folder / name / "motion.npz")
    return "run"


@pytest.mark.slow
@pytest.mark.parametrize("verb", VERBS)
def test_a_verb_takes_a_folder(verb: str, folder: str, run: Run) -> None:
    done = run(verb, folder, *VERBS[verb])
    assert done.status == 0 or "no OpenGL" in done.err, done.err


def test_transfer_takes_a_folder(folder: str, run: Run) -> None:
    pytest.importorskip("pybullet", reason="PyBullet is not installed: pip install 'fastmimic[pybullet]'")
    done = run("transfer", folder, "--methods", "mbc", "--trials", "1", "--duration", "0.2")
    assert done.status == 0, done.err


def test_compare_takes_a_folder(folder: str, run: Run) -> None:
    done = run("compare", "--motions", folder, "--methods", "mbc", "--duration", "0.2", "--workers", "1")
    assert done.status == 0, done.err


def test_train_takes_a_folder(folder: str, run: Run) -> None:
    pytest.importorskip("torch", reason="the extra 'learn' is not installed")
    done = run("train", folder, "--steps", "1", "--robots", "1", "--device", "cpu", "--overwrite", "--resume")
    assert "give one of them" in done.err  # which is said once the motion is loaded


def test_the_folder_is_the_motion_in_it(folder: str, run: Run) -> None:
    found = [
        json.loads(run("evaluate", source, "--duration", "0.2", "--json").out) for source in (folder, "run/motion.npz")
    ]
    assert found[0] == found[1]
    named = json.loads(run("evaluate", "trot", "--duration", "0.2", "--json").out)
    assert named["reward_mean"] != found[0]["reward_mean"], "a name goes before a folder of that name"


def test_a_clip_is_needed_to_retarget(folder: str, run: Run) -> None:
    assert "run: already a robot motion" in run("retarget", folder, "--out", "out.npz").error
    assert "run: already a robot motion" in run("segment", folder).error


def test_a_library_takes_the_motion_of_a_run_and_nothing_else(folder: str, in_folder: Path) -> None:
    (Path(folder) / "checkpoint.npz").write_bytes(b"of a search")
    (source,) = find_sources(folder)
    assert Path(source.place).name == "motion.npz"
