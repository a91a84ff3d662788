"""`fastmimic imitate --randomize`: what it records, and what it refuses."""

import json
from pathlib import Path
from typing import Any

import pytest

from cli.running import TINY, Run
from fastmimic.motion.motion import Motion
from fastmimic.optimize.randomization import usual_randomization

TWO = ("--randomize", "2", "--randomize-over", "payload=1:4", "friction", "--criterion", "worst")


def read(path: Path) -> dict[str, Any]:
    return json.loads(path.read_text())


def test_what_was_asked_for_and_what_came_of_it_is_recorded(run: Run, tmp_path: Path) -> None:
    done = run("imitate", "trot", *TINY, *TWO, "--out", "run")
    assert done.status == 0
    asked = {"robots": 2, "criterion": "worst", "over": {"friction": [0.5, 1.0], "payload": [1.0, 4.0]}}
    config, metrics = read(tmp_path / "run" / "config.json"), read(tmp_path / "run" / "metrics.json")
    assert config["arguments"]["randomize"] == asked
    assert not {"randomize_over", "criterion"} & config["arguments"].keys()
    found = metrics["randomization"]
    assert {name: found[name] for name in asked} == asked
    others = found["held_out"]
    assert others["robots"] == 16
    for when in ("before", "after"):
        assert 0 <= others[when]["worst"] < others[when]["mean"] < metrics["reward"][when] <= 1
        assert others[when]["fell"] == 0
    assert Motion.load(tmp_path / "run" / "motion.npz").provenance.as_dict()["made_with"]["randomization"] == asked
    for label, key in (("16 other robots: mean reward", "mean"), ("worst reward", "worst")):
        shown = next(line for line in done.out.splitlines() if line.strip().startswith(label))
        assert shown.split()[-2:] == [f"{others[when][key]:.3f}" for when in ("before", "after")]
    assert run("report", "run", "--out", "run.html").status == 0
    page = (tmp_path / "run.html").read_text()
    assert f'data-metric="randomization.held_out.after.mean" value="{others["after"]["mean"]!r}"' in page
    assert "best of the iteration" in page

    same = run("imitate", "trot", *TINY, *TWO, "--out", "run", "--resume")
    assert same.status == 0
    assert read(tmp_path / "run" / "metrics.json")["randomization"] == found
    other = run("imitate", "trot", *TINY, "--randomize", "2", "--out", "run", "--resume")
    assert other.status == 2
    assert "of another problem" in other.err.splitlines()[-1]
    assert "holds another run (randomize" in run("imitate", "trot", *TINY, "--out", "run").error


def test_without_a_number_it_is_four_robots_that_differ_in_the_usual(run: Run, tmp_path: Path) -> None:
    assert run("imitate", "trot", "--randomize", *TINY, "--out", "run").status == 0
    asked = read(tmp_path / "run" / "config.json")["arguments"]["randomize"]
    usual = {r.name for r in usual_randomization()}
    assert (asked["robots"], asked["criterion"], set(asked["over"])) == (4, "mean", usual)


def test_without_it_nothing_is_recorded(run: Run, tmp_path: Path) -> None:
    assert run("imitate", "trot", *TINY, "--out", "run").status == 0
    assert read(tmp_path / "run" / "config.json")["arguments"]["randomize"] is None
    assert "randomization" not in read(tmp_path / "run" / "metrics.json")
    assert "randomization" not in Motion.load(tmp_path / "run" / "motion.npz").provenance.as_dict()["made_with"]
    changed = read(tmp_path / "run" / "config.json")
    del changed["arguments"]["randomize"]  # as a run had it before there was any
    (tmp_path / "run" / "config.json").write_text(json.dumps(changed))
    assert run("imitate", "trot", *TINY, "--out", "run").status == 0


REFUSED = {
    "one robot": (["--randomize", "1"], "at least 2 robots, found 1"),
    "no number": (["--randomize", "four"], "--randomize takes one number of robots, or none for 4; found 'four'"),
    "two numbers": (["--randomize", "2", "3"], "--randomize takes one number of robots"),
    "unknown": (["--randomize", "--randomize-over", "fricton"], "did you mean 'friction'"),
    "range": (["--randomize", "--randomize-over", "friction=2:1"], "'friction' takes a range within 0.05 to 2"),
    "twice": (["--randomize", "--randomize-over", "delay", "delay"], "the range of 'delay' is given twice"),
    "criterion": (["--randomize", "--criterion", "wurst"], "unknown criterion 'wurst'; there are mean, worst"),
    "over without": (["--randomize-over", "friction"], "--randomize-over needs --randomize"),
    "criterion without": (["--criterion", "worst"], "--criterion needs --randomize"),
    "method": (["--randomize", "--method", "mbc"], "method 'mbc' does not search, so --randomize has no effect"),
    "no search": (["--randomize", "--no-optimize"], "method 'mbc' does not search, so --randomize has no effect"),
    "policy": (["--randomize", "--method", "rl"], "method 'rl' needs a trained policy"),
}


@pytest.mark.parametrize("kind", REFUSED)
def test_refused_before_anything_is_done(kind: str, run: Run, tmp_path: Path) -> None:
    arguments, said = REFUSED[kind]
    assert said in run("imitate", "trot", *arguments).error
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("kind", ["one robot", "unknown", "criterion without", "method"])
def test_stitch_refuses_the_same(kind: str, run: Run, tmp_path: Path) -> None:
    arguments, said = REFUSED[kind]
    assert said in run("stitch", "trot", "pace", *arguments).error
    assert not list(tmp_path.iterdir())


def test_an_episode_that_ends_before_the_push(run: Run, tmp_path: Path) -> None:
    done = run("imitate", "trot", *TINY, "--randomize", "--randomize-over", "push")
    assert done.status == 2
    assert "an episode of 0.6 s may end before a push" in done.err.splitlines()[-1]
    assert not list(tmp_path.iterdir())
