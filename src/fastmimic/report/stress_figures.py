"""The tables and figures of `fastmimic stress`: success and reward over the range of each disturbance."""

import math
from collections.abc import Sequence
from typing import Any, Final

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from fastmimic.experiments.stress import SUCCESS, StressSettings, all_sweeps, stress_table, sweep_file, to_csv
from fastmimic.imitation.methods import METHODS, method_named
from fastmimic.render.figure_style import MUTED, Line, new_figure, save, tidy
from fastmimic.runs.work_folder import RESULTS_CSV, TABLE, WorkFolder
from fastmimic.simulation.disturbance_kinds import DISTURBANCES

SUCCESS_FIGURE: Final = "success.png"
REWARD_FIGURE: Final = "reward.png"
WRITTEN: Final = (RESULTS_CSV, TABLE, SUCCESS_FIGURE, REWARD_FIGURE)

_LINES: Final = (  # Okabe and Ito's colours, each with a dash pattern and a marker of its own
    (Line("#0072b2", "solid", 1.7), "o"),
    (Line("#d55e00", (0, (5, 1.6)), 1.7), "s"),
    (Line("#009e73", (0, (1.5, 1.2)), 1.7), "^"),
    (Line("#cc79a7", (0, (6, 1.5, 1.5, 1.5)), 1.7), "v"),
    (Line("#e69f00", (0, (3, 1)), 1.7), "D"),
    (Line("#56b4e9", (0, (1, 1)), 1.7), "x"),
)
_COLUMNS: Final = 4
_CURVES: Final = {"success": "episodes without a fall", "reward_mean": "mean reward"}


def write_stress(folder: WorkFolder, settings: StressSettings, planned: Sequence[tuple[str, str]]) -> None:
    """Writes the tables and figures of all finished sweeps in a folder, if any, and counts the missing ones of
    `planned`, (method, disturbance) each. Raises `OutputError`."""
    rows = all_sweeps(folder.path)
    if not rows:
        return
    missing = sum(not sweep_file(folder.path, *one).is_file() for one in planned)
    folder.write(RESULTS_CSV, to_csv(rows))
    folder.write(TABLE, stress_table(rows, settings, missing))
    about = f"{rows[0]['motion']} on {settings.robot} in {settings.simulator}, {settings.episodes} episodes a point"
    save(stress_figure(rows, "success", f"What is withstood: {about}"), folder.path / SUCCESS_FIGURE)
    save(stress_figure(rows, "reward_mean", f"What it is worth: {about}"), folder.path / REWARD_FIGURE)


def stress_figure(rows: Sequence[dict[str, Any]], curve: str, title: str) -> Figure:
    """One panel per disturbance, one line per method.

    Args:
        rows: of the sweeps, see `fastmimic.experiments.stress.COLUMNS`.
        curve: "success" or "reward_mean".
    """
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
    handles, labels = grid[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(methods) + 1, fontsize=9, frameon=False)
    return figure


def _panel(axes: Axes, rows: Sequence[dict[str, Any]], methods: Sequence[str], curve: str) -> None:
    kind = DISTURBANCES[rows[0]["disturbance"]]
    finite = [row["value"] for row in rows if math.isfinite(row["value"])]
    beyond = 1.2 * max(finite)  # where a value without bound is drawn
    for i, method in enumerate(methods):
        own = sorted((row for row in rows if row["method"] == method), key=lambda row: float(row["value"]))
        line, marker = _LINES[i % len(_LINES)]
        x = [min(row["value"], beyond) for row in own]
        y = [row[curve] for row in own]
        axes.plot(
            x,
            y,
            **line.kwargs(),
            marker=marker,
            markersize=4,
            label=method_named(method).label,
            zorder=3,
        )
    axes.axvline(
        min(kind.nominal, beyond), color=MUTED, linewidth=0.9, linestyle=(0, (3, 2)), label="nominal value", zorder=1
    )
    if curve == "success":
        axes.axhline(SUCCESS, color="#bbbbbb", linewidth=0.8, zorder=1)
    axes.xaxis.set_major_locator(MaxNLocator(5, steps=[1, 2, 2.5, 5, 10]))
    if len(finite) < len(rows):
        ticks = [tick for tick in axes.get_xticks() if min(finite) <= tick <= max(finite)]
        axes.set_xticks([*ticks, beyond], [*(f"{tick:g}" for tick in ticks), "∞"])
    axes.set_ylim(-0.03, 1.03)
    tidy(axes, kind.name, kind.unit or "(–)")
