"""The table and figure of `fastmimic transfer`: rewards before and after."""

from collections.abc import Sequence
from typing import Any, Final

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from fastmimic.experiments.transfer import (
    PAPER,
    Transferred,
    all_trials,
    part_file,
    stages_of,
    to_csv,
    transfer_table,
    transferred,
)
from fastmimic.imitation.methods import method_named
from fastmimic.render.figure_style import INK, new_figure, save, tidy
from fastmimic.runs.work_folder import RESULTS_CSV, TABLE, WorkFolder

FIGURE: Final = "transfer.png"
WRITTEN: Final = (RESULTS_CSV, TABLE, FIGURE)
_COLORS: Final = (("#0072b2", ""), ("#56b4e9", "//"), ("#e69f00", "\\\\"), ("#d55e00", "xx"), ("#009e73", ".."))


def write_transfer(folder: WorkFolder, planned: Sequence[tuple[str, str]]) -> None:
    """Writes the table and the figure of all finished trials in a folder, if any, and counts the missing ones of
    `planned`, (motion, method) each. Raises `OutputError`."""
    order = list(dict.fromkeys(motion for motion, _ in planned))
    rows = sorted(
        all_trials(folder.path), key=lambda row: order.index(row["motion"]) if row["motion"] in order else len(order)
    )
    if not rows:
        return
    missing = sum(not part_file(folder.path, *one).is_file() for one in planned)
    folder.write(RESULTS_CSV, to_csv(rows))
    folder.write(TABLE, transfer_table(rows, missing))
    save(transfer_figure(rows), folder.path / FIGURE)


def transfer_figure(rows: Sequence[dict[str, Any]]) -> Figure:
    """One panel per motion, one group of bars per method, and a panel of the paper's numbers. `rows` are of the trials,
    see `fastmimic.experiments.transfer.COLUMNS`."""
    found = transferred(rows)
    motions = list(dict.fromkeys(t.motion for t in found))
    groups = [[t for t in found if t.motion == motion] for motion in motions]
    widths = [max(1.6, len(group)) for group in groups] + [2.0]
    robot = rows[0]["robot"]
    figure = new_figure(1.4 + 2.3 * sum(widths) / 1.6, 4.3, f"Transfer without any change, {robot}")
    panels = figure.subplots(1, len(widths), sharey=True, width_ratios=widths, squeeze=False)[0]
    for axes, motion, group in zip(panels, motions, groups, strict=False):
        for i, t in enumerate(group):
            _bars(axes, i, t)
        axes.set_xticks(range(len(group)), [method_named(t.method).label for t in group])
        tidy(axes, motion)
    _paper(panels[-1])
    for axes in panels:
        axes.set_ylim(0, 1.05)
        axes.grid(False, axis="x")
        axes.tick_params(axis="x", length=0)
    panels[0].set_ylabel("reward (0 to 1)", fontsize=9)
    handles = [
        Patch(facecolor=color, hatch=hatch, edgecolor="white", label=stage.label)
        for (color, hatch), stage in zip(_COLORS, stages_of(rows), strict=False)
    ]
    note = Line2D([], [], marker="$×n$", markersize=11, color=INK, linestyle="", label="n trials ended in a fall")
    figure.legend(
        handles=[*handles, note], loc="outside lower center", ncols=len(handles) + 1, fontsize=9, frameon=False
    )
    return figure


def _bars(axes: Axes, at: float, t: Transferred) -> None:
    for k, ((color, hatch), rewards, falls) in enumerate(zip(_COLORS, t.rewards, t.falls, strict=False)):
        step = 0.8 / len(t.rewards)
        x = at + step * (k - 0.5 * (len(t.rewards) - 1))
        _bar(axes, x, 0.9 * step, float(rewards.mean()), float(rewards.std()), color, hatch)
        if falls:
            axes.annotate(f"×{falls}", (x, 0.02), ha="center", fontsize=8, color="white", fontweight="bold")


def _paper(axes: Axes) -> None:
    for i, (_, simulated, deviation, real, spread) in enumerate(PAPER):
        _bar(axes, i - 0.2, 0.36, simulated, deviation, *_COLORS[0])
        _bar(axes, i + 0.2, 0.36, real, spread, *_COLORS[3])
    axes.set_xticks(range(len(PAPER)), [label for label, *_ in PAPER])
    tidy(axes, "the paper's turn, real robot")


def _bar(axes: Axes, x: float, width: float, mean: float, std: float, color: str, hatch: str) -> None:
    axes.bar(x, mean, width, color=color, hatch=hatch, edgecolor="white", linewidth=0, zorder=2)
    axes.errorbar(x, mean, std, color=INK, capsize=2, linewidth=1.0, zorder=3)
    axes.annotate(
        f"{mean:.2f}",
        (x, min(mean + std, 1.0)),
        xytext=(0, 2),
        textcoords="offset points",
        ha="center",
        fontsize=7,
        color=INK,
    )
