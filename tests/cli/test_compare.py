"""`fastmimic compare`: what it writes; killed, interrupted and resumed; and what it refuses."""

import csv
import json
import os
import signal
import subprocess
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from cli.running import Run
from fastmimic.experiments.compare import PAPER_MOTIONS
from fastmimic.runs.loading import load_motion

Start = Callable[..., "subprocess.Popen[str]"]
TINY = ("--iterations", "3", "--population", "4", "--duration", "0.6", "--seeds", "1")
LONGER = ("--iterations", "12", *TINY[2:])


def rows(folder: Path) -> list[dict[str, str]]:
    """The CSV without the times."""
    with (folder / "results.csv").open(newline="") as file:
        return [{k: v for k, v in row.items() if k not in ("wall_s", "cpu_s")} for row in csv.DictReader(file)]


def wait_for(process: "subprocess.Popen[str]", text: str) -> None:
    """Reads the process's progress up to a line with that text."""
    assert process.stderr is not None
    seen = []
    for line in process.stderr:
        seen.append(line)
        if text in line:
            return
    raise AssertionError(f"the process ended with {process.wait()} before '{text}': {seen}")


@pytest.mark.slow
def test_writes_tables_and_figures(run: Run, in_folder: Path) -> None:
    done = run("compare", "--motions", "trot", "--methods", "raibert", "mbc-dmp", *TINY, "--workers", "1")
    assert done.status == 0, done.err
    out = in_folder / "runs" / "comparison"
    written = {"results.csv", "table.md", "comparison.png", "tracking.png", "environment.json", "runs", "motions"}
    assert {path.name for path in out.iterdir()} == written
    assert [(row["method"], row["seed"]) for row in rows(out)] == [("raibert", "0"), ("mbc-dmp", "0")]
    assert done.out.startswith((out / "table.md").read_text())
    assert done.out.endswith("results in runs/comparison\n")
    assert "2 runs in runs/comparison, 1 at a time" in done.err
    assert "2/2 trot mbc-dmp seed 0: reward 0." in done.err
    environment = json.loads((out / "environment.json").read_text())
    assert environment["settings"]["iterations"] == 3
    assert environment["motions"] == ["trot"]
    assert environment["controllers"]["raibert"]["swing"]["foothold"] == "raibert"
    assert environment["controllers"]["mbc-dmp"]["swing"]["foothold"] == "regulator"
    assert {"fastmimic", "mujoco", "python"} <= set(environment["versions"])


@pytest.mark.slow
def test_killed_and_resumed_it_ends_with_the_same_rows(run: Run, start: Start, in_folder: Path) -> None:
    arguments = ("compare", "--motions", "trot", "--methods", "mbc", "mbc-dmp", *LONGER, "--workers", "1", "--out")
    assert run(*arguments, "whole").status == 0
    process = start(*arguments, "run")
    wait_for(process, "1/2 trot mbc seed 0")
    checkpoint = in_folder / "run" / "runs" / "trot-mbc-dmp-seed0" / "checkpoint.npz"
    while not checkpoint.exists():
        assert process.poll() is None, "finished before it could be killed"
    process.kill()
    process.wait()
    resumed = run(*arguments, "run", "--resume")
    assert resumed.status == 0
    assert "2/2 trot mbc-dmp seed 0" in resumed.err
    assert rows(in_folder / "run") == rows(in_folder / "whole")


@pytest.mark.slow
def test_ctrl_c_stops_all_processes_and_says_how_to_go_on(start: Start, in_folder: Path) -> None:
    process = start(
        *("compare", "--motions", "trot", "--methods", "mbc", "mbc-dmp", "--seeds", "2", "--iterations", "500"),
        *("--workers", "2", "--out", "run"),
    )
    wait_for(process, "1/3 trot mbc seed 0")
    children = [int(pid) for pid in Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split()]
    assert len(children) >= 2
    process.send_signal(signal.SIGINT)
    _, error = process.communicate(timeout=60)
    assert process.returncode == 130
    assert "--resume continues" in error
    assert "Traceback" not in error
    gone_by = time.monotonic() + 20
    while any(alive(child) for child in children):
        assert time.monotonic() < gone_by, "processes are left"
    assert (in_folder / "run" / "runs" / "trot-mbc-seed0" / "row.json").is_file()
    table = (in_folder / "run" / "table.md").read_text()
    assert "**Unfinished: 1 of 3 runs.**" in table
    assert [row["method"] for row in rows(in_folder / "run")] == ["mbc"]
    assert {path.name for path in (in_folder / "run").glob("*.png")} == {"comparison.png"}


@pytest.mark.slow
def test_a_run_that_fails_leaves_tables_of_the_others(run: Run, in_folder: Path) -> None:
    arguments = ("compare", "--motions", "trot", "--methods", "mbc", "mbc-dmp", *TINY, "--workers", "1")
    checkpoint = in_folder / "runs" / "comparison" / "runs" / "trot-mbc-dmp-seed0" / "checkpoint.npz"
    assert run(*arguments, "--methods", "mbc").status == 0
    checkpoint.parent.mkdir()
    checkpoint.write_bytes(b"damaged")
    failed = run(*arguments, "--resume")
    assert failed.status == 2
    assert f"{checkpoint.relative_to(in_folder)}: " in failed.err.splitlines()[-1]
    assert "**Unfinished: 1 of 2 runs.**" in (in_folder / "runs" / "comparison" / "table.md").read_text()
    checkpoint.unlink()
    assert run(*arguments, "--resume").status == 0


def alive(pid: int) -> bool:
    """Whether a process runs still; what has ended but was not waited for does not."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"
    except FileNotFoundError:
        return False


@pytest.mark.slow
def test_a_folder_with_a_comparison_is_refused_unless_asked(run: Run, in_folder: Path) -> None:
    command = ("compare", "--motions", "trot", "--methods", "mbc", *TINY, "--workers", "1", "--out", "run")
    assert run(*command).status == 0
    before = (in_folder / "run" / "results.csv").read_bytes()
    assert "run holds a comparison; --resume goes on with it, --overwrite replaces it" in run(*command).error
    other = ("--config", "paper")
    assert "holds a comparison of other settings (config default)" in run(*command, *other, "--resume").error
    assert (in_folder / "run" / "results.csv").read_bytes() == before
    more = run("compare", "--motions", "trot", "--methods", "mbc", "lh", *TINY, "--out", "run", "--resume")
    assert more.status == 0
    assert [row["method"] for row in rows(in_folder / "run")] == ["mbc", "lh"]
    (in_folder / "run" / "runs" / "notes.txt").write_text("mine")
    assert run(*command, *other, "--overwrite").status == 0
    assert [(row["method"], row["config"]) for row in rows(in_folder / "run")] == [("mbc", "paper")]
    assert {path.name for path in (in_folder / "run" / "runs").iterdir()} == {"notes.txt", "trot-mbc-seed0"}


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--motions", "trto"], "'trto' is neither the name of a motion nor a file; did you mean 'trot'"),
        ([], "run 'fastmimic data fetch'"),
        (["--builtin", "--motions", "trot"], "--builtin selects the four built-in motions"),
        (["--builtin", "--methods", "lhdmp"], "unknown method 'lhdmp'"),
        (["--builtin", "--methods", "mbc", "mbc"], "method mbc is given twice"),
        (["--builtin", "--seeds", "0"], "seeds must be at least 1"),
        (["--builtin", "--methods"], "at least one method; there are raibert, mbc"),
        (["--motions"], "at least one motion"),
        (["--motions", "--builtin"], "--builtin selects the four built-in motions"),
        (["--builtin", "--workers", "0"], "workers must be at least 1"),
        (["--builtin", "--population", "2"], "population must be at least 4"),
        (["--builtin", "--iterations", "0"], "iterations must be at least 1"),
        (["--builtin", "--duration", "nan"], "--duration must be above 0"),
        (["--builtin", "--config", "papre"], "unknown configuration 'papre'"),
        (["--builtin", "--robot", "a2"], "unknown robot 'a2'"),
        (["--builtin", "--resume"], "holds no comparison to resume"),
        (["--builtin", "--resume", "--overwrite"], "give one of them"),
        (["--builtin", "--out", "/proc/nowhere"], "cannot be written to"),
    ],
)
def test_what_it_refuses(arguments: list[str], said: str, run: Run, in_folder: Path) -> None:
    done = run("compare", *arguments)
    assert done.status == 2
    assert said in done.err.splitlines()[-1]
    assert os.listdir(in_folder) == []


def contents(folder: Path) -> dict[str, bytes]:
    """All files below a folder."""
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.mark.parametrize("how", ["--overwrite", "--resume"])
@pytest.mark.parametrize("bad", [("--motions", "trto"), ("--motions", "trot", "other.npz", "--methods", "mbc-dmp")])
def test_what_is_refused_leaves_the_folder_as_it_was(bad: tuple[str, ...], how: str, run: Run, in_folder: Path) -> None:
    load_motion("trot", "go2").save(in_folder / "other.npz")
    command = ("compare", *TINY, "--workers", "1", "--out", "run")
    assert run(*command, "--motions", "trot", "--methods", "mbc").status == 0
    before = contents(in_folder / "run")
    assert run(*command, *bad, how).status == 2
    assert contents(in_folder / "run") == before


def test_another_motion_of_the_same_name_is_refused_before_anything_is_written(run: Run, in_folder: Path) -> None:
    motion = load_motion("trot")
    motion.save(in_folder / "f.npz")
    command = ("compare", "--motions", "f.npz", "--methods", "mbc", *TINY, "--workers", "1", "--out", "run")
    assert run(*command).status == 0
    assert [path.name for path in (in_folder / "run" / "motions").iterdir()] == ["f.npz"]
    before = contents(in_folder / "run")
    replace(motion, joint_pos=motion.joint_pos + 0.01).save(in_folder / "f.npz")
    more = (*command[:4], "lh", *command[4:], "--resume")
    refused = run(*more)
    assert refused.status == 2
    assert "a finished run of another controller, motion or robot" in refused.err.splitlines()[-1]
    assert contents(in_folder / "run") == before


@pytest.mark.slow
def test_resumed_with_less_the_results_cover_what_was_finished(run: Run, in_folder: Path) -> None:
    command = ("compare", *TINY, "--workers", "1", "--out", "run")
    assert run(*command, "--motions", "trot", "--methods", "mbc", "mbc-dmp").status == 0
    more = run(*command, "--motions", "pace", "--methods", "raibert", "--resume")
    assert more.status == 0, more.err
    assert "the results include 2 more finished runs from the folder" in more.err
    found = [(row["motion"], row["method"]) for row in rows(in_folder / "run")]
    assert found == [("trot", "mbc"), ("pace", "raibert"), ("trot", "mbc-dmp")]
    table = (in_folder / "run" / "table.md").read_text()
    assert "MBC-DMP" in table
    assert "Unfinished" not in table
    assert (in_folder / "run" / "tracking.png").is_file()
    environment = json.loads((in_folder / "run" / "environment.json").read_text())
    assert (environment["motions"], environment["methods"]) == (["trot", "pace"], ["raibert", "mbc", "mbc-dmp"])
    assert set(environment["controllers"]) == {"raibert", "mbc", "mbc-dmp"}


def test_a_folder_with_something_else_is_not_touched(run: Run, in_folder: Path) -> None:
    (in_folder / "table.md").write_text("mine")
    assert ". holds table.md of something else" in run("compare", "--builtin", "--out", ".").error
    assert ". holds table.md of something else" in run("compare", "--builtin", "--out", ".", "--overwrite").error
    assert (in_folder / "table.md").read_text() == "mine"


def test_the_default_is_the_papers_set() -> None:
    assert PAPER_MOTIONS == ("dog:trot", "dog:pace", "dog:right-turn", "anim:side-steps")
