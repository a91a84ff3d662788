"""`fastmimic stitch`: what it writes; repeated, interrupted and resumed; what takes its result; and bad input."""

import contextlib
import io
import json
import shutil
import signal
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cli.running import Outcome, Run, wait_for_iteration
from cli.test_imitate import assert_same_run, metrics
from fastmimic.motion.motion import Motion
from searches import quick_main

TINY = ("--cycles", "2", "--iterations", "2", "--part-iterations", "2", "--population", "4", "--no-video")


@pytest.fixture(scope="module")
def first(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Outcome]:
    """A finished run of trot and turn in its default folder, and what was printed. Not to be changed."""
    folder = tmp_path_factory.mktemp("first")
    out, err = io.StringIO(), io.StringIO()
    with contextlib.chdir(folder), contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        status = quick_main(["stitch", "trot", "turn", *TINY])
    return folder / "runs" / "trot+turn-a1-mbc-dmp-0", Outcome(status, out.getvalue(), err.getvalue())


def test_writes_what_imitate_writes(first: tuple[Path, Outcome]) -> None:
    out, done = first
    assert done.status == 0, done.err
    assert {path.name for path in out.iterdir()} == {
        "motion.npz",
        "metrics.json",
        "config.json",
        "convergence.png",
        "tracking.png",
        "checkpoint.npz",
        "checkpoint-1.npz",
        "checkpoint-2.npz",
    }
    assert "results in runs/trot+turn-a1-mbc-dmp-0" in done.out
    assert "trot by itself, 1 of 2" in done.err
    motion = Motion.load(out / "motion.npz")
    assert motion.cycle is None
    assert [part.name for part in motion.target.parts] == ["trot", "turn"]
    assert json.loads((out / "config.json").read_text())["arguments"]["motions"] == ["trot", "turn"]


def test_metrics_tell_of_each_segment(first: tuple[Path, Outcome]) -> None:
    found = metrics(first[0])
    assert found["motion"] == "trot+turn"
    assert found["fell"] == {"before": False, "after": False}
    one, other = found["segments"]
    assert (one["motion"], other["motion"]) == ("trot", "turn")
    assert (one["cycles"], other["cycles"]) == (2, 2)
    assert one["first_s"] == 0
    assert one["last_s"] == other["first_s"]
    assert other["last_s"] == pytest.approx(found["duration_s"] + 0.002)
    lengths = np.array([one["last_s"], other["last_s"] - 0.002 - other["first_s"]])
    for when in ("before", "after"):
        rewards = np.array([one["reward"][when], other["reward"][when]])
        assert rewards @ lengths / lengths.sum() == pytest.approx(found["reward"][when])
    assert 0 < found["individual_optima"]["reward"] <= 1
    assert len(found["transitions"]) == 1
    assert len(found["parameters"]) == 16
    assert found["parameters"][8]["name"] == "2:turn/FR_foot_z.goal"


@pytest.mark.slow
def test_the_same_at_any_number_of_workers(first: tuple[Path, Outcome], run: Run) -> None:
    assert run("stitch", "trot", "turn", *TINY, "--workers", "3", "--out", "again").status == 0
    assert_same_run(first[0], Path("again"))


@pytest.mark.slow
def test_killed_and_resumed_it_is_the_same(
    first: tuple[Path, Outcome], start: Callable[..., "subprocess.Popen[str]"], run: Run
) -> None:
    """Interrupted while the second motion is optimised by itself: what was found of the first is not lost."""
    process = start("stitch", "trot", "turn", *TINY, "--out", "out")
    assert process.stderr is not None
    for line in process.stderr:
        if line.startswith("turn by itself"):
            break
    wait_for_iteration(process, 1)
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 130
    assert "--out out --resume" in err
    assert Path("out/checkpoint-1.npz").exists()
    assert not Path("out/motion.npz").exists()
    done = run("stitch", "trot", "turn", *TINY, "--out", "out", "--resume")
    assert done.status == 0, done.err
    assert_same_run(first[0], Path("out"))


class TestItsResult:
    """The other verbs take it."""

    @pytest.fixture
    def motion(self, first: tuple[Path, Outcome], in_folder: Path) -> Path:
        return Path(shutil.copy(first[0] / "motion.npz", in_folder / "stitched.npz"))

    def figures(self, done: Outcome) -> dict[str, Any]:
        assert done.status == 0, done.err
        return dict(json.loads(done.out))

    def test_evaluate_runs_the_whole(self, motion: Path, run: Run) -> None:
        found = self.figures(run("evaluate", motion, "--episodes", "3", "--json"))
        assert found["duration_s"] == pytest.approx((Motion.load(motion).n_samples - 1) / 500)
        assert found["reward_mean"] > 0.5

    def test_evaluate_a_part_of_it_from_anywhere(self, motion: Path, run: Run) -> None:
        found = self.figures(run("evaluate", motion, "--episodes", "3", "--duration", "0.5", "--json"))
        assert found["duration_s"] == 0.5

    def test_inspect(self, motion: Path, run: Run) -> None:
        done = run("inspect", motion)
        assert done.status == 0, done.err
        assert "segment    trot, 2 cycles" in done.out
        assert "segment    turn, 2 cycles" in done.out
        assert "not periodic" in done.out

    def test_imitate_goes_on_with_it(self, motion: Path, first: tuple[Path, Outcome], run: Run) -> None:
        done = run(
            "imitate", motion, "--iterations", "1", "--population", "4", "--duration", "9", "--no-video", "--out", "on"
        )
        assert done.status == 0, done.err
        found = metrics(Path("on"))
        assert len(found["parameters"]) == 16
        assert found["duration_s"] == metrics(first[0])["duration_s"]
        assert len(found["segments"]) == 2
        assert found["reward"]["after"] >= metrics(first[0])["reward"]["after"] - 0.02


def test_a_folder_of_the_same_name_does_not_hide_a_motion(
    first: tuple[Path, Outcome], run: Run, in_folder: Path
) -> None:
    (in_folder / "trot").mkdir()
    shutil.copytree(first[0], in_folder / "turn", ignore=shutil.ignore_patterns("*.json"))
    done = run("stitch", "trot", "turn", "--cycles", "2", "--method", "mbc", "--no-video")
    assert done.status == 0, done.err
    assert Path("runs/trot+turn-a1-mbc-0/motion.npz").is_file()
    done = run("stitch", "trot", "./turn", "--method", "mbc", "--no-video")
    assert "motion 'trot+turn' does not repeat" in done.err, "what is in the folder, itself stitched"


FEW = ("--iterations", "1")


class TestBadInput:
    @pytest.mark.parametrize(
        ("arguments", "message"),
        [
            (["trot"], "stitch takes at least two motions, found 1"),
            (
                ["trot", "turn", "--cycles", "1", "2", "3"],
                "--cycles takes one number, or one for each of the 2 motions",
            ),
            (["trot", "turn", "--cycles", "0"], "every motion needs at least one cycle, found 0\n"),
            (["trot", "turn", "--cycles", "1", "0"], "every motion needs at least one cycle, found 0 for 'turn'"),
            (["trot", "turn", "--cycles", "100000"], "the stitched motion would be longer than 600 s"),
            (["trot", "turn", "--workers", "0"], "workers must be at least 1, found 0"),
            (["trot", ""], "a motion without a name"),
            (["trot", "turn", "trot", "--cycles", "1"], "is too short for its transitions; give it more cycles"),
            (["trot", "nothing"], "nothing"),
            (["trot", "turn", "--iterations", "0"], "iterations must be at least 1"),
            (["trot", "turn", "--method", "mbcd"], "unknown method 'mbcd'"),
            (["trot", "turn", "--resume", "--out", "empty"], "no checkpoint to resume from"),
        ],
    )
    def test_one_line_and_nothing_written(self, run: Run, arguments: list[str], message: str) -> None:
        done = run("stitch", *arguments, "--part-iterations", "1", *([] if "--iterations" in arguments else FEW))
        notes = [line for line in done.err.splitlines() if not line.startswith("fastmimic: error: ")]
        assert done.status == 2, done
        assert message in done.err
        # the second: of the first process in which kernels are compiled
        assert all(note.startswith(("stitching ", "preparing")) for note in notes), notes
        assert not Path("runs").exists()
        assert not Path("empty").exists()
