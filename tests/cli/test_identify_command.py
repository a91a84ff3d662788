"""`fastmimic evaluate --log`, `fastmimic identify` and `--config FILE`: from a run to other commands."""

import json
from pathlib import Path

import pytest

from cli.running import Run

SHORT = ("--duration", "1.2", "--observe", "sensors")


def test_from_a_run_to_the_controller(run: Run, in_folder: Path) -> None:
    done = run("evaluate", "trot", *SHORT, "--disturb", "payload=4", "--log", "run.npz")
    assert done.status == 0, done.err
    assert done.out.endswith("log in run.npz\n")
    assert run("evaluate", "trot", *SHORT, "--log", "empty.npz").status == 0
    found = run("identify", "run.npz", "--unloaded", "empty.npz", "--out", "mine.json")
    assert found.status == 0, found.err
    assert "friction                  at least 0." in found.out
    assert "the controller assumes  0.6 as before" in found.out
    assert "use them by --config mine.json" in found.out
    written = json.loads((in_folder / "mine.json").read_text())
    assert written["load"]["mass"] == pytest.approx(4.0, abs=0.5)
    told = run("evaluate", "trot", "--config", "mine.json", "--disturb", "payload=4", "--duration", "0.4")
    assert told.out.startswith("trot on a1 with mbc (mine.json), 1 episode of 0.4 s")
    assert "is for robot 'a1', not 'go1'" in run("evaluate", "trot", "--robot", "go1", "--config", "mine.json").error


def test_one_line_for_what_cannot_be_done(run: Run, in_folder: Path) -> None:
    assert "add --observe sensors" in run("evaluate", "trot", "--log", "run.npz").error
    assert "must end in .npz" in run("evaluate", "trot", *SHORT, "--log", "run.csv").error
    assert "none.npz: no such file" in run("identify", "none.npz").error
    (in_folder / "half.npz").write_bytes(b"PK")
    assert "half.npz: not a readable log of a run" in run("identify", "half.npz").error
    assert "none.json: no such file" in run("evaluate", "trot", "--config", "none.json").error
    assert run("evaluate", "trot", "--observe", "sensors", "--duration", "0.6", "--log", "short.npz").status == 0
    assert "short.npz: the log is 0.60 s long; at least 1 s" in run("identify", "short.npz", "--out", "x.json").error
    assert not (in_folder / "x.json").exists()
