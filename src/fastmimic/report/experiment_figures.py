"""The tables and figures of `fastmimic stress` and `fastmimic transfer`."""

import math
from collections.abc import Sequence
from typing import Any, Final

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from fastmimic.base.text import csv_text
from fastmimic.experiments import stress, transfer
from fastmimic.experiments.experiment import all_parts, part_file
from fastmimic.imitation.methods import METHODS, method_named
from fastmimic.render.figure_style import INK, MUTED, Line, legend_below, new_figure, save, tidy, write_at
from fastmimic.runs.work_folder import RESULTS_CSV, TABLE, WorkFolder
from fastmimic.simulation.disturbance_kinds import DISTURBANCES
from fastmimic.simulation.terrain import TERRAINS

SUCCESS_FIGURE: Final = "success.png"
REWARD_FIGURE: Final = "reward.png"
TRANSFER_FIGURE: Final = "transfer.png"
STRESS_FILES: Final = (RESULTS_CSV, TABLE, SUCCESS_FIGURE, REWARD_FIGURE)
TRANSFER_FILES: Final = (RESULTS_CSV, TABLE, TRANSFER_FIGURE)

_LINES: Final = (  # Okabe and Ito's colours, each with a dash pattern and a marker of its own
    (Line("#0072b2", "solid", 1.7), "o"),
    (Line("#d55e00", (0, (5, 1.6)), 1.7), "s"),
    (Line("#009e73", (0, (1.5, 1.2)), 1.7), "^"),
    (Line("#cc79a7", (0, (6, 1.5, 1.5, 1.5)), 1.7), "v"),
    (Line("#e69f00", (0, (3, 1)), 1.7), "D"),
    (Line("#56b4e9", (0, (1, 1)), 1.7), "x"),
)
_COLUMNS: Final = 4
_CURVES: Final = {"fell": "episodes without a fall", "reward_mean": "mean reward"}
_COLORS: Final = (("#0072b2", ""), ("#56b4e9", "//"), ("#e69f00", "\\\\"), ("#d55e00", "xx"), ("#009e73", ".."))


def write_stress(folder: WorkFolder, settings: stress.StressSettings, planned: Sequence[tuple[str, str]]) -> None:
    """Writes tables and figures of all finished sweeps; counts the missing of `planned` (method, disturbance)."""
    rows = [{**row, "value": float(row["value"])} for row in all_parts(folder.path / stress.SWEEPS)]  # JSON has no inf
    methods, names = list(METHODS), [*DISTURBANCES, *TERRAINS]
    rows.sort(key=lambda row: (methods.index(row["method"]), names.index(row["disturbance"]), row["value"]))
    if not rows:
        return
    missing = sum(not part_file(folder.path / stress.SWEEPS, *one).is_file() for one in planned)
    folder.write(RESULTS_CSV, csv_text(stress.COLUMNS, rows))
    folder.write(TABLE, stress.stress_table(rows, settings, missing))
    about = f"{rows[0]['motion']} on {settings.robot} in {settings.simulator}, {settings.episodes} episodes a point"
    save(stress_figure(rows, "fell", f"What is withstood: {about}"), folder.path / SUCCESS_FIGURE)
    save(stress_figure(rows, "reward_mean", f"What it is worth: {about}"), folder.path / REWARD_FIGURE)


def stress_figure(rows: Sequence[dict[str, Any]], curve: str, title: str) -> Figure:
    """One panel per disturbance, one line per method: "fell", as the share without a fall, or "reward_mean" of rows."""
    names = list(dict.fromkeys(row["disturbance"] for row in rows))
    methods = [name for name in METHODS if any(row["method"] == name for row in rows)]
    columns = min(_COLUMNS, len(names))
    count = -(-len(names) // columns)
    figure = new_figure(max(8.5, 3.3 * columns), 0.9 + 2.35 * count, title)
    grid = figure.subplots(count, columns, sharey=True, squeeze=False)
    for axes in grid.flat[len(names) :]:
        axes.set_axis_off()
    for axes, name in zip(grid.flat, names, strict=False):
        _panel(axes, [row for row in rows if row["disturbance"] == name], methods, curve)
    for row in grid:
        row[0].set_ylabel(_CURVES[curve], fontsize=9, color=MUTED)
    legend_below(figure, grid[0, 0])
    return figure


def _panel(axes: Axes, rows: Sequence[dict[str, Any]], methods: Sequence[str], curve: str) -> None:
    kind = stress.swept(rows[0]["disturbance"])
    finite = [row["value"] for row in rows if math.isfinite(row["value"])]
    beyond = 1.2 * max(finite)  # where a value without bound is drawn
    for i, method in enumerate(methods):
        own = sorted((row for row in rows if row["method"] == method), key=lambda row: float(row["value"]))
        line, marker = _LINES[i % len(_LINES)]
        x = [min(row["value"], beyond) for row in own]
        y = [1.0 - row[curve] if curve == "fell" else row[curve] for row in own]
        axes.plot(x, y, **line._asdict(), marker=marker, markersize=4, label=method_named(method).label, zorder=3)
    axes.axvline(
        min(kind.nominal, beyond), color=MUTED, linewidth=0.9, linestyle=(0, (3, 2)), label="nominal value", zorder=1
    )
    if curve == "fell":
        axes.axhline(stress.SUCCESS, color="#bbbbbb", linewidth=0.8, zorder=1)
    axes.xaxis.set_major_locator(MaxNLocator(5, steps=[1, 2, 2.5, 5, 10]))
    if len(finite) < len(rows):
        ticks = [tick for tick in axes.get_xticks() if min(finite) <= tick <= max(finite)]
        axes.set_xticks([*ticks, beyond], [*(f"{tick:g}" for tick in ticks), "∞"])
    axes.set_ylim(-0.03, 1.03)
    tidy(axes, kind.name, kind.unit or "(–)")


def write_transfer(folder: WorkFolder, planned: Sequence[tuple[str, str]]) -> None:
    """Writes table and figure of all finished trials, if any; counts the missing of `planned` (motion, method)."""
    order = list(dict.fromkeys(motion for motion, _ in planned))
    found = transfer.all_trials(folder.path)
    rows = sorted(found, key=lambda row: order.index(row["motion"]) if row["motion"] in order else len(order))
    if not rows:
        return
    missing = sum(not part_file(folder.path / transfer.PARTS, *one).is_file() for one in planned)
    folder.write(RESULTS_CSV, csv_text(transfer.COLUMNS, rows))
    folder.write(TABLE, transfer.transfer_table(rows, missing))
    save(transfer_figure(rows), folder.path / TRANSFER_FIGURE)


def transfer_figure(rows: Sequence[dict[str, Any]]) -> Figure:
    """One panel per motion, one group of bars per method, and a panel of the paper's numbers, from the trials' rows."""
    found = transfer.transferred(rows)
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
    for i, (_, simulated, deviation, real, spread) in enumerate(transfer.PAPER):
        _bar(panels[-1], i - 0.2, 0.36, simulated, deviation, *_COLORS[0])
        _bar(panels[-1], i + 0.2, 0.36, real, spread, *_COLORS[3])
    panels[-1].set_xticks(range(len(transfer.PAPER)), [label for label, *_ in transfer.PAPER])
    tidy(panels[-1], "the paper's turn, real robot")
    for axes in panels:
        axes.set_ylim(0, 1.05)
        axes.grid(False, axis="x")
        axes.tick_params(axis="x", length=0)
    panels[0].set_ylabel("reward (0 to 1)", fontsize=9)
    handles = [
        Patch(facecolor=color, hatch=hatch, edgecolor="white", label=stage.label)
        for (color, hatch), stage in zip(_COLORS, transfer.stages_of(rows), strict=False)
    ]
    note = Line2D([], [], marker="$×n$", markersize=11, color=INK, linestyle="", label="n trials ended in a fall")
    legend_below(figure, more=[*handles, note])
    return figure


def _bars(axes: Axes, at: float, t: transfer.Transferred) -> None:
    for k, ((color, hatch), rewards, falls) in enumerate(zip(_COLORS, t.rewards, t.falls, strict=False)):
        step = 0.8 / len(t.rewards)
        x = at + step * (k - 0.5 * (len(t.rewards) - 1))
        _bar(axes, x, 0.9 * step, float(rewards.mean()), float(rewards.std()), color, hatch)
        if falls:
            axes.annotate(f"×{falls}", (x, 0.02), ha="center", fontsize=8, color="white", fontweight="bold")


def _bar(axes: Axes, x: float, width: float, mean: float, std: float, color: str, hatch: str) -> None:
    axes.bar(x, mean, width, color=color, hatch=hatch, edgecolor="white", linewidth=0, zorder=2)
    axes.errorbar(x, mean, std, color=INK, capsize=2, linewidth=1.0, zorder=3)
    write_at(axes, f"{mean:.2f}", (x, min(mean + std, 1.0)), (0, 2), 7)
