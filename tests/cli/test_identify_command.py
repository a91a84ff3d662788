"""`fastmimic identify` and `--config FILE`: from a deployment to other commands."""

import json
from pathlib import Path

import pytest

from cli.running import Run

DEPLOY = ("deploy", "trot", "--driver", "sim", "--lock-step", "--duration", "1.2")


@pytest.mark.slow
def test_from_a_deployment_to_the_controller(run: Run, in_folder: Path) -> None:
    for folder, more in (("loaded", ("--disturb", "payload=4")), ("empty", ())):
        done = run(*DEPLOY, *more, "--out", folder)
        assert done.status == 0, done.err
    found = run("identify", "loaded", "--unloaded", "empty", "--out", "mine.json")
    assert found.status == 0, found.err
    assert "friction                  at least 0." in found.out
    assert "the controller assumes  0.6 as before" in found.out
    assert "use them by --config mine.json" in found.out
    written = json.loads((in_folder / "mine.json").read_text())
    assert written["load"]["mass"] == pytest.approx(4.0, abs=0.5)
    told = run("evaluate", "trot", "--config", "mine.json", "--disturb", "payload=4", "--duration", "0.4")
    assert told.out.startswith("trot on a1 with mbc (mine.json), 1 episode of 0.4 s")
    assert "is for robot 'a1', not 'go1'" in run("evaluate", "trot", "--robot", "go1", "--config", "mine.json").error


@pytest.mark.slow
def test_one_line_for_what_cannot_be_done(run: Run, in_folder: Path) -> None:
    assert "none.mcap: no such file" in run("identify", "none.mcap").error
    (in_folder / "half.mcap").write_bytes(b"PK")
    assert "half.mcap: not the log of a deployment" in run("identify", "half.mcap").error
    assert run("deploy", "stand", *DEPLOY[2:-1], "0.4", "--out", "short").status == 0
    assert "s long; at least 1 s" in run("identify", "short", "--out", "x.json").error
    assert not (in_folder / "x.json").exists()
