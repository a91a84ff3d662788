"""`fastmimic stress`, `fastmimic transfer` and evaluation elsewhere: what they write, resume and refuse."""

import csv
import json
from pathlib import Path
from typing import Any

import pytest

from cli.running import Run

TINY = ("--episodes", "2", "--duration", "0.4")
SWEPT = ("--disturbances", "payload", "com-x")


def test_evaluate_says_what_was_disturbed(run: Run) -> None:
    done = run("evaluate", "trot", "--duration", "0.4", "--disturb", "payload=2", "--disturb", "friction=0.5")
    assert done.status == 0, done.err
    assert done.out.endswith("in mujoco; disturbances: payload 2 kg, friction 0.5\n")
    found = json.loads(run("evaluate", "trot", "--duration", "0.4", "--disturb", "payload=2", "--json").out)
    assert found["disturbances"] == {"payload": 2.0}
    assert found["simulator"] == "mujoco"


def test_values_of_an_option_follow_each_other_or_its_repetition(run: Run) -> None:
    arguments = ("--disturb", "friction=0.5", "payload=2", "--disturb", "delay=0.002")
    found = json.loads(run("evaluate", "trot", "--duration", "0.2", *arguments, "--json").out)
    assert found["disturbances"] == {"friction": 0.5, "payload": 2.0, "delay": 0.002}


def test_evaluate_in_the_second_simulator(run: Run) -> None:
    pytest.importorskip("pybullet", reason="PyBullet is not installed: pip install 'fastmimic[pybullet]'")
    found = json.loads(run("evaluate", "trot", "--duration", "0.4", "--simulator", "pybullet", "--json").out)
    assert found["simulator"] == "pybullet"
    assert found["reward_mean"] > 0.75


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("evaluate", "trot", "--simulator", "gazebo"), "unknown simulator 'gazebo'; there are mujoco, pybullet"),
        (("evaluate", "trot", "--disturb", "wind=3"), "unknown disturbance 'wind'; there are friction, restitution"),
        (("evaluate", "trot", "--disturb", "payload=99"), "'payload' takes 0 kg to 20 kg, found 99"),
        (("evaluate", "trot", "--robot", "go1", "--simulator", "pybullet"), "description of a1, none of 'go1'"),
        (("stress", "trot", "--disturbances", "wind"), "unknown disturbance 'wind'"),
        (("stress", "trot", "--methods", "magic"), "unknown method 'magic'"),
        (("stress", "trot", "--episodes", "0"), "episodes must be at least 1, found 0"),
        (("stress", "trot", "--resume"), "runs/stress holds no experiment to resume"),
        (("transfer", "trot", "--trials", "0"), "trials must be at least 1, found 0"),
        (("transfer", "trot", "trot"), "two motions have the same name"),
        (("transfer", "trot", "--robot", "go1"), "description of a1, none of 'go1'"),
    ],
)
def test_one_line_for_what_cannot_be_done(run: Run, arguments: tuple[str, ...], said: str) -> None:
    if "pybullet" in arguments or arguments[0] == "transfer":
        pytest.importorskip("pybullet", reason="PyBullet is not installed: pip install 'fastmimic[pybullet]'")
    assert said in run(*arguments).error
    assert not Path("runs").exists()


class TestStress:
    def test_writes_curves_and_a_table_and_goes_on(
        self, run: Run, in_folder: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        out = in_folder / "runs" / "stress"
        from fastmimic.experiments import stress

        real, calls = stress.sweep, []

        def interrupted(subject: Any, name: str, *rest: Any) -> Any:
            calls.append((subject.method.name, name))
            if name == "com-x":
                raise KeyboardInterrupt
            return real(subject, name, *rest)

        with monkeypatch.context() as patch:
            patch.setattr(stress, "sweep", interrupted)
            stopped = run("stress", "trot", "--methods", "mbc", *SWEPT, *TINY)
        assert stopped.status == 130
        assert "the same command with --resume continues" in stopped.err
        assert "**Unfinished: 1 sweeps are missing.**" in (out / "table.md").read_text()

        assert "--resume goes on" in run("stress", "trot", "--methods", "mbc", *SWEPT, *TINY).error
        other = run("stress", "trot", "--methods", "mbc", *SWEPT, "--episodes", "3", "--duration", "0.4", "--resume")
        assert "an experiment of other settings (episodes 2)" in other.error

        kept = (out / "sweeps" / "mbc-payload.json").stat().st_mtime_ns
        done = run("stress", "trot", "--methods", "mbc", "raibert", *SWEPT, *TINY, "--resume")
        assert done.status == 0, done.err
        assert (out / "sweeps" / "mbc-payload.json").stat().st_mtime_ns == kept
        written = {"results.csv", "table.md", "success.png", "reward.png", "environment.json", "sweeps"}
        assert {path.name for path in out.iterdir()} == written
        with (out / "results.csv").open(newline="") as file:
            rows = list(csv.DictReader(file))
        assert len(rows) == 2 * (10 + 11)
        assert done.out.startswith((out / "table.md").read_text())
        assert "Unfinished" not in done.out
        assert "4/4 raibert, com-x" in done.err

        sweep = out / "sweeps" / "mbc-payload.json"
        sweep.write_text(sweep.read_text().replace('"value"', '"valeu"'))
        damaged = run("stress", "trot", "--methods", "mbc", *SWEPT, *TINY, "--resume")
        assert damaged.status == 2
        assert "written (KeyError: 'value'); remove it, and --resume makes it anew\n" in damaged.err

    def test_a_folder_of_something_else_is_left_alone(self, run: Run, in_folder: Path) -> None:
        (in_folder / "table.md").write_text("mine")
        assert "holds table.md of something else" in run("stress", "trot", "--out", ".", "--overwrite").error
        assert (in_folder / "table.md").read_text() == "mine"


class TestTransfer:
    @pytest.mark.slow
    def test_writes_a_table_and_a_figure_and_keeps_what_is_done(self, run: Run, in_folder: Path) -> None:
        pytest.importorskip("pybullet", reason="PyBullet is not installed: pip install 'fastmimic[pybullet]'")
        tiny = ("--trials", "2", "--duration", "0.4", "--iterations", "1", "--population", "4")
        done = run("transfer", "trot", "--methods", "mbc", "mbc-dmp", *tiny)
        assert done.status == 0, done.err
        out = in_folder / "runs" / "transfer"
        written = {"results.csv", "table.md", "transfer.png", "environment.json", "trials", "motions"}
        assert {path.name for path in out.iterdir()} == written
        assert done.out.startswith("| motion | method | as optimised | (a) sensors | (b) PyBullet | (c) all |")
        assert len((out / "results.csv").read_text().splitlines()) == 1 + 2 * 4 * 2
        kept = {path: path.stat().st_mtime_ns for folder in ("trials", "motions") for path in (out / folder).iterdir()}
        again = run("transfer", "trot", "--methods", "mbc", "mbc-dmp", *tiny, "--resume")
        assert again.status == 0, again.err
        assert again.out == done.out
        assert {path: path.stat().st_mtime_ns for path in kept} == kept
