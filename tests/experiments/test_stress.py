"""Sweeps over disturbances: the same episodes at every level, and what is made of their rows."""

import dataclasses
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from control.motions import gait
from fastmimic.base.errors import ConfigError, OutputError
from fastmimic.base.text import csv_text
from fastmimic.episode.plan import Start
from fastmimic.experiments import experiment
from fastmimic.experiments.experiment import Subject, all_parts, check_methods, finish_part, make_subject
from fastmimic.experiments.stress import (
    COLUMNS,
    StressSettings,
    disturbances_of,
    stress_table,
    sweep,
    tolerances,
)
from fastmimic.imitation.evaluate import evaluate
from fastmimic.motion.motion import Motion
from fastmimic.optimize.cma_es import CmaSettings
from fastmimic.report.experiment_figures import stress_figure
from fastmimic.robot import Robot
from fastmimic.simulation.conditions import Conditions, Disturbance, known
from fastmimic.simulation.disturbance_kinds import DISTURBANCES, DisturbanceKind
from fastmimic.simulation.terrain import TERRAINS
from searches import QUICK_CHOICE

SETTINGS = StressSettings(episodes=2, duration_s=0.6)


@pytest.fixture(scope="module")
def motion(robot: Robot) -> Motion:
    return gait(robot, (0.3, 0.0), 0.0, n_samples=200)


@pytest.fixture(scope="module")
def subject(motion: Motion, robot: Robot, tmp_path_factory: pytest.TempPathFactory) -> Subject:
    return make_subject("mbc", motion, robot, CmaSettings(), tmp_path_factory.mktemp("motions"))


def made_up(method: str, name: str, success: list[float]) -> list[dict[str, Any]]:
    """Rows of a sweep with these successes."""
    about = {"motion": "trot", "unit": DISTURBANCES[name].unit, "episodes": 20, "reward_std": 0.0}
    about |= {"simulator": "mujoco", "observe": "truth", "duration_s": 6.0, "seed": 0}
    levels = DISTURBANCES[name].levels
    return [
        {**about, "method": method, "disturbance": name, "value": level, "fell": 1.0 - s, "reward_mean": 0.9 * s}
        for level, s in zip(levels, success, strict=True)
    ]


class TestSweep:
    def test_a_row_for_each_level_and_worse_where_it_is_harder(self, subject: Subject, robot: Robot) -> None:
        rows = sweep(subject, "joint-damping", robot, SETTINGS)
        assert tuple(row["value"] for row in rows) == DISTURBANCES["joint-damping"].levels
        assert all(set(COLUMNS) == set(row) for row in rows)
        assert rows[0]["fell"] == 0.0
        assert rows[-1]["reward_mean"] < rows[0]["reward_mean"]

    def test_the_nominal_level_is_an_undisturbed_evaluation(self, subject: Subject, robot: Robot) -> None:
        rows = sweep(subject, "payload", robot, dataclasses.replace(SETTINGS, episodes=1))
        plain = evaluate(subject.motion, robot, duration_s=0.6).rollout
        assert rows[0]["reward_mean"] == pytest.approx(plain.reward[0], abs=1e-6)

    def test_a_level_among_others_is_as_alone(self, subject: Subject, robot: Robot) -> None:
        rows = sweep(subject, "friction", robot, dataclasses.replace(SETTINGS, episodes=1))
        at = next(row for row in rows if row["value"] == 0.3)
        conditions = Conditions(disturbances=(Disturbance("friction", (0.3,)),))
        alone = evaluate(subject.motion, robot, duration_s=0.6, conditions=conditions).rollout
        assert at["reward_mean"] == float(alone.reward[0])

    def test_episodes_begin_at_many_phases_and_unperturbed(
        self, subject: Subject, robot: Robot, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        starts: list[Start] = []
        real = experiment.run_episodes

        def seen(*args: Any, start: Start, **rest: Any) -> Any:
            starts.append(start)
            return real(*args, start=start, **rest)

        monkeypatch.setattr(experiment, "run_episodes", seen)
        sweep(subject, "payload", robot, dataclasses.replace(SETTINGS, episodes=5, duration_s=0.02))
        samples = starts[0].sample.reshape(-1, 5)
        assert samples[0, 0] == 0
        assert len(set(samples[0].tolist())) > 3
        assert (samples == samples[0]).all(), "the same at every level"
        assert (starts[0].streams.reshape(-1, 5) == np.arange(5)).all()
        assert not starts[0].joint_offset.any()

    def test_uneven_ground_is_run_level_by_level(
        self, subject: Subject, robot: Robot, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        kind = dataclasses.replace(TERRAINS["rough"], levels=(0.0, 0.03))
        monkeypatch.setitem(TERRAINS, "rough", kind)
        rows = sweep(subject, "rough", robot, SETTINGS)
        assert [row["value"] for row in rows] == [0.0, 0.03]

    def test_an_episode_must_last_beyond_the_push(self, subject: Subject, robot: Robot) -> None:
        with pytest.raises(ConfigError, match=r"0.6 s ends before the push at 2 s; leave out 'push', or give a longer"):
            sweep(subject, "push", robot, SETTINGS)


class TestRegistered:
    """A user's own disturbance."""

    @staticmethod
    def add(monkeypatch: pytest.MonkeyPatch, **about: Any) -> None:
        kind = DisturbanceKind("gusts", each_step=lambda simulation, values, time_s: None, **about)
        monkeypatch.setitem(DISTURBANCES, "gusts", kind)

    def test_the_nominal_level_is_swept_if_it_is_left_out(
        self, subject: Subject, robot: Robot, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        self.add(monkeypatch, levels=(2.0, 1.0))
        rows = sweep(subject, "gusts", robot, SETTINGS)
        assert [row["value"] for row in rows] == [0.0, 1.0, 2.0]
        (found,) = tolerances(rows)
        assert (found.lower, found.upper) == (0.0, 2.0)

    def test_one_without_levels_is_refused_and_no_default(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.add(monkeypatch)
        with pytest.raises(ConfigError, match="'gusts' has no levels to sweep; register it with levels"):
            disturbances_of(["gusts"], "mujoco")
        assert "gusts" not in disturbances_of(None, "mujoco")
        assert "friction" in disturbances_of(None, "mujoco")


class TestTolerance:
    def test_is_what_holds_about_the_nominal_level(self) -> None:
        friction = made_up("mbc", "friction", [0, 0.5, 1, 0.9, 0.95, 1, 1, 1, 1, 1, 1])
        t = tolerances(friction)[0]
        assert (t.lower, t.upper) == (0.3, 1.2), "0.2 holds, but 0.25 between fails"
        assert (t.lower_tried, t.upper_tried) == (0.1, 1.2)

    def test_none_where_the_nominal_level_fails(self) -> None:
        t = tolerances(made_up("raibert", "payload", [0.9, *[1.0] * 9]))[0]
        assert t.lower is None
        assert t.nominal_success == 0.9

    def test_the_table_and_the_file_say_so(self) -> None:
        rows = made_up("mbc", "top-speed", [0, 0, 0, 1, 1, 1, 1, 1, 1]) + made_up("raibert", "top-speed", [0.0] * 9)
        table = stress_table(rows, StressSettings(), 1)
        assert "| top-speed | 0.5 … ∞ | 0.8 … ∞ | none |" in table
        assert "**Unfinished: 1 sweeps are missing.**" in table
        assert "MBC 0.900, 100% without a fall; Raibert 0.000, 0% without a fall" in table
        assert len(csv_text(COLUMNS, rows).splitlines()) == 1 + 18

    def test_figures_have_a_panel_for_each_disturbance(self) -> None:
        rows = made_up("mbc", "payload", [1.0] * 10) + made_up("mbc", "top-speed", [0.5] * 9)
        figure = stress_figure(rows, "fell", "title")
        titles = [axes.get_title(loc="left") for axes in figure.axes]
        assert titles[:2] == ["payload", "top-speed"]
        x = figure.axes[1].lines[0].get_xdata()
        assert np.isfinite(np.asarray(x, dtype=float)).all(), "what has no bound is drawn at the edge"


class TestParts:
    def test_come_back_and_are_told_apart(self, tmp_path: Path) -> None:
        path = tmp_path / "part.json"
        runs: list[dict[str, Any]] = []

        def run() -> list[dict[str, Any]]:
            runs.append({"value": "inf", "x": 1})
            return runs

        for _ in range(2):
            finish_part(path, "a", run)
            (found,) = all_parts(tmp_path)
            assert math.isinf(float(found["value"]))
        assert len(runs) == 1, "what is finished does not run again"
        with pytest.raises(OutputError, match="is of another motion or controller"):
            finish_part(path, "b", run)
        path.write_text("{")
        with pytest.raises(OutputError, match=r"cannot be read .* remove it"):
            finish_part(path, "a", run)


class TestRefusals:
    def test_disturbances(self) -> None:
        there = [name for name, kind in TERRAINS.items() if "pybullet" in kind.simulators]
        assert disturbances_of(None, "pybullet", "sensors") == [*known("pybullet"), *there]
        assert "foot-force-scale" not in disturbances_of(None, "pybullet", "truth")
        with pytest.raises(ConfigError, match="'foot-force-scale' changes what sensors read; add --observe sensors"):
            disturbances_of(["foot-force-scale"], "mujoco", "truth")
        assert "stairs-up" not in there
        assert "softness" not in known("pybullet")
        with pytest.raises(ConfigError, match="unknown disturbance 'wind'; there are friction"):
            disturbances_of(["wind"], "mujoco")
        with pytest.raises(ConfigError, match="'softness' is not realised in pybullet"):
            disturbances_of(["softness"], "pybullet")
        with pytest.raises(ConfigError, match="payload is given twice"):
            disturbances_of(["payload", "payload"], "mujoco")

    def test_methods(self) -> None:
        with pytest.raises(ConfigError, match="at least one method"):
            check_methods([], False)
        with pytest.raises(ConfigError, match="mbc is given twice"):
            check_methods(["mbc", "mbc"], False)
        with pytest.raises(ConfigError, match="'rl' needs a trained policy"):
            check_methods(["rl"], False)
        with pytest.raises(ConfigError, match="no method that uses it; add rl"):
            check_methods(["mbc"], True)


class TestEntrants:
    def test_an_optimised_motion_is_made_once(self, motion: Motion, robot: Robot, tmp_path: Path) -> None:
        search = CmaSettings(iterations=1, population=4, choice=QUICK_CHOICE)
        made = make_subject("mbc-dmp", motion, robot, search, tmp_path)
        assert {p.name for p in tmp_path.iterdir()} == {f"{motion.name}-mbc-dmp.npz"}
        again = make_subject("mbc-dmp", motion, robot, CmaSettings(iterations=10**6), tmp_path)
        assert again.digest == made.digest
        assert made.motion.target.joint_pos.tobytes() == motion.joint_pos.tobytes()
        # given to another command as it is, it is run as it is; a method that optimises nothing runs its demonstration
        as_it_is = make_subject("mbc-dmp", made.motion, robot, CmaSettings(iterations=10**6), tmp_path / "none")
        assert as_it_is.motion is made.motion
        assert make_subject("mbc", made.motion, robot, search, tmp_path).motion is made.motion.target

    def test_a_motion_of_something_else_is_not_taken(self, motion: Motion, robot: Robot, tmp_path: Path) -> None:
        other = gait(robot, (0.2, 0.0), 0.0, n_samples=200)
        other.save(tmp_path / f"{motion.name}-mbc-dmp.npz")
        with pytest.raises(OutputError, match="was optimised from another motion; remove it"):
            make_subject("mbc-dmp", motion, robot, CmaSettings(), tmp_path)
