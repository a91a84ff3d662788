"""What a user gets wrong: one clear line, status 2, and nothing written or changed."""

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from cli.running import TINY, Run
from clips.sample_files import keypoint_text, save_motion

BIPED = """<mujoco><worldbody><body name="trunk"><freejoint/><geom size=".1" mass="1"/>
<body name="left"><joint name="left_hip" range="-1 1"/><geom size=".05" mass="1"/></body>
<body name="right"><joint name="right_hip" range="-1 1"/><geom size=".05" mass="1"/></body>
</body></worldbody></mujoco>"""


def write(name: str, content: str | bytes) -> Callable[[Path], Path]:
    def make(folder: Path) -> Path:
        path = folder / name
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        return path

    return make


def truncated_motion(folder: Path) -> Path:
    path = save_motion(folder / "cut.npz")
    path.write_bytes(path.read_bytes()[:500])
    return path


def policy(folder: Path) -> Path:
    """A file with a version as motions have it, and otherwise none of their arrays."""
    np.savez(
        path := folder / "policy.npz", format_version=np.int64(1), meta_json=np.str_("{}"), weight0=np.zeros((2, 2))
    )
    return path


KEYPOINTS = keypoint_text(12)
FILES = {
    "missing": (lambda folder: folder / "none.txt", "none.txt: no such file"),
    "empty": (write("empty.txt", ""), "the file is empty"),
    "binary": (write("binary.txt", bytes(range(256))), "a binary file"),
    "folder": (lambda folder: folder, "a folder without motion.npz"),
    "columns": (write("columns.txt", "1,2,3\n4,5,6\n"), "line 1 has 3 columns"),
    "not finite": (write("inf.txt", re.sub(r"^[^,]+", "inf", KEYPOINTS, flags=re.MULTILINE)), "line 1, column 1"),
    "one frame": (write("one.txt", KEYPOINTS.splitlines()[0]), "frame"),
    "truncated json": (write("cut.json", '{"Frames": [[1, 2'), "cut.json"),
    "other npz": (policy, "not a FastMimic motion: array"),
    "truncated npz": (truncated_motion, "not a readable .npz motion"),
}


@pytest.mark.parametrize("verb", ["imitate", "evaluate", "inspect", "retarget", "render"])
@pytest.mark.parametrize("kind", FILES)
def test_a_file_that_cannot_be_used(kind: str, verb: str, run: Run, tmp_path: Path) -> None:
    make, said = FILES[kind]
    path = make(tmp_path)
    before = sorted(tmp_path.iterdir())
    out = {"retarget": ["--out", "out.npz"], "render": ["--out", "out.mp4"]}.get(verb, [])
    error = run(verb, path, *out).error
    assert verb == "retarget" or said in error
    assert str(path) in error
    assert sorted(tmp_path.iterdir()) == before


ARGUMENTS = {
    "unknown motion": (["trto"], "'trto' is neither the name of a motion nor a file; did you mean 'trot'"),
    "not fetched": (["dog:pace"], "run 'fastmimic data fetch'"),
    "frames out of range": (
        ["trot", "--frames", "0:4000"],
        "frames 0:4000 are not in this clip of 60 frames",
    ),
    "frames that are none": (["trot", "--frames", "3-4"], "--frames takes FIRST:END"),
    "empty frames": (["trot", "--frames", "5:5"], "frames 5:5"),
    "rate of a built-in gait": (["trot", "--fps", "60"], "cannot be set for 'trot'"),
    "axis": (["{clip}", "--up", "w"], "must be one of y, z, x, -y, -z, -x, found 'w'"),
    "rate": (["{clip}", "--fps", "nan"], "nan"),
    "scale": (["trot", "--scale", "-1"], "scale"),
    "speed": (["trot", "--speed", "99"], "speed must be between"),
    "duty": (["trot", "--duty", "nan"], "duty must be between"),
    "unknown robot": (["trot", "--robot", "a2"], "unknown robot 'a2'"),
    "other joints": (["trot", "--robot", "{biped}"], "biped.xml"),
    "a robot that is no model": (["trot", "--robot", "{clip}"], "not a readable MJCF"),
    "another robot's motion": (["{go1}", "--robot", "a1"], "is for robot 'go1', not for 'a1'"),
    "duration": (["trot", "--duration", "nan"], "--duration must be above 0"),
    "no duration": (["trot", "--duration", "0"], "--duration must be above 0"),
    "endless": (["trot", "--duration", "1e9"], "at most 3600 s"),
    "configuration": (["trot", "--config", "papre"], "unknown configuration 'papre'"),
}
ONLY_IMITATE = {
    "method": (["trot", "--method", "mpc"], "unknown method 'mpc'"),
    "iterations": (["trot", "--iterations", "0"], "iterations must be at least 1"),
    "population": (["trot", "--population", "3"], "population must be at least 4"),
    "seed": (["trot", "--seed", "-1"], "seed must not be negative"),
    "workers": (["trot", "--workers", "0"], "workers must be at least 1"),
    "nothing to resume": (["trot", "--resume"], "no checkpoint to resume from"),
    "no optimisation to resume": (
        ["trot", "--resume", "--no-optimize"],
        "does not search, so there is nothing to resume",
    ),
    "resume and overwrite": (["trot", "--resume", "--overwrite"], "give one of them"),
    "a file for a folder": (["trot", "--out", "{clip}"], "cannot be written to"),
    "a folder in a file": (["trot", "--out", "{clip}/run"], "cannot be written to"),
    "nowhere": (["trot", "--out", "/proc/nowhere/run"], "cannot be written to"),
}
ONLY_EVALUATE = {
    "episodes": (["trot", "--episodes", "0"], "episodes must be at least 1"),
    "seed": (["trot", "--seed", "-1"], "seed must not be negative"),
}


@pytest.fixture
def files(tmp_path: Path) -> dict[str, str]:
    """Files that the arguments may name."""
    (tmp_path / "clip.txt").write_text(KEYPOINTS)
    (tmp_path / "biped.xml").write_text(BIPED)
    motion = save_motion(tmp_path / "plain.npz")
    with np.load(motion) as arrays:
        np.savez(tmp_path / "go1.npz", **{**arrays, "meta_json": np.str_('{"name": "walk", "robot": "go1"}')})
    motion.unlink()
    return {"clip": str(tmp_path / "clip.txt"), "biped": "biped.xml", "go1": "go1.npz"}


def given(arguments: list[str], files: dict[str, str]) -> list[str]:
    return [a.format(**files) for a in arguments]


@pytest.mark.parametrize("kind", [*ARGUMENTS, *ONLY_IMITATE])
def test_imitate_refuses(kind: str, run: Run, tmp_path: Path, files: dict[str, str]) -> None:
    arguments, said = (ARGUMENTS | ONLY_IMITATE)[kind]
    tiny = [] if kind in ("duration", "no duration", "endless", "iterations", "population") else TINY
    before = sorted(tmp_path.iterdir())
    done = run("imitate", *tiny, *given(arguments, files))
    assert done.status == 2
    assert said in done.err.splitlines()[-1]
    assert sorted(tmp_path.iterdir()) == before


@pytest.mark.parametrize("kind", [*ARGUMENTS, *ONLY_EVALUATE])
def test_evaluate_refuses(kind: str, run: Run, files: dict[str, str]) -> None:
    arguments, said = (ARGUMENTS | ONLY_EVALUATE)[kind]
    assert said in run("evaluate", *given(arguments, files)).error


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["retarget", "trot", "--out", "{clip}/out.npz"], "cannot be written to"),
        (["retarget", "trot", "--out", "out.txt"], "the file's name must end in .npz"),
        (["inspect", "trot", "--figure", "out.gif"], "must end in .png or .pdf or .svg"),
        (["render", "trot", "--out", "out.avi"], "the file's name must end in .mp4 or .gif or .webm"),
        (["render", *5 * ["trot"], "--out", "out.mp4"], "render takes one to 4 motions, found 5"),
        (
            ["render", "trot", "--out", "out.mp4", "--quality", "best"],
            "unknown quality 'best'; there are preview, high",
        ),
        (["render", "trot", "--out", "out.mp4", "--method", "mpc"], "unknown method 'mpc'"),
        (
            ["render", *3 * ["trot"], "--out", "out.mp4", "--method", "mbc", "lh"],
            "--method takes one name, or one for each of the 3 motions; found 2",
        ),
        (
            ["render", "trot", "--out", "out.mp4", "--kinematic", "--method", "lh"],
            "--method cannot be applied with --kinematic: there is no controller",
        ),
        (["render", ".", "--out", "out.mp4"], "a folder without motion.npz"),
        (
            ["render", "trot", "--out", "out.mp4", "--kinematic", "--frame-rate", "0"],
            "--frame-rate must be positive, found 0",
        ),
        (
            ["render", "trot", "--out", "out.gif", "--kinematic", "--size", "1920x1080"],
            "a GIF of 100 frames of 1920 x 1080 would be enormous",
        ),
        (["imitate", "trot", "--quality", "best"], "unknown quality 'best'"),
        (["stitch", "trot", "trot", "--quality", "best"], "unknown quality 'best'"),
        (["render", "trot", "--out", "out.mp4", "--size", "large"], "--size takes WIDTHxHEIGHT"),
        (
            ["render", "trot", "--out", "out.mp4", "--slow-motion", "0", "--kinematic"],
            "--slow-motion must be positive, found 0",
        ),
        (["data", "list", "dog_keypoints"], "data list takes no dataset"),
        (["data", "fetch", "cats"], "unknown dataset 'cats'"),
        (["data", "fetch", "--base-url", "http://127.0.0.1:9"], "cannot be reached"),
    ],
)
def test_other_verbs_refuse(arguments: list[str], said: str, run: Run, files: dict[str, str]) -> None:
    assert said in run(*given(arguments, files)).error


def test_a_file_is_not_replaced_by_what_could_not_be_made(run: Run, tmp_path: Path) -> None:
    (tmp_path / "out.npz").write_text("mine")
    run("retarget", "trot", "--frames", "0:99", "--out", "out.npz")
    assert (tmp_path / "out.npz").read_text() == "mine"
