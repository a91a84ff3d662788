"""`fastmimic imitate`: what it writes; repeated, interrupted and resumed; and what it never overwrites."""

import contextlib
import io
import json
import os
import re
import shutil
import signal
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cli.running import TINY, Outcome, Run, wait_for_iteration
from fastmimic.base.conventions import LEGS
from fastmimic.commands.imitate import Imitate
from fastmimic.motion.motion import Motion
from searches import quick_main

Start = Callable[..., "subprocess.Popen[str]"]
TIMES = ("wall_s", "video_s", "realtime_factor")


def arrays(folder: Path) -> dict[str, Any]:
    with np.load(folder / "motion.npz") as file:
        return {name: file[name] for name in file.files}


def metrics(folder: Path) -> dict[str, Any]:
    return json.loads((folder / "metrics.json").read_text())


def assert_same_run(a: Path, b: Path) -> None:
    """The same motion to the last bit, and the same figures but for how long it took."""
    one, other = arrays(a), arrays(b)
    assert one.keys() == other.keys()
    for name in one:
        np.testing.assert_array_equal(one[name], other[name], err_msg=name)
    figures = [{k: v for k, v in metrics(f).items() if k not in TIMES} for f in (a, b)]
    assert figures[0] == figures[1]


def content(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


@pytest.fixture(scope="module")
def first(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Outcome]:
    """A finished run of `trot` in its default folder, and what was printed. Not to be changed."""
    folder = tmp_path_factory.mktemp("first")
    out, err = io.StringIO(), io.StringIO()
    with contextlib.chdir(folder), contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        status = quick_main(["imitate", "trot", *TINY])
    return folder / "runs" / "trot-a1-mbc-dmp-0", Outcome(status, out.getvalue(), err.getvalue())


@pytest.fixture
def copy(first: tuple[Path, Outcome], in_folder: Path) -> Path:
    """A copy of that run, in the working folder `run`."""
    return Path(shutil.copytree(first[0], in_folder / "run"))


def test_writes_the_motion_figures_and_numbers(first: tuple[Path, Outcome]) -> None:
    out, done = first
    assert done.status == 0
    assert {path.name for path in out.iterdir()} == {
        "motion.npz",
        "metrics.json",
        "config.json",
        "convergence.png",
        "tracking.png",
        "checkpoint.npz",
    }
    assert "results in runs/trot-a1-mbc-dmp-0" in done.out
    assert "trot: built in, scale 0.825" in done.err
    motion = Motion.load(out / "motion.npz")
    assert motion.demonstration is not None
    assert motion.provenance.robot == "a1"


def test_metrics_hold_all_figures(first: tuple[Path, Outcome]) -> None:
    found = metrics(first[0])
    assert (found["motion"], found["robot"], found["method"], found["seed"]) == ("trot", "a1", "mbc-dmp", 0)
    assert found["duration_s"] == 0.6
    assert set(found["reward"]) == {"before", "after", "components_before", "components_after"}
    assert set(found["reward"]["components_after"]) == {
        "pose",
        "velocity",
        "end_effector",
        "root_pose",
        "root_velocity",
    }
    assert found["fell"] == {"before": False, "after": False}
    for name in ("drift_m_per_s", "early_contacts_per_s", "stance_slip_m", "foot_z_rmse_m", "foot_x_rmse_m"):
        assert set(found[name]) == {"before", "after"}
        assert all(value >= 0 for value in found[name].values())
    assert set(found["swing_clearance_m"]) == {"demonstration", "before", "after"}
    assert all(len(legs) == 4 for legs in found["swing_clearance_m"].values())
    assert found["iterations"] == 3
    assert found["evaluations"] >= 3 * 4
    assert found["wall_s"] > 0
    assert found["video_s"] is None
    assert found["realtime_factor"] == pytest.approx(found["simulated_s"] / found["wall_s"])
    assert [p["name"] for p in found["parameters"]] == [
        *(f"{leg}_foot_z.goal" for leg in LEGS),
        *(f"{leg}_foot_z.amplitude" for leg in LEGS),
    ]
    assert all(p["lower"] <= p["value"] <= p["upper"] for p in found["parameters"])
    assert [p["unit"] for p in found["parameters"]] == ["m"] * 4 + ["1"] * 4
    assert {"python", "fastmimic", "mujoco", "numpy"} <= set(found["versions"])


def test_the_table_shows_the_figures_of_the_metrics(first: tuple[Path, Outcome]) -> None:
    printed = first[1].out.splitlines()
    found = metrics(first[0])
    gained = any(p["value"] != p["initial"] for p in found["parameters"])
    assert printed[1].split() == ["kinematic", "executable", "optimised" if gained else "fitted"]
    assert ("the search found nothing better: the result is the motion as fitted by DMPs" in printed) is not gained
    as_it_is = f"{found['kinematic']['reward_mean']:.3f}"
    for line, name in ((2, "reward_animal"), (3, "reward")):
        values = [as_it_is, *(f"{found[name][when]:.3f}" for when in ("before", "after"))]
        assert printed[line].split()[-3:] == values


def test_a_motion_that_is_run_once_is_searched_only_when_asked(run: Run, in_folder: Path) -> None:
    done = run("imitate", "trot", "--discrete", "--no-video")
    assert "trot is run once, so nothing is searched; --iterations N optimises it" in done.err
    assert metrics(in_folder / "runs" / "trot-a1-mbc-0")["evaluations"] == 0


def test_config_holds_the_arguments_and_the_controller(run: Run, in_folder: Path) -> None:
    run("imitate", "turn", *TINY, "--yaw-rate", "-0.8", "--config", "paper", "--out", "run")
    config = json.loads((in_folder / "run" / "config.json").read_text())
    assert config["arguments"]["motion"] == "turn"
    assert config["arguments"]["yaw_rate"] == -0.8
    assert config["controller"]["name"] == "paper"
    assert config["controller"]["stance"]["adaptation"] == "paper"
    assert metrics(in_folder / "run")["config"] == "paper"


def test_without_optimisation_the_motion_is_the_retargeted_one(run: Run, in_folder: Path) -> None:
    assert run("imitate", "trot", *TINY, "--no-optimize").status == 0
    out = in_folder / "runs" / "trot-a1-mbc-0"
    assert not (out / "convergence.png").exists()
    assert not (out / "checkpoint.npz").exists()
    found = metrics(out)
    assert (found["method"], found["evaluations"], found["parameters"]) == ("mbc", 0, [])
    assert found["reward"]["before"] == found["reward"]["after"]
    assert Motion.load(out / "motion.npz").demonstration is None


@pytest.mark.slow
def test_the_robot_of_a_motion_is_known(run: Run, in_folder: Path) -> None:
    run("retarget", "walk", "--robot", "go1", "--out", "walk.npz")
    assert run("imitate", "walk.npz", *TINY, "--out", "run").status == 0
    assert metrics(in_folder / "run")["robot"] == "go1"


def test_an_optimised_motion_is_optimised_anew_against_its_demonstration(run: Run, copy: Path) -> None:
    run("imitate", "run/motion.npz", *TINY, "--out", "second")
    one, other = arrays(copy), arrays(copy.parent / "second")
    np.testing.assert_array_equal(one["demonstration_joint_pos"], other["demonstration_joint_pos"])


@pytest.mark.slow
def test_the_number_of_workers_does_not_change_a_bit(run: Run, first: tuple[Path, Outcome], in_folder: Path) -> None:
    for workers in (1, 3):
        run("imitate", "trot", *TINY, "--workers", workers, "--out", f"with-{workers}")
        assert_same_run(in_folder / f"with-{workers}", first[0])  # with one for each core


@pytest.mark.slow
def test_another_seed_is_another_search(run: Run, copy: Path) -> None:
    run("imitate", "trot", *TINY, "--seed", 1, "--out", "other")
    with np.load(copy / "checkpoint.npz") as a, np.load(copy.parent / "other/checkpoint.npz") as b:
        assert a["candidates"].shape == b["candidates"].shape == (3, 4, 8)
        assert not np.array_equal(a["candidates"], b["candidates"])


@pytest.mark.slow
def test_default_folders_are_numbered(run: Run, in_folder: Path) -> None:
    (in_folder / "runs" / "trot-a1-mbc-0").mkdir(parents=True)  # empty: not taken
    said = [run("imitate", "trot", *TINY, "--no-optimize").out.splitlines()[-1] for _ in range(3)]
    name = "results in runs/trot-a1-mbc-0"
    assert said == [name, f"{name}-2", f"{name}-3"]


def test_another_run_is_not_overwritten(run: Run, copy: Path) -> None:
    before = content(copy)
    refused = run("imitate", "trot", *TINY, "--out", "run", "--seed", "1")
    assert refused.error.startswith("run holds another run (seed 0); choose another --out")
    assert content(copy) == before
    (copy / "report.html").write_text("of the run before")
    assert run("imitate", "trot", *TINY, "--out", "run", "--seed", "1", "--overwrite").status == 0
    assert metrics(copy)["seed"] == 1
    assert not (copy / "report.html").exists()


def test_the_same_run_again_takes_the_place_of_the_first(run: Run, copy: Path, first: tuple[Path, Outcome]) -> None:
    again = run("imitate", "trot", *TINY, "--out", "run")
    assert "replacing the run in run" in again.err
    assert metrics(copy)["wall_s"] != metrics(first[0])["wall_s"]  # it ran
    assert_same_run(copy, first[0])


def test_an_interrupted_run_is_not_replaced_but_resumed_or_overwritten(run: Run, copy: Path) -> None:
    interrupted = metrics(copy) | {"interrupted": True}
    (copy / "metrics.json").write_text(json.dumps(interrupted))
    before = content(copy)
    refused = run("imitate", "trot", *TINY, "--out", "run").error
    assert refused.startswith("run holds this run, unfinished")
    assert "--resume" in refused
    assert "--overwrite" in refused
    assert content(copy) == before
    assert run("imitate", "trot", *TINY, "--out", "run", "--resume").status == 0
    assert metrics(copy)["interrupted"] is False


def test_files_of_something_else_are_not_overwritten(run: Run, in_folder: Path) -> None:
    (in_folder / "mine").mkdir()
    (in_folder / "mine" / "config.json").write_text('{"mine": true}')
    assert "mine holds config.json of something else" in run("imitate", "trot", *TINY, "--out", "mine").error
    assert content(in_folder / "mine") == {"config.json": b'{"mine": true}'}


def test_files_of_an_earlier_run_do_not_stay_behind(run: Run, copy: Path) -> None:
    (copy / "video.mp4").write_bytes(b"old")
    run("imitate", "trot", *TINY, "--no-optimize", "--out", "run", "--overwrite")
    assert {path.name for path in copy.iterdir()} == {
        "motion.npz",
        "metrics.json",
        "config.json",
        "tracking.png",
    }


@pytest.mark.slow
def test_more_iterations_go_on_from_a_finished_run(run: Run, copy: Path) -> None:
    """The search itself does not depend on how many iterations were planned."""
    run("imitate", "trot", *TINY, "--iterations", "6", "--out", "run", "--resume")
    run("imitate", "trot", *TINY, "--iterations", "6", "--out", "long")
    assert metrics(copy)["iterations"] == 6
    assert_same_run(copy, copy.parent / "long")


@pytest.mark.parametrize(
    "other",
    [["pace"], ["trot", "--seed", "1"], ["trot", "--config", "paper"], ["trot", "--robot", "go1"]],
    ids=["motion", "seed", "configuration", "robot"],
)
def test_resuming_another_problem_is_refused_and_changes_nothing(other: list[str], run: Run, copy: Path) -> None:
    before = content(copy)
    done = run("imitate", *other, *TINY, "--out", "run", "--resume")
    assert done.status == 2
    assert "this checkpoint is of another problem" in done.err.splitlines()[-1]
    assert content(copy) == before


def test_a_damaged_checkpoint_is_refused(run: Run, copy: Path) -> None:
    checkpoint = copy / "checkpoint.npz"
    checkpoint.write_bytes(checkpoint.read_bytes()[:300])
    done = run("imitate", "trot", *TINY, "--out", "run", "--resume")
    assert done.status == 2
    assert "damaged checkpoint" in done.err.splitlines()[-1]


LONGER = ("--iterations", "16", "--population", "4", "--duration", "0.6", "--no-video")


@pytest.mark.slow
def test_the_last_of_the_name_resumed_after_kill_9_gives_the_same_bits(
    run: Run, start: Start, first: tuple[Path, Outcome], in_folder: Path
) -> None:
    shutil.copytree(first[0], in_folder / "runs" / first[0].name)
    process = start("imitate", "trot", *LONGER)
    wait_for_iteration(process, 6)
    process.kill()
    assert process.wait() == -signal.SIGKILL
    killed = in_folder / "runs" / "trot-a1-mbc-dmp-0-2"
    assert {path.name for path in killed.iterdir()} == {"config.json", "checkpoint.npz"}
    done = run("imitate", "trot", *LONGER, "--resume")
    assert done.status == 0
    assert done.out.splitlines()[-1] == "results in runs/trot-a1-mbc-dmp-0-2"
    assert metrics(killed)["iterations"] == 16
    assert run("imitate", "trot", *LONGER, "--out", "whole").status == 0
    assert_same_run(killed, in_folder / "whole")


@pytest.mark.slow
def test_ctrl_c_leaves_a_usable_result(run: Run, start: Start, in_folder: Path) -> None:
    endless = ("--iterations", "100000", "--population", "4", "--duration", "0.6", "--no-video")
    process = start("imitate", "trot", *endless, "--out", "stopped")
    while not (in_folder / "stopped" / "checkpoint.npz").exists():
        with contextlib.suppress(subprocess.TimeoutExpired):
            raise AssertionError(f"ended early: {process.communicate(timeout=0.05)}")
    process.send_signal(signal.SIGINT)
    out, err = process.communicate()
    assert process.returncode == 130, err
    assert "results in stopped" in out
    assert "interrupted after" in err.splitlines()[-1]
    found = metrics(in_folder / "stopped")
    assert found["interrupted"] is True
    assert 5 <= found["iterations"] < 100_000
    before = content(in_folder / "stopped")
    assert "stopped holds this run, unfinished" in run("imitate", "trot", *endless, "--out", "stopped").error
    assert content(in_folder / "stopped") == before
    done = run("evaluate", "stopped/motion.npz", "--duration", "0.6", "--json")
    assert json.loads(done.out)["reward_mean"] == pytest.approx(found["reward"]["after"], abs=1e-12)


def test_ctrl_c_before_there_is_anything_leaves_nothing(
    run: Run, in_folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(*arguments: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(Imitate, "_imitate", interrupted)
    done = run("imitate", "trot", *TINY, "--out", "deep/run")
    assert (done.status, done.out) == (130, "")
    assert list(in_folder.iterdir()) == []


@pytest.mark.slow
def test_a_terminal_gets_a_bar_with_the_best_reward_and_the_time_left(start: Start, in_folder: Path) -> None:
    terminal, end = os.openpty()
    process = start("imitate", "trot", *TINY, stderr=end)
    os.close(end)
    shown = b""
    with contextlib.suppress(OSError):  # how a terminal ends
        while part := os.read(terminal, 4096):
            shown += part
    os.close(terminal)
    assert process.wait() == 0, shown
    text = shown.decode(errors="replace")
    assert re.search(r"3/3.*best 0\.\d{3}  \d+ evaluations/s  0:00 left", text), text
    assert "validating" in text


@pytest.mark.slow
def test_a_movement_that_does_not_repeat(run: Run, in_folder: Path) -> None:
    done = run("imitate", "trot", "--discrete", *TINY, "--out", "once")
    assert done.status == 0
    assert "run once, ends in mid-stride" in done.err
    motion = Motion.load("once/motion.npz")
    assert motion.cycle is None
    assert metrics(Path("once"))["duration_s"] == pytest.approx((motion.n_samples - 1) / motion.rate_hz)
    assert json.loads(Path("once/config.json").read_text())["arguments"]["discrete"] is True
    assert "another run (discrete True)" in run("imitate", "trot", *TINY, "--out", "once").error
    again = run("evaluate", "once/motion.npz", "--json")
    assert json.loads(again.out)["duration_s"] == metrics(Path("once"))["duration_s"]
    refused = run("imitate", "once/motion.npz", "--discrete", *TINY).error
    assert "cycle cannot be applied to 'trot': it is already a robot motion" in refused
