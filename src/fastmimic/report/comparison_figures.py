"""The figures of a comparison: rewards by method, tracking before and after optimisation, ablations."""

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from fastmimic.base.arrays import Array
from fastmimic.base.conventions import LEGS
from fastmimic.experiments.ablations import ABLATED
from fastmimic.experiments.tables import Summary
from fastmimic.imitation.methods import METHODS, method_named
from fastmimic.render.figure_style import AFTER, BEFORE, DEMONSTRATION, INK, MUTED, new_figure, tidy

_BAR: Final = 0.84  # share of a group's width taken by bars
_LABEL: Final = 0.04  # height of a bar's number, in units of the reward
_CIRCLE: Final = 0.02  # height of a circle with its gap to the number, in units of the reward
_TRACKED_LEG: Final = "RL"  # of the paper's tracking figures


def comparison_figure(summaries: Sequence[Summary], title: str) -> Figure:
    """Reward of every method on every motion, grouped by motion, methods in the paper's order; without variants."""
    motions, methods = _names(summaries)
    found = {(s.motion, s.method): s for s in summaries}
    figure = new_figure(max(7.5, 1.2 + 0.42 * len(motions) * (len(methods) + 1)), 4.6, title)
    axes = figure.subplots()
    width = _BAR / len(methods)
    for j, name in enumerate(methods):
        color, hatch = METHODS[name].color, METHODS[name].hatch
        for i, motion in enumerate(motions):
            if (motion, name) in found:
                _bar(axes, i - _BAR / 2 + (j + 0.5) * width, width, found[motion, name], color, hatch)
    axes.set_xticks(range(len(motions)), motions)
    axes.set_xlim(-0.55, len(motions) - 0.45)
    axes.set_ylim(0, 1.12)
    axes.set_yticks(np.linspace(0, 1, 6))
    tidy(axes, "Bars: one nominal episode, mean ± std over the seeds. Circles: perturbed starts", "", "reward (0 to 1)")
    axes.grid(False, axis="x")
    axes.tick_params(axis="x", labelsize=9.5, length=0)
    handles: list[Patch | Line2D] = [
        Patch(facecolor=m.color, hatch=m.hatch, edgecolor="white", label=m.label)
        for m in (METHODS[name] for name in methods)
    ]
    handles += [
        Line2D(
            [], [], marker="o", markerfacecolor="white", markeredgecolor=INK, linestyle="", label="perturbed starts"
        ),
        Line2D([], [], marker="$×$", color=INK, linestyle="", label="fell in the nominal episode"),
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=len(handles), fontsize=9, frameon=False)
    return figure


def _bar(axes: Axes, x: float, width: float, s: Summary, color: str, hatch: str) -> None:
    mean, std, rough = s.mean("reward"), s.std("reward"), s.mean("reward_perturbed")
    assert mean is not None, "every run has a reward"
    axes.bar(x, mean, 0.92 * width, color=color, hatch=hatch, edgecolor="white", linewidth=0)
    if std is not None:
        axes.errorbar(x, mean, std, color=INK, capsize=2.5, linewidth=1.1)
    if rough is not None:
        axes.plot(x, rough, marker="o", markersize=4.5, markerfacecolor="white", markeredgecolor=INK)
    top = mean + (std or 0.0)
    text = f"{mean:.3f}{_falls(s)}".replace(" ", "\n", 1)
    tall = _LABEL * len(text.splitlines()) + _CIRCLE
    near = rough is not None and -_CIRCLE < rough - top < tall  # the circle would be where the number goes
    axes.annotate(
        text,
        (x, max(rough, top) if near and rough is not None else top),
        xytext=(0, 5 if near else 3),
        textcoords="offset points",
        ha="center",
        fontsize=7,
        color=INK,
    )


def tracking_bars(
    summaries: Sequence[Summary], courses: Mapping[str, Array], rate_hz: float, start_s: float, title: str
) -> Figure:
    """The paper's tracking figures: foot height and fore-aft position before and after optimisation.

    Left, the left rear foot on one motion (the paper: pace); right, the error of all feet on every motion, and its
    change in percent.

    Args:
        summaries: of one optimising method, without variants.
        courses: `demonstration`, `before` and `after`, (t, 4, 3) feet in the body frame, m; NaN after a fall.
        rate_hz: of the courses.
        start_s: time of their first sample in the episode, s.
    """
    figure = new_figure(12.0, 6.4, title)
    grid = figure.subplots(2, 2, width_ratios=(3, 2))
    time = start_s + np.arange(len(courses["demonstration"])) / rate_hz
    leg = LEGS.index(_TRACKED_LEG)
    for row, (axis, name) in enumerate(((2, "z"), (0, "x"))):
        axes = grid[row, 0]
        for key, line, order in (("demonstration", DEMONSTRATION, 2), ("before", BEFORE, 4), ("after", AFTER, 3)):
            axes.plot(time, courses[key][:, leg, axis], **line.kwargs(), label=key, zorder=order)
        tidy(axes, f"{_TRACKED_LEG} foot {name}", "time (s)", f"foot {name}, body frame (m)")
        axes.set_xlim(time[0], time[-1])
        _error_bars(grid[row, 1], summaries, name)
    handles, labels = grid[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=3, fontsize=9, frameon=False)
    return figure


def _error_bars(axes: Axes, summaries: Sequence[Summary], axis: str) -> None:
    """RMS errors of the four feet in one axis, before and after, with the change in percent."""
    top = 0.0
    for i, s in enumerate(summaries):
        before, after = (s.mean(f"foot_{axis}_rmse_{when}_m") for when in ("before", "after"))
        if before is None or after is None:
            continue
        std = s.std(f"foot_{axis}_rmse_after_m")
        axes.bar(i - 0.2, 1e3 * before, 0.38, color=BEFORE.color, hatch="//", edgecolor="white", linewidth=0)
        axes.bar(i + 0.2, 1e3 * after, 0.38, color=AFTER.color)
        if std is not None:
            axes.errorbar(i + 0.2, 1e3 * after, 1e3 * std, color=INK, capsize=2.5, linewidth=1.1)
        highest = 1e3 * max(before, after + (std or 0.0))
        fell = "\n(fell before)" if (s.mean("fell_before") or 0.0) > 0 else ""
        axes.annotate(
            _change(before, after) + fell,
            (i, highest),
            xytext=(0, 3),
            textcoords="offset points",
            ha="center",
            fontsize=8.5,
            color=INK,
        )
        top = max(top, highest)
    axes.set_xticks(range(len(summaries)), [s.motion for s in summaries])
    axes.set_ylim(0, 1.25 * top if top > 0 else 1.0)
    tidy(axes, f"Foot {axis}: error before → after", "", "RMS, four feet (mm)")
    axes.grid(False, axis="x")


def _falls(s: Summary) -> str:
    """A cross after falls in nominal episodes, with the share of the seeds if not all fell."""
    fell = s.mean("fell") or 0.0
    return "" if fell == 0 else " ×" if fell == 1 else f" × {100 * fell:.0f} %"


def _change(before: float, after: float) -> str:
    """The change in percent."""
    percent = round(100 * (after - before) / before) if before > 0 else 0
    return f"{percent:+d} %" if percent else "±0 %"


def ablation_figure(summaries: Sequence[Summary], title: str) -> Figure:
    """Reward of the method and of its variants, one panel per motion."""
    motions = list(dict.fromkeys(s.motion for s in summaries))
    variants = list(dict.fromkeys(s.variant for s in summaries))
    variants.sort(key=bool)  # the method itself first
    found = {(s.motion, s.variant): s for s in summaries}
    figure = new_figure(2.6 + 2.4 * len(motions), 1.5 + 0.36 * len(variants), title)
    grid = figure.subplots(1, len(motions), sharey=True, squeeze=False)
    for axes, motion in zip(grid[0], motions, strict=True):
        for j, variant in enumerate(variants):
            s = found.get((motion, variant))
            if s is not None:
                _row(axes, j, s)
        if (motion, "") in found:
            axes.axvline(found[motion, ""].mean("reward") or 0.0, color=MUTED, linewidth=0.9, linestyle=(0, (3, 2)))
        axes.set_xlim(0, 1)
        axes.set_xticks((0, 0.5, 1))
        axes.set_yticks(range(len(variants)), [v or f"{method_named(ABLATED).label}, as it is" for v in variants])
        tidy(axes, motion, "reward", "")
        axes.grid(False, axis="y")
    grid[0, 0].invert_yaxis()
    handles = [
        Line2D(
            [], [], marker="o", markerfacecolor="white", markeredgecolor=INK, linestyle="", label="perturbed starts"
        ),
        Line2D([], [], marker="$×$", color=INK, linestyle="", label="fell in the nominal episode"),
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=2, fontsize=8.5, frameon=False)
    return figure


def _row(axes: Axes, y: float, s: Summary) -> None:
    mean, std, rough = s.mean("reward"), s.std("reward"), s.mean("reward_perturbed")
    assert mean is not None, "every run has a reward"
    axes.barh(y, mean, 0.72, color=AFTER.color if not s.variant else "#9db8cc")
    if std is not None:
        axes.errorbar(mean, y, xerr=std, color=INK, capsize=2.5, linewidth=1.1)
    if rough is not None:
        axes.plot(rough, y, marker="o", markersize=4.5, markerfacecolor="white", markeredgecolor=INK, clip_on=False)
    axes.annotate(
        f"{mean:.3f}{_falls(s)}",
        (1, y),
        xytext=(5, 0),
        textcoords="offset points",
        va="center",
        fontsize=7.5,
        color=INK,
        annotation_clip=False,
    )


def _names(summaries: Sequence[Summary]) -> tuple[list[str], list[str]]:
    motions = list(dict.fromkeys(s.motion for s in summaries))
    methods = [name for name in METHODS if any(s.method == name for s in summaries)]
    return motions, methods
