"""Figures: what they show, and that they survive odd inputs."""

import re
import subprocess
import sys
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import matplotlib
import numpy as np
import pytest
from matplotlib.figure import Figure
from numpy.typing import ArrayLike
from PIL import Image

from fastmimic.base.errors import OutputError
from fastmimic.motion.motion import Motion
from fastmimic.motion.provenance import Provenance
from fastmimic.optimize.cma_es import History
from fastmimic.render.figure_style import save
from fastmimic.report.figures import convergence_figure, motion_figure, tracking_figure
from fastmimic.robot import Robot

TIME = np.arange(0, 1.0, 0.01)


def feet(error: float = 0.0) -> np.ndarray:
    """(t, 4, 3): a lift of 5 cm at 2 Hz, front feet ahead; `error` m is added to every coordinate."""
    path = np.zeros((len(TIME), 4, 3))
    path[..., 0] = np.array([0.2, 0.2, -0.2, -0.2]) + 0.05 * np.cos(4 * np.pi * TIME)[:, None]
    path[..., 2] = -0.27 + 0.05 * np.clip(np.sin(4 * np.pi * TIME), 0, None)[:, None]
    return path + error


def contact() -> np.ndarray:
    return np.repeat((np.sin(4 * np.pi * TIME + 1e-6) <= 0)[:, None], 4, axis=1)


def written(figure: Figure, folder: Path) -> np.ndarray:
    """The figure as it is saved: pixels (height, width, 3)."""
    save(figure, folder / "figure.png")
    return np.asarray(Image.open(folder / "figure.png").convert("RGB"))


def history(best: ArrayLike, mean: ArrayLike, std: ArrayLike, sigma: ArrayLike, baseline: float) -> History:
    """Without a start that is better than the candidates."""
    return History(*(np.array(a, float) for a in (best, mean, std, sigma)), baseline, -np.inf)


def line(figure: Figure, axes: int, label: str) -> np.ndarray:
    lines = figure.axes[axes].get_lines()
    return np.asarray(next(drawn for drawn in lines if drawn.get_label() == label).get_ydata())


def test_convergence_shows_the_best_so_far_the_spread_and_the_baseline(tmp_path: Path) -> None:
    best, mean = np.array([0.5, 0.7, 0.6, 0.8]), np.array([0.4, 0.5, 0.55, 0.7])
    figure = convergence_figure(history(best, mean, np.full(4, 0.05), 0.3 / np.arange(1, 5), 0.45))
    np.testing.assert_allclose(line(figure, 0, "best so far"), [0.5, 0.7, 0.7, 0.8])
    np.testing.assert_allclose(line(figure, 0, "candidates, mean"), mean)
    assert "0.450 → 0.800 after 4 iterations" in figure.axes[0].get_title(loc="left")
    low, high = figure.axes[0].get_ylim()
    assert low < 0.35
    assert high > 0.8
    assert figure.axes[1].get_ylim()[0] == 0.0
    assert len(np.unique(written(figure, tmp_path).reshape(-1, 3), axis=0)) > 50


@pytest.mark.parametrize(
    ("first", "last"), [(0.3, 0.29), (0.24, 0.21), (0.3, 0.08), (0.3, 0.012), (0.3, 1e-3), (0.3, 1e-9)]
)
def test_the_step_sizes_have_few_round_labels_that_do_not_touch(first: float, last: float) -> None:
    k = np.arange(1, 21)
    figure = convergence_figure(history(k / 20, k / 25, np.full(20, 0.05), np.geomspace(first, last, 20), 0.1))
    figure.canvas.draw()
    axis = figure.axes[1].yaxis
    shown = [label for label in axis.get_ticklabels(which="both") if label.get_text()]
    box = figure.axes[1].get_window_extent()
    boxes = [b for b in (label.get_window_extent() for label in shown) if box.y0 <= (b.y0 + b.y1) / 2 <= box.y1]
    assert 1 <= len(boxes) <= 6
    heights = sorted((b.y0, b.y1) for b in boxes)
    assert all(below[1] < above[0] for below, above in pairwise(heights))


@pytest.mark.parametrize("n", [1, 2])
def test_convergence_of_a_run_that_was_stopped_at_once(n: int, tmp_path: Path) -> None:
    ones = np.ones(n)
    figure = convergence_figure(history(0.5 * ones, 0.5 * ones, 0 * ones, 0.3 * ones, 0.5))
    assert figure.axes[0].get_lines()[1].get_marker() == "o"  # a line would have no length
    written(figure, tmp_path)


def test_convergence_bridges_an_iteration_in_which_all_candidates_failed(tmp_path: Path) -> None:
    best = np.array([0.5, np.nan, 0.6])
    figure = convergence_figure(history(best, best, 0.1 * best, np.full(3, 0.3), 0.4))
    np.testing.assert_allclose(line(figure, 0, "best so far"), [0.5, 0.5, 0.6])
    assert np.all(np.isfinite(figure.axes[0].get_ylim()))
    written(figure, tmp_path)


def test_tracking_states_the_error_of_each_foot_in_millimetres(tmp_path: Path) -> None:
    after = feet(0.004)
    after[:, 1] += 0.01
    figure = tracking_figure(TIME, feet(), feet(0.02), after, contact())
    titles = [axes.get_title(loc="left") for axes in figure.axes]
    assert titles[:4] == [
        "FR z: RMSE 20.0 → 4.0 mm",
        "FL z: RMSE 20.0 → 14.0 mm",
        "RR z: RMSE 20.0 → 4.0 mm",
        "RL z: RMSE 20.0 → 4.0 mm",
    ]
    assert titles[4].startswith("FR x")
    np.testing.assert_allclose(line(figure, 0, "demonstration"), feet()[:, 0, 2])
    np.testing.assert_allclose(line(figure, 7, "after"), after[:, 3, 0])
    written(figure, tmp_path)


def test_what_was_not_optimised_has_one_error(tmp_path: Path) -> None:
    figure = tracking_figure(TIME, feet(), None, feet(0.004), contact())
    assert figure.axes[0].get_title(loc="left") == "FR z: RMSE 4.0 mm"
    assert [each.get_label() for each in figure.axes[0].get_lines()] == ["demonstration", "robot"]
    written(figure, tmp_path)


def test_tracking_shades_the_demonstrations_stance() -> None:
    figure = tracking_figure(TIME, feet(), feet(), feet(), contact())
    spans = [patch.get_extents().transformed(figure.axes[0].transData.inverted()) for patch in figure.axes[0].patches]
    np.testing.assert_allclose([(s.x0, s.x1) for s in spans], [(0.25, 0.5), (0.75, 1.0)], atol=0.011)


def test_all_panels_of_a_row_have_one_scale() -> None:
    figure = tracking_figure(TIME, feet(), feet(0.02), feet(), contact())
    for row in (figure.axes[:4], figure.axes[4:]):
        spans = [np.ptp(axes.get_ylim()) for axes in row]
        np.testing.assert_allclose(spans, spans[0])
    assert figure.axes[4].get_ylim()[0] > 0 > figure.axes[6].get_ylim()[1]  # front feet ahead, rear behind


def test_a_fall_ends_a_line_and_counts_no_further(tmp_path: Path) -> None:
    before = feet(0.02)
    before[30:] = np.nan
    figure = tracking_figure(TIME, feet(), before, feet(), contact(), window_s=(0.0, 0.6))
    assert figure.axes[0].get_title(loc="left") == "FR z: RMSE 20.0 → 0.0 mm"
    assert figure.axes[0].get_xlim() == (0.0, 0.6)
    written(figure, tmp_path)
    never = np.full_like(before, np.nan)
    figure = tracking_figure(TIME, feet(), never, feet(), contact())
    assert figure.axes[0].get_title(loc="left") == "FR z: RMSE – → 0.0 mm"
    written(figure, tmp_path)


def test_tracking_of_a_single_sample(tmp_path: Path) -> None:
    one = feet()[:1]
    written(tracking_figure(TIME[:1], one, one, one, np.ones((1, 4), dtype=bool)), tmp_path)


@pytest.fixture
def motion(a1: Robot) -> Motion:
    n = len(TIME)
    wave = np.sin(2 * np.pi * TIME)
    pitch = 0.1 * wave
    quat = np.stack([np.cos(pitch / 2), 0 * pitch, np.sin(pitch / 2), 0 * pitch], axis=1)
    joint_vel = np.zeros((n, 12))
    joint_vel[:, 5] = 0.5 * a1.joint_speed_limit[5] * wave  # the front left knee
    root = np.stack([TIME, 0 * TIME, 0.3 + 0.01 * wave], axis=1)
    return Motion(
        rate_hz=100.0,
        root_pos_w=root,
        root_quat_wxyz=quat,
        joint_pos=a1.home_joint_pos + 0.1 * wave[:, None],
        joint_vel=joint_vel,
        foot_pos_b=feet(),
        contact=contact(),
        root_lin_vel_w=np.zeros((n, 3)),
        root_ang_vel_w=np.zeros((n, 3)),
        cycle=np.array([1.0, 0.0, 0.5]),
        provenance=Provenance("trot"),
    )


def test_a_motion_shows_its_gait_its_trunk_and_its_limits(motion: Motion, a1: Robot, tmp_path: Path) -> None:
    figure = motion_figure(motion, a1)
    titles = {axes.get_title(loc="left"): axes for axes in figure.axes}
    assert "trot on a1: 1.00 s at 100 Hz, +1.00 m/s forward" in figure.get_suptitle()
    labels = [label.get_text() for label in figure.axes[0].get_yticklabels()]
    assert [re.sub(r"\s+", " ", text) for text in labels] == ["FR 0.50", "FL 0.50", "RR 0.50", "RL 0.50"]
    assert "knee speed: peak is 50 % of the limit" in titles
    timed = [axes for axes in figure.axes if axes.xaxis.get_tick_params()["labelbottom"]]
    assert len(timed) == 4  # the lowest of each column, and the wide one
    assert timed[-1].get_xlabel() == "time (s)"
    low, high = titles["knee angle"].get_ylim()
    assert low < a1.joint_lower[2]
    assert high > a1.joint_upper[2]
    pitch = next(
        line
        for line in titles["base pitch (solid, nose down positive) and roll (dotted)"].get_lines()
        if "pitch" in str(line.get_label())
    )
    np.testing.assert_allclose(pitch.get_ydata(), np.degrees(0.1 * np.sin(2 * np.pi * TIME)), atol=1e-9)
    written(figure, tmp_path)


def test_a_foot_that_never_leaves_the_ground_is_one_bar(motion: Motion, a1: Robot, tmp_path: Path) -> None:
    standing = replace(motion, contact=np.ones_like(motion.contact), cycle=None)
    figure = motion_figure(standing, a1)
    assert "not periodic" in figure.get_suptitle()
    bars = figure.axes[0].collections[0].get_paths()
    assert len(bars) == 1
    np.testing.assert_allclose(np.ptp(bars[0].vertices[:, 0]), 1.0)
    written(figure, tmp_path)


def test_a_figure_is_written_whole_or_not_at_all(tmp_path: Path) -> None:
    figure = convergence_figure(history([0.5, 0.6], [0.4, 0.5], [0.1, 0.1], [0.3, 0.2], 0.4))
    (tmp_path / "file").write_text("not a folder")
    with pytest.raises(OutputError, match="cannot be written"):
        save(figure, tmp_path / "file" / "c.png")
    with pytest.raises(OutputError, match=r"\.png, \.pdf or \.svg"):
        save(figure, tmp_path / "c.bmp")
    assert [p.name for p in tmp_path.iterdir()] == ["file"]
    for suffix, magic in (("png", b"\x89PNG"), ("pdf", b"%PDF"), ("svg", b"<?xml")):
        save(figure, tmp_path / f"c.{suffix}")
        assert (tmp_path / f"c.{suffix}").read_bytes().startswith(magic)


@pytest.mark.slow
def test_drawing_changes_nothing_global(tmp_path: Path) -> None:
    settings = dict(matplotlib.rcParams)
    written(convergence_figure(history([0.5], [0.4], [0.1], [0.3], 0.4)), tmp_path)
    assert dict(matplotlib.rcParams) == settings
    script = "import sys, fastmimic.report.figures as _; sys.exit('matplotlib.pyplot' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", script], check=False).returncode == 0


def test_the_room_loads_only_what_is_asked_for() -> None:
    script = "import sys, fastmimic.report; sys.exit('matplotlib' in sys.modules or 'mujoco' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", script], check=False).returncode == 0
