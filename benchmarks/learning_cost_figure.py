"""The figure of what a reward costs: learning and searching on the same axes."""

from collections.abc import Callable, Sequence
from itertools import zip_longest
from typing import Any, Final

import numpy as np
from learning_cost import CONTROL_RATE_HZ, Course
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from fastmimic.base.arrays import Array
from fastmimic.imitation.methods import METHODS, RL
from fastmimic.render.figure_style import INK, MUTED, Line, new_figure, tidy

_COLORS: Final = {name: METHODS[name].color for name in ("rl", "mbc-dmp", "mbc")}
_LABELS: Final = {
    "rl": f"{METHODS[RL].label}, one policy a motion",
    "mbc-dmp": f"{METHODS['mbc-dmp'].label}, best candidate so far",
    "mbc": f"{METHODS['mbc'].label}, nothing optimised",
}
_MOTIONS: Final[tuple[tuple[Any, str], ...]] = (  # dash pattern and marker
    ("solid", "o"),
    ((0, (5, 1.6)), "s"),
    ((0, (1.5, 1.2)), "^"),
    ((0, (6, 1.5, 1.5, 1.5)), "D"),
    ((0, (1, 2.5)), "v"),
)
_MARKERS: Final = 5
"""Of a curve of many points."""


def cost_figure(courses: Sequence[Course], paper: tuple[float, float], title: str) -> Figure:
    """Reward against simulated time, and against processor time, both logarithmic; a colour a method, a line a motion.

    A training's curve is each evaluation's; a search's is its best candidate so far, the mean over its seeds, with a
    band from the least to the greatest. What was not optimised is a horizontal line.

    Args:
        courses: see `learning_cost`.
        paper: what the paper's number of policy steps takes: simulated time and processor time, s.
        title: heading.
    """
    motions = list(dict.fromkeys(course.row["motion"] for course in courses))
    styles = {motion: _MOTIONS[i % len(_MOTIONS)] for i, motion in enumerate(motions)}
    methods = [name for name in _COLORS if any(course.row["method"] == name for course in courses)]
    figure = new_figure(11.5, 5.0, title)
    panels: tuple[tuple[str, Callable[[Course], Array], str], ...] = (
        ("Samples", lambda course: course.simulated_s, f"simulated time (s); {CONTROL_RATE_HZ:g} control steps each"),
        ("Time", lambda course: course.cpu_s, "processor time, one core (s)"),
    )
    grid = figure.subplots(1, 2, sharey=True)
    for axes, (name, cost, label), at_paper in zip(grid, panels, paper, strict=True):
        for method in methods:
            for motion in motions:
                own = [c for c in courses if (c.row["method"], c.row["motion"]) == (method, motion)]
                _draw(axes, own, cost, Line(_COLORS[method], styles[motion][0], 1.6), styles[motion][1])
        axes.set_xscale("log")
        axes.axvline(at_paper, color=MUTED, linewidth=0.9, linestyle=(0, (3, 2)))
        axes.annotate(
            "the paper's 100 million\nsteps of a policy",
            (at_paper, 0.02),
            xytext=(-4, 0),
            textcoords="offset points",
            ha="right",
            fontsize=8,
            color=MUTED,
        )
        axes.set_ylim(0, 1.02)
        tidy(axes, f"{name}: reward against {label.split(',')[0].split(' (')[0]}", label)
    grid[0].set_ylabel("reward (0 to 1)", fontsize=9, color=MUTED)
    colors = [Line2D([], [], color=_COLORS[name], linewidth=2.4, label=_LABELS[name]) for name in methods]
    lines = [
        Line2D([], [], color=INK, linestyle=dashes, linewidth=1.4, marker=marker, markersize=4, label=motion)
        for motion, (dashes, marker) in styles.items()
    ]
    none = Line2D([], [], linestyle="", label=" ")
    rows = [handle for column in zip_longest(colors, lines, fillvalue=none) for handle in column]
    figure.legend(handles=rows, loc="outside lower center", ncols=len(rows) // 2, fontsize=8.5, frameon=False)
    return figure


def _draw(axes: Axes, own: Sequence[Course], cost: Callable[[Course], Array], line: Line, marker: str) -> None:
    """One method on one motion."""
    if not own:
        return
    if not any(len(course.reward) for course in own):
        axes.axhline(own[0].row["reward_mean"], **{**line._asdict(), "linewidth": 1.0}, zorder=2)
        return
    if own[0].row["method"] == RL:
        for course in own:
            axes.plot(cost(course), course.reward, **line._asdict(), marker=marker, markersize=4, zorder=4)
        return
    length = min(len(course.reward) for course in own)
    rewards = np.array([course.reward[:length] for course in own])
    spent = np.array([cost(course)[:length] for course in own])
    spent = spent[np.isfinite(spent).all(axis=1)]
    if len(spent):
        x = spent.mean(axis=0)
        every = np.unique(np.geomspace(1, length, _MARKERS).astype(int) - 1).tolist()
        axes.plot(x, rewards.mean(axis=0), **line._asdict(), marker=marker, markersize=4, markevery=every, zorder=3)
        axes.fill_between(
            x, rewards.min(axis=0), rewards.max(axis=0), color=line.color, alpha=0.18, linewidth=0, zorder=1
        )
