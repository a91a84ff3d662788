"""Transfer: the same starts and motion in every column, and what is made of the rows."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("pybullet", reason="PyBullet is not installed: pip install 'fastmimic[pybullet]'")

from control.motions import gait
from fastmimic.base.text import csv_text
from fastmimic.episode.loop import run_episodes
from fastmimic.experiments.experiment import Subject, make_subject
from fastmimic.experiments.transfer import (
    COLUMNS,
    IDENTIFIED,
    STAGES,
    TransferSettings,
    identified_config,
    run_trials,
    transfer_table,
    transferred,
    trial_starts,
)
from fastmimic.optimize.cma_es import CmaSettings
from fastmimic.report.experiment_figures import transfer_figure
from fastmimic.robot import Robot

SETTINGS = TransferSettings(trials=2, duration_s=0.6)


@pytest.fixture(scope="module")
def subject(robot: Robot, tmp_path_factory: pytest.TempPathFactory) -> Subject:
    motion = gait(robot, (0.3, 0.0), 0.0, n_samples=200)
    return make_subject("mbc", motion, robot, CmaSettings(), tmp_path_factory.mktemp("motions"))


@pytest.fixture(scope="module")
def rows(subject: Subject, robot: Robot) -> list[dict[str, Any]]:
    return run_trials(subject, robot, SETTINGS)


class TestTrials:
    def test_every_stage_has_every_trial(self, rows: list[dict[str, Any]]) -> None:
        assert [(row["stage"], row["trial"]) for row in rows] == [(s.name, k) for s in STAGES for k in (0, 1)]
        assert all(set(COLUMNS) == set(row) for row in rows)
        assert len({row["reward_mean"] for row in rows}) == len(rows), "every one is another robot or start"

    def test_the_first_stage_is_the_simulation_of_the_optimisation(
        self, rows: list[dict[str, Any]], subject: Subject, robot: Robot
    ) -> None:
        start = trial_starts(2, SETTINGS.seed)
        plain = run_episodes(robot, subject.motion, start=start, duration_s=0.6, config=subject.config)
        assert [row["reward_mean"] for row in rows if row["stage"] == STAGES[0].name] == plain.reward.tolist()

    def test_the_last_stage_differs_in_everything(self) -> None:
        last = STAGES[-1]
        assert (last.simulator, last.observe) == ("pybullet", "sensors")
        given = {d.name: d.values[0] for d in last.disturbances}
        assert given["friction"] == 0.6
        assert {"delay", "joint-friction"} < set(given)

    def test_trials_begin_at_the_motions_start_but_not_quite(self) -> None:
        start = trial_starts(3, 0)
        assert not start.sample.any()
        assert np.all(np.abs(start.joint_offset).max(axis=1) > 0.01)
        np.testing.assert_array_equal(trial_starts(2, 0).joint_offset, start.joint_offset[:2])


class TestIdentified:
    @pytest.mark.slow
    def test_the_controller_is_told_what_another_run_says(
        self, rows: list[dict[str, Any]], subject: Subject, robot: Robot
    ) -> None:
        settings = replace(SETTINGS, identify=True, identification_s=1.2)
        told = identified_config(subject, robot, settings)
        assert told.robot == robot.name
        assert told.stance.friction <= subject.config.stance.friction
        found = run_trials(subject, robot, settings)
        assert found[: len(rows)] == rows
        assert [(row["stage"], row["trial"]) for row in found[len(rows) :]] == [("identified", 0), ("identified", 1)]

    def test_a_run_that_says_nothing_leaves_the_controller_alone(
        self, subject: Subject, robot: Robot, caplog: pytest.LogCaptureFixture
    ) -> None:
        assert identified_config(subject, robot, replace(SETTINGS, identification_s=0.3)) is subject.config
        assert "nothing was identified: the log is 0.30 s long" in caplog.text

    def test_has_a_column_of_its_own(self) -> None:
        rows = TestResults().made_up()
        rows += [
            {**row, "stage": IDENTIFIED.name, "reward_mean": 0.76, "fell": 0.0}
            for row in rows
            if row["stage"] == STAGES[-1].name
        ]
        table = transfer_table(rows, 0)
        assert "| (c) all | (c) identified | change to (c) identified |" in table
        assert "0.400 ± 0.200, 1 of 2 fell | 0.760 ± 0.000 | -5 % |" in table
        labels = [text.get_text() for text in transfer_figure(rows).legends[0].get_texts()]
        assert "(c) identified" in labels


class TestResults:
    def made_up(self) -> list[dict[str, Any]]:
        rewards = {"simulation": (0.8, 0.8), "sensors": (0.7, 0.8), "engine": (0.6, 0.8), "robot": (0.2, 0.6)}
        about = {"motion": "turn", "method": "mbc", "robot": "a1", "duration_s": 10.0, "seed": 0}
        return [
            {**about, "stage": stage, "trial": k, "reward_mean": r, "fell": float(stage == "robot" and k == 0)}
            for stage, both in rewards.items()
            for k, r in enumerate(both)
        ]

    def test_the_drop_is_relative(self) -> None:
        found = transferred(self.made_up())[0]
        assert found.drop == pytest.approx(0.5)
        np.testing.assert_array_equal(found.falls, [0, 0, 0, 1])

    def test_the_table_stands_next_to_the_papers_numbers(self, tmp_path: Path) -> None:
        table = transfer_table(self.made_up(), 2)
        assert (
            "| `turn` | MBC | 0.800 ± 0.000 | 0.750 ± 0.050 | 0.700 ± 0.100 | 0.400 ± 0.200, 1 of 2 fell | -50 % |"
            in table
        )
        assert "| turn (paper) | MBC-DMP | 0.803 ± 0.012 |  |  | on the robot 0.627 ± 0.096 | -22 % |" in table
        assert "Unfinished: 2" in table
        assert "friction 0.6" in table
        assert len(csv_text(COLUMNS, self.made_up()).splitlines()) == 9

    def test_the_figure_has_a_panel_for_each_motion_and_the_paper(self) -> None:
        figure = transfer_figure(self.made_up())
        assert [axes.get_title(loc="left") for axes in figure.axes] == ["turn", "the paper's turn, real robot"]
