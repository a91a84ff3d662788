"""The figures of a comparison: what is drawn, in which order, and that a fall is seen."""

from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure

from fastmimic.experiments.measurement import Summary
from fastmimic.report.experiment_figures import ablation_figure, comparison_figure, tracking_bars


def summary(
    method: str, rewards: list[float], *, variant: str = "", fell: list[bool] | None = None, **other: Any
) -> Summary:
    fallen = fell or [False] * len(rewards)
    rows = [
        {
            "reward_mean": reward,
            "reward_mean_perturbed": reward - 0.1,
            "fell": down,
            "fell_before": False,
            "foot_z_rmse_m_before": 0.010,
            "foot_z_rmse_m": 0.0076,
            "foot_x_rmse_m_before": 0.020,
            "foot_x_rmse_m": 0.0016,
            **other,
        }
        for reward, down in zip(rewards, fallen, strict=True)
    ]
    return Summary("trot", method, variant, tuple(rows))


def texts(figure: Figure) -> list[str]:
    return [t.get_text() for axes in figure.axes for t in axes.texts]


def test_methods_stand_in_the_papers_order_and_falls_are_marked() -> None:
    found = [
        summary("lh-dmp", [0.9, 0.8]),
        summary("raibert", [0.3], fell=[True]),
        summary("mbc-dmp", [0.7, 0.5], fell=[True, False]),
        summary("mbc", [0.6]),
    ]
    figure = comparison_figure(found, "title")
    assert texts(figure) == ["0.300\n×", "0.600", "0.600\n× 50 %", "0.850"]
    legend = [text.get_text() for text in figure.legends[0].get_texts()]
    assert legend[:4] == ["Raibert", "MBC", "MBC-DMP", "LH-DMP"]
    heights = [bar.get_height() for bar in figure.axes[0].patches]
    np.testing.assert_allclose(heights, [0.3, 0.6, 0.6, 0.85])
    assert len(figure.axes[0].containers) == 4 + 2  # bars, and deviations where there are seeds


@pytest.mark.parametrize("fell", [False, True])
@pytest.mark.parametrize("rough", [0.3, 0.49, 0.5, 0.51, 0.53, 0.55, 0.57, 0.6, 0.63, 0.9])
def test_no_circle_lies_on_a_number(rough: float, fell: bool) -> None:
    figure = comparison_figure([summary("mbc", [0.5], fell=[fell], reward_mean_perturbed=rough)], "title")
    figure.draw_without_rendering()
    axes = figure.axes[0]
    number = axes.texts[0].get_window_extent()
    _, y = axes.transData.transform((0.0, rough))
    radius = 4.5 / 2 * figure.dpi / 72
    assert not (number.y0 < y + radius and number.y1 > y - radius), "the circle is on the number"


def test_what_is_almost_one_is_not_one() -> None:
    assert texts(comparison_figure([summary("mbc", [0.995])], "title")) == ["0.995"]


def test_the_change_of_the_error_is_in_percent() -> None:
    course = np.zeros((100, 4, 3))
    courses = {"demonstration": course, "before": course + 0.01, "after": np.full_like(course, np.nan)}
    figure = tracking_bars([summary("mbc-dmp", [0.9])], courses, 500.0, 9.0, "title")
    assert texts(figure) == ["-24 %", "-92 %"]
    assert figure.axes[0].get_xlim() == pytest.approx((9.0, 9.0 + 99 / 500))


def test_a_fall_before_is_said_with_the_change() -> None:
    course = np.zeros((100, 4, 3))
    courses = dict.fromkeys(("demonstration", "before", "after"), course)
    figure = tracking_bars([summary("mbc-dmp", [0.9], fell_before=True)], courses, 500.0, 0.0, "title")
    assert texts(figure)[0] == "-24 %\n(fell before)"


def test_the_method_itself_is_the_first_of_its_ablations() -> None:
    found = [summary("mbc-dmp", [0.8], variant="no-adaptation", fell=[True]), summary("mbc-dmp", [0.9, 0.92])]
    figure = ablation_figure(found, "title")
    axes = figure.axes[0]
    assert [label.get_text() for label in axes.get_yticklabels()] == ["MBC-DMP, as it is", "no-adaptation"]
    assert texts(figure) == ["0.910", "0.800 ×"]
    assert axes.yaxis_inverted()
    assert axes.get_xlim() == (0, 1)
    figure.draw_without_rendering()
    assert all(t.get_window_extent().x0 > axes.get_window_extent().x1 for t in axes.texts)
    assert all(t.get_window_extent().x1 <= figure.bbox.x1 for t in axes.texts)
