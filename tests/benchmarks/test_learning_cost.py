"""What a reward costs: courses as trainings and searches leave them, the table, the arithmetic, the figure."""

import json
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("gymnasium", reason="Gymnasium is not installed: pip install 'fastmimic[rl]'")

from learning_cost import PAPER_STEPS, Course, cost_table, paper_cost, search_courses, training_course
from learning_cost_figure import cost_figure

from fastmimic.base.errors import CheckpointError, OutputError, PolicyError
from fastmimic.base.text import csv_text
from fastmimic.experiments.comparison_run import ROW
from fastmimic.learning.training import Evaluated
from fastmimic.optimize.cma_es import Checkpoint
from fastmimic.runs.work_folder import CHECKPOINT
from learning.hand_made import random_policy

COLUMNS = list(Evaluated.__dataclass_fields__)
SCORES = np.array([[0.3, 0.5], [0.4, 0.2], [0.9, 0.1], [0.6, 0.7]])


def training(folder: Path, motion: str = "trot") -> Course:
    """Three evaluations, of which the second is the best."""
    replace(random_policy(np.random.default_rng(0)), motion=motion, seed=3).save(folder / "policy.npz")
    found = [
        Evaluated(1000, 10.0, 1.0, 0.1, 0.1, 1.0, 1.0),
        Evaluated(2000, 20.0, 2.0, 0.4, 0.3, 0.0, 0.125),
        Evaluated(5000, 30.0, 4.0, 0.3, 0.3, 0.0, 0.0),
    ]
    (folder / "evaluations.csv").write_text(csv_text(COLUMNS, map(asdict, found)))
    return training_course(folder)


def finished(comparison: Path, method: str, seed: int = 0, *, variant: str = "", cpu_s: float | None = 8.0) -> None:
    """A run as a comparison leaves it: 90 or 100 s of its simulated time are the evaluation's."""
    folder = comparison / "runs" / f"{method}{variant}{seed}"
    folder.mkdir(parents=True)
    row = {
        **{"motion": "trot", "method": method, "variant": variant, "seed": seed, "reward_mean": 0.9},
        **{"reward_mean_perturbed": 0.8, "fell": 0.0, "fell_perturbed": 0.0, "wall_s": 9.0, "cpu_s": cpu_s},
        **{"simulated_s": 300.0, "evaluation_s": 10.0, "perturbed_episodes": 8},
    }
    (folder / ROW).write_text(json.dumps(row))
    if method == "mbc-dmp":
        Checkpoint("of a test", np.zeros((4, 2, 1)), SCORES + seed / 100, 1.0).save(folder / CHECKPOINT)


@pytest.fixture
def comparison(tmp_path: Path) -> Path:
    finished(tmp_path, "mbc")
    finished(tmp_path, "mbc-dmp", 1, cpu_s=None)
    finished(tmp_path, "mbc-dmp")
    finished(tmp_path, "mbc-dmp", variant="no-adaptation")
    finished(tmp_path, "raibert")
    return tmp_path


class TestTraining:
    def test_it_is_worth_the_policy_that_was_kept_and_costs_all_of_it(self, tmp_path: Path) -> None:
        course = training(tmp_path)
        rate_hz = 500 / 17
        assert (course.row["reward_mean"], course.row["fell_perturbed"]) == (0.4, 0.125)
        assert (course.row["motion"], course.row["method"], course.row["seed"]) == ("trot", "rl", 3)
        assert (course.row["cpu_s"], course.row["wall_s"], course.row["steps"]) == (4.0, 30.0, 5000)
        assert course.simulated_s == pytest.approx(np.array([1000, 2000, 5000]) / rate_hz)
        assert course.row["simulated_s"] == course.simulated_s[-1]
        assert course.reward.tolist() == [0.1, 0.4, 0.3]

    def test_the_papers_steps_cost_in_proportion(self, tmp_path: Path, comparison: Path) -> None:
        courses = [training(tmp_path), *search_courses(comparison, "mbc-dmp", ["trot"])]
        assert paper_cost(courses) == pytest.approx((PAPER_STEPS * 17 / 500, PAPER_STEPS / 5000 * 4.0))

    def test_no_training_is_said_in_a_line(self, tmp_path: Path) -> None:
        with pytest.raises(PolicyError, match="no such file"):
            training_course(tmp_path)
        training(tmp_path)
        (tmp_path / "evaluations.csv").write_text("steps,wall_s\n1,2\n")
        with pytest.raises(OutputError, match="no readable evaluations"):
            training_course(tmp_path)
        (tmp_path / "evaluations.csv").write_text(csv_text(COLUMNS, []))
        with pytest.raises(OutputError, match="no evaluation yet"):
            training_course(tmp_path)


class TestSearches:
    def test_they_are_their_best_so_far_over_what_was_spent(self, comparison: Path) -> None:
        first, second = search_courses(comparison, "mbc-dmp", ["trot"])
        assert [course.row["seed"] for course in (first, second)] == [0, 1]
        assert first.reward.tolist() == [0.5, 0.5, 0.9, 0.9]
        assert first.simulated_s.tolist() == [50, 100, 150, 200]
        assert first.cpu_s.tolist() == [2, 4, 6, 8]
        assert np.isnan(second.cpu_s).all(), "it was interrupted, and its processor time is not known"

    def test_without_a_search_nothing_is_spent(self, comparison: Path) -> None:
        (course,) = search_courses(comparison, "mbc", ["trot"])
        assert course.row["simulated_s"] == len(course.reward) == 0

    def test_other_motions_are_left_aside(self, comparison: Path) -> None:
        assert search_courses(comparison, "mbc-dmp", ["pace"]) == []

    def test_a_lost_checkpoint_is_said_in_a_line(self, comparison: Path) -> None:
        (comparison / "runs" / "mbc-dmp0" / CHECKPOINT).unlink()
        with pytest.raises(CheckpointError, match="no checkpoint"):
            search_courses(comparison, "mbc-dmp", ["trot"])


@pytest.fixture
def courses(comparison: Path) -> list[Course]:
    found = [search_courses(comparison, method, ["trot"]) for method in ("mbc", "mbc-dmp")]
    return [training(comparison), *(course for courses in found for course in courses)]


def test_the_table_has_a_line_a_method_and_the_arithmetic(courses: list[Course]) -> None:
    lines = cost_table(courses).splitlines()
    cells: dict[str, list[str]] = {line.split(" | ")[1]: line.split(" | ") for line in lines[2:5]}
    assert list(cells) == ["RL", "MBC", "MBC-DMP"]
    assert cells["MBC-DMP"][2:6] == ["2", "0.10", "200", "8"]
    assert cells["RL"][7:] == ["**0.400**", "0.300", "0 of 1", "12 % |"]
    assert "5,000 policy steps in 4 s of processor time, 0.80 ms each" in lines[-1]
    assert "100,000,000 at that pace: 80,000 s, 22 hours" in lines[-1]


def test_the_figure_has_both_panels_over_the_same_rewards(courses: list[Course]) -> None:
    figure = cost_figure(courses, paper_cost(courses), "title")
    for axes, learning, search in zip(figure.axes, (170.0, 4.0), (200.0, 8.0), strict=True):
        drawn: dict[str, Any] = {line.get_color(): line for line in axes.lines}
        assert axes.get_xscale() == "log"
        assert drawn["#009e73"].get_xdata()[-1] == pytest.approx(learning)
        assert drawn["#0072b2"].get_xdata()[-1] == pytest.approx(search)
    figure.draw_without_rendering()
    legend = figure.legends[0].get_window_extent()
    assert legend.x0 > figure.bbox.x0
    assert legend.x1 < figure.bbox.x1
    both = figure.axes[0].lines, figure.axes[1].lines
    means = [next(line for line in lines if line.get_color() == "#0072b2").get_ydata() for lines in both]
    assert np.asarray(means[0]) == pytest.approx([0.505, 0.505, 0.905, 0.905])
    assert np.array_equal(*map(np.asarray, means))
