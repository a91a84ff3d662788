"""What was solved before: the built-in motions come solved; an answer is kept for its question alone."""

import os
from pathlib import Path

import numpy as np
import pytest

from fastmimic.clips.synthesis import GAITS, JUMPS
from fastmimic.robot import load_robot
from fastmimic.runs.loading import find_motion
from fastmimic.trajectory import solved
from fastmimic.trajectory.solved import Remembered


@pytest.fixture(autouse=True)
def empty_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    return tmp_path / "fastmimic" / "executable"


def no_solver(*_: object) -> None:
    raise AssertionError("not in the package as it is now: run python benchmarks/keep_solutions.py")


@pytest.mark.slow
@pytest.mark.parametrize("robot", ["a1", "go1", "go2"])
def test_the_package_has_the_built_in_motions(robot: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("fastmimic.trajectory.solve.make_solver", no_solver)
    for name in (*GAITS, *JUMPS):
        motion, report = find_motion(name).retarget(load_robot(robot))
        assert motion.animal is not None
        assert report.executable is not None
        assert report.executable.fell <= 1 / 35 or motion.cycle is None  # of 35 starts, without recovery steps


def test_an_answer_is_kept_for_its_question(empty_cache: Path) -> None:
    question = Remembered("what", [np.arange(3.0), np.array([True])])
    assert question.read() is None
    question.keep({"answer": np.array(42.0)})
    again = Remembered("what", [np.arange(3.0), np.array([True])]).read()
    assert again is not None
    assert again["answer"] == 42.0
    for other in (
        Remembered("else", [np.arange(3.0), np.array([True])]),
        Remembered("what", [np.arange(3.0) + 1e-12, np.array([True])]),
        Remembered("what", [np.arange(3.0), np.array([False])]),
        Remembered("what", [np.arange(3.0), np.array([True])], outcome=True),
    ):
        assert other.read() is None
    (file,) = empty_cache.glob("*.npz")
    file.write_bytes(b"damaged")
    assert question.read() is None


def test_the_oldest_make_room(empty_cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    questions = [Remembered(name, [np.zeros(3)]) for name in "abc"]
    for second, question in enumerate(questions):
        question.keep({"answer": np.zeros(100)})
        newest = max(empty_cache.glob("*.npz"), key=lambda file: file.stat().st_mtime)
        os.utime(newest, (second, second))
        monkeypatch.setattr(solved, "MOST_BYTES", 2.5 * newest.stat().st_size)
    assert [question.read() is None for question in questions] == [True, False, False]
