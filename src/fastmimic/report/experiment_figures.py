"""The tables and figures of `fastmimic compare`, `stress` and `transfer`."""

import math
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from fastmimic.base.arrays import Array
from fastmimic.base.conventions import LEGS
from fastmimic.base.errors import OutputError
from fastmimic.base.files import UNREADABLE, open_arrays, packaged, remove_file
from fastmimic.base.text import csv_text
from fastmimic.experiments import comparison_run as compared
from fastmimic.experiments import stress, transfer
from fastmimic.experiments.ablations import ABLATED
from fastmimic.experiments.compare import ComparisonPlan
from fastmimic.experiments.comparison_run import ComparisonFolder, Row, Run, run_of
from fastmimic.experiments.experiment import all_parts, part_file
from fastmimic.experiments.measurement import COLUMNS, Summary, ablation_table, comparison_table, summaries
from fastmimic.imitation.methods import METHODS, Method
from fastmimic.render import figure_style as style
from fastmimic.render.figure_style import AFTER, BEFORE, DEMONSTRATION, INK, MUTED
from fastmimic.runs.work_folder import RESULTS_CSV, TABLE, WorkFolder
from fastmimic.simulation.disturbance_kinds import DISTURBANCES
from fastmimic.simulation.terrain import TERRAINS

SHOWN: Final = "dog:pace"  # the tracking figure's motion, as in the paper; else the first one compared
_PERTURBED: Final[dict[str, Any]] = {"marker": "o", "markerfacecolor": "white", "markeredgecolor": INK}
_THIN: Final[dict[str, Any]] = {"color": MUTED, "linewidth": 0.9, "linestyle": (0, (3, 2))}
_BAR: Final = 0.84  # share of a group's width taken by bars
_LABEL: Final = 0.04  # height of a bar's number, in units of the reward
_CIRCLE: Final = 0.02  # height of a circle with its gap to the number, in units of the reward
_TRACKED_LEG: Final = "RL"  # of the paper's tracking figures

SUCCESS_FIGURE: Final = "success.png"
REWARD_FIGURE: Final = "reward.png"
TRANSFER_FIGURE: Final = "transfer.png"
STRESS_FILES: Final = (RESULTS_CSV, TABLE, SUCCESS_FIGURE, REWARD_FIGURE)
TRANSFER_FILES: Final = (RESULTS_CSV, TABLE, TRANSFER_FIGURE)

_LINES: Final = packaged("fastmimic.report", "lines.json", tuple[tuple[str, style.Dash, str], ...])
"""Okabe and Ito's colours, each with a dash pattern and a marker of its own."""
_COLUMNS: Final = 4
_CURVES: Final = {"fell": "episodes without a fall", "reward_mean": "mean reward"}
_COLORS: Final = (("#0072b2", ""), ("#56b4e9", "//"), ("#e69f00", "\\\\"), ("#d55e00", "xx"), ("#009e73", ".."))


def write_comparison(folder: ComparisonFolder, plan: ComparisonPlan, rows: Sequence[Row]) -> None:
    """Writes tables and figures of finished runs, the plan's and others; says if some miss. Raises `OutputError`."""
    missing = {*plan.runs} - {run_of(row) for row in rows}
    found = folder.in_order(rows)
    written = [RESULTS_CSV]
    folder.write(RESULTS_CSV, csv_text(COLUMNS, found))
    whole = [row for row in found if not row["variant"]]
    if whole:
        folder.write(TABLE, comparison_table(whole, len(whole) + sum(not run.variant for run in missing)))
        figure = comparison_figure(summaries(whole), f"Reward by method, {whole[0]['robot']}")
        style.save(figure, folder.path / compared.COMPARISON)
        written += [TABLE, compared.COMPARISON, *_write_tracking(folder, whole)]
    of = {row["motion"] for row in found if row["variant"]} | {*(plan.motions if plan.ablations else ())}
    own = [row for row in found if row["method"] == ABLATED and row["motion"] in of]
    if own:
        left = sum(run.method == ABLATED and run.motion in of for run in missing)
        folder.write(compared.ABLATION_TABLE, ablation_table(own, len(own) + left))
        title = f"What the parts of {METHODS[ABLATED].label} are worth, {own[0]['robot']}"
        style.save(ablation_figure(summaries(own), title), folder.path / compared.ABLATION_FIGURE)
        written += [compared.ABLATION_TABLE, compared.ABLATION_FIGURE]
    for name in compared.WRITTEN:
        if name not in written:
            remove_file(folder.path / name)


def _write_tracking(folder: ComparisonFolder, rows: Sequence[Row]) -> list[str]:
    """Of the paper's method, or else the first optimising one; nothing without one."""
    methods = [row["method"] for row in rows if METHODS[row["method"]].optimises]
    if not methods:
        return []
    method = ABLATED if ABLATED in methods else methods[0]
    own = [row for row in rows if row["method"] == method]
    row = next((row for row in own if row["motion"] == SHOWN), own[0])
    run = Run(row["motion"], method, "", row["seed"])
    path = folder.path / compared.RUNS / run.folder / compared.TRACKING
    try:
        with open_arrays(path) as file:
            courses = {name: file[name] for name in ("demonstration", "before", "after")}
            rate_hz, start_s = float(file["rate_hz"]), float(file["start_s"])
    except UNREADABLE as error:
        raise OutputError(f"{path}: cannot be read ({error}); remove that folder, and --resume makes it anew") from None
    title = f"Tracking before and after {METHODS[method].label}, {row['robot']} (course: {run.motion})"
    style.save(tracking_bars(summaries(own), courses, rate_hz, start_s, title), folder.path / compared.TRACKING_FIGURE)
    return [compared.TRACKING_FIGURE]


def comparison_figure(summaries: Sequence[Summary], title: str) -> Figure:
    """Reward of every method on every motion, grouped by motion, methods in the paper's order; without variants."""
    motions = list(dict.fromkeys(s.motion for s in summaries))
    methods = [m for m in METHODS.values() if any(s.method == m.name for s in summaries)]
    found = {(s.motion, s.method): s for s in summaries}
    figure = style.new_figure(max(7.5, 1.2 + 0.42 * len(motions) * (len(methods) + 1)), 4.6, title)
    axes = figure.subplots()
    width = _BAR / len(methods)
    for j, method in enumerate(methods):
        for i, motion in enumerate(motions):
            if s := found.get((motion, method.name)):
                _bar(axes, i - _BAR / 2 + (j + 0.5) * width, width, s, method)
    axes.set_xticks(range(len(motions)), motions)
    axes.set_xlim(-0.55, len(motions) - 0.45)
    axes.set_ylim(0, 1.12)
    axes.set_yticks(np.linspace(0, 1, 6))
    said = "Bars: one nominal episode, mean ± std over the seeds. Circles: perturbed starts"
    style.tidy(axes, said, ylabel="reward (0 to 1)", grid="y")
    axes.tick_params(axis="x", labelsize=9.5, length=0)
    bars = [Patch(facecolor=m.color, hatch=m.hatch, edgecolor="white", label=m.label) for m in methods]
    style.legend_below(figure, more=[*bars, *_marks()])
    return figure


def _marks() -> list[Line2D]:
    fell = Line2D([], [], marker="$×$", color=INK, linestyle="", label="fell in the nominal episode")
    return [Line2D([], [], **_PERTURBED, linestyle="", label="perturbed starts"), fell]


def _bar(axes: Axes, x: float, width: float, s: Summary, method: Method) -> None:
    mean, std, rough = s.mean("reward_mean"), s.std("reward_mean"), s.mean("reward_mean_perturbed")
    assert mean is not None, "every run has a reward"
    axes.bar(x, mean, 0.92 * width, color=method.color, hatch=method.hatch, edgecolor="white", linewidth=0)
    if std is not None:
        axes.errorbar(x, mean, std, color=INK, capsize=2.5, linewidth=1.1)
    if rough is not None:
        axes.plot(x, rough, **_PERTURBED, markersize=4.5)
    top = mean + (std or 0.0)
    text = f"{mean:.3f}{_falls(s)}".replace(" ", "\n", 1)
    tall = _LABEL * len(text.splitlines()) + _CIRCLE
    near = rough is not None and -_CIRCLE < rough - top < tall  # the circle would be where the number goes
    style.write_at(axes, text, (x, max(rough, top) if near and rough is not None else top), (0, 5 if near else 3), 7)


def tracking_bars(
    summaries: Sequence[Summary], courses: Mapping[str, Array], rate_hz: float, start_s: float, title: str
) -> Figure:
    """The paper's tracking figures: foot height and fore-aft position before and after an optimising method. Left, the
    left rear foot on one motion (the paper: pace), from `courses`: `demonstration`, `before` and `after`, (t, 4, 3)
    feet in the body frame, m, NaN after a fall, from `start_s` of the episode on. Right, the error of all feet on every
    motion, and its change in percent."""
    figure = style.new_figure(12.0, 6.4, title)
    grid = figure.subplots(2, 2, width_ratios=(3, 2))
    time = start_s + np.arange(len(courses["demonstration"])) / rate_hz
    leg = LEGS.index(_TRACKED_LEG)
    for row, (axis, name) in enumerate(((2, "z"), (0, "x"))):
        axes = grid[row, 0]
        for key, line, order in (("demonstration", DEMONSTRATION, 2), ("before", BEFORE, 4), ("after", AFTER, 3)):
            axes.plot(time, courses[key][:, leg, axis], **line._asdict(), label=key, zorder=order)
        style.tidy(axes, f"{_TRACKED_LEG} foot {name}", "time (s)", f"foot {name}, body frame (m)")
        axes.set_xlim(time[0], time[-1])
        _error_bars(grid[row, 1], summaries, name)
    style.legend_below(figure, grid[0, 0])
    return figure


def _error_bars(axes: Axes, summaries: Sequence[Summary], axis: str) -> None:
    """RMS errors of the four feet in one axis, before and after, with the change in percent."""
    top = 0.0
    for i, s in enumerate(summaries):
        before, after = (s.mean(f"foot_{axis}_rmse_m{when}") for when in ("_before", ""))
        if before is None or after is None:
            continue
        std = s.std(f"foot_{axis}_rmse_m")
        axes.bar(i - 0.2, 1e3 * before, 0.38, color=BEFORE.color, hatch="//", edgecolor="white", linewidth=0)
        axes.bar(i + 0.2, 1e3 * after, 0.38, color=AFTER.color)
        if std is not None:
            axes.errorbar(i + 0.2, 1e3 * after, 1e3 * std, color=INK, capsize=2.5, linewidth=1.1)
        highest = 1e3 * max(before, after + (std or 0.0))
        fell = "\n(fell before)" if (s.mean("fell_before") or 0.0) > 0 else ""
        percent = round(100 * (after - before) / before) if before > 0 else 0
        style.write_at(axes, (f"{percent:+d} %" if percent else "±0 %") + fell, (i, highest), (0, 3), 8.5)
        top = max(top, highest)
    axes.set_xticks(range(len(summaries)), [s.motion for s in summaries])
    axes.set_ylim(0, 1.25 * top if top > 0 else 1.0)
    style.tidy(axes, f"Foot {axis}: error before → after", "", "RMS, four feet (mm)", grid="y")


def _falls(s: Summary) -> str:
    """A cross after falls in nominal episodes, with the share of the seeds if not all fell."""
    fell = s.mean("fell") or 0.0
    return "" if fell == 0 else " ×" if fell == 1 else f" × {100 * fell:.0f} %"


def ablation_figure(summaries: Sequence[Summary], title: str) -> Figure:
    """Reward of the method and of its variants, one panel per motion."""
    motions = list(dict.fromkeys(s.motion for s in summaries))
    variants = list(dict.fromkeys(s.variant for s in summaries))
    variants.sort(key=bool)  # the method itself first
    found = {(s.motion, s.variant): s for s in summaries}
    figure = style.new_figure(2.6 + 2.4 * len(motions), 1.5 + 0.36 * len(variants), title)
    grid = figure.subplots(1, len(motions), sharey=True, squeeze=False)
    for axes, motion in zip(grid[0], motions, strict=True):
        for j, variant in enumerate(variants):
            if s := found.get((motion, variant)):
                _row(axes, j, s)
        if s := found.get((motion, "")):
            axes.axvline(s.mean("reward_mean") or 0.0, **_THIN)
        axes.set_xlim(0, 1)
        axes.set_xticks((0, 0.5, 1))
        axes.set_yticks(range(len(variants)), [v or f"{METHODS[ABLATED].label}, as it is" for v in variants])
        style.tidy(axes, motion, "reward", grid="x")
    grid[0, 0].invert_yaxis()
    style.legend_below(figure, more=_marks(), size=8.5)
    return figure


def _row(axes: Axes, y: float, s: Summary) -> None:
    mean, std, rough = s.mean("reward_mean"), s.std("reward_mean"), s.mean("reward_mean_perturbed")
    assert mean is not None, "every run has a reward"
    axes.barh(y, mean, 0.72, color=AFTER.color if not s.variant else "#9db8cc")
    if std is not None:
        axes.errorbar(mean, y, xerr=std, color=INK, capsize=2.5, linewidth=1.1)
    if rough is not None:
        axes.plot(rough, y, **_PERTURBED, markersize=4.5, clip_on=False)
    style.write_at(axes, f"{mean:.3f}{_falls(s)}", (1, y), (5, 0), 7.5, ha="left", va="center", annotation_clip=False)


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
    style.save(stress_figure(rows, "fell", f"What is withstood: {about}"), folder.path / SUCCESS_FIGURE)
    style.save(stress_figure(rows, "reward_mean", f"What it is worth: {about}"), folder.path / REWARD_FIGURE)


def stress_figure(rows: Sequence[dict[str, Any]], curve: str, title: str) -> Figure:
    """One panel per disturbance, one line per method: "fell", as the share without a fall, or "reward_mean" of rows."""
    names = list(dict.fromkeys(row["disturbance"] for row in rows))
    methods = [name for name in METHODS if any(row["method"] == name for row in rows)]
    columns = min(_COLUMNS, len(names))
    count = -(-len(names) // columns)
    figure = style.new_figure(max(8.5, 3.3 * columns), 0.9 + 2.35 * count, title)
    grid = figure.subplots(count, columns, sharey=True, squeeze=False)
    for axes in grid.flat[len(names) :]:
        axes.set_axis_off()
    for axes, name in zip(grid.flat, names, strict=False):
        _panel(axes, [row for row in rows if row["disturbance"] == name], methods, curve)
    for row in grid:
        row[0].set_ylabel(_CURVES[curve], fontsize=9, color=MUTED)
    style.legend_below(figure, grid[0, 0])
    return figure


def _panel(axes: Axes, rows: Sequence[dict[str, Any]], methods: Sequence[str], curve: str) -> None:
    kind = stress.swept(rows[0]["disturbance"])
    finite = [row["value"] for row in rows if math.isfinite(row["value"])]
    beyond = 1.2 * max(finite)  # where a value without bound is drawn
    for i, method in enumerate(methods):
        own = sorted((row for row in rows if row["method"] == method), key=lambda row: float(row["value"]))
        color, dash, marker = _LINES[i % len(_LINES)]
        x = [min(row["value"], beyond) for row in own]
        y = [1.0 - row[curve] if curve == "fell" else row[curve] for row in own]
        look: dict[str, Any] = {"color": color, "linestyle": dash, "linewidth": 1.7, "marker": marker, "markersize": 4}
        axes.plot(x, y, **look, label=METHODS[method].label, zorder=3)
    axes.axvline(min(kind.nominal, beyond), **_THIN, label="nominal value", zorder=1)
    if curve == "fell":
        axes.axhline(stress.SUCCESS, color="#bbbbbb", linewidth=0.8, zorder=1)
    axes.xaxis.set_major_locator(MaxNLocator(5, steps=[1, 2, 2.5, 5, 10]))
    if len(finite) < len(rows):
        ticks = [tick for tick in axes.get_xticks() if min(finite) <= tick <= max(finite)]
        axes.set_xticks([*ticks, beyond], [*(f"{tick:g}" for tick in ticks), "∞"])
    axes.set_ylim(-0.03, 1.03)
    style.tidy(axes, kind.name, kind.unit or "(–)")


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
    style.save(transfer_figure(rows), folder.path / TRANSFER_FIGURE)


def transfer_figure(rows: Sequence[dict[str, Any]]) -> Figure:
    """One panel per motion, one group of bars per method, and a panel of the paper's numbers, from the trials' rows."""
    found = transfer.transferred(rows)
    motions = list(dict.fromkeys(t.motion for t in found))
    groups = [[t for t in found if t.motion == motion] for motion in motions]
    widths = [max(1.6, len(group)) for group in groups] + [2.0]
    robot = rows[0]["robot"]
    width = max(9.5, 1.4 + 2.3 * sum(widths) / 1.6)  # that of the legend
    figure = style.new_figure(width, 4.3, f"Transfer without any change, {robot}")
    panels = figure.subplots(1, len(widths), sharey=True, width_ratios=widths, squeeze=False)[0]
    for axes, motion, group in zip(panels, motions, groups, strict=False):
        for i, t in enumerate(group):
            _transfer_bars(axes, i, t)
        axes.set_xticks(range(len(group)), [METHODS[t.method].label for t in group])
        style.tidy(axes, motion, grid="y")
    for i, (_, simulated, deviation, real, spread) in enumerate(transfer.PAPER):
        _transfer_bar(panels[-1], i - 0.2, 0.36, simulated, deviation, *_COLORS[0])
        _transfer_bar(panels[-1], i + 0.2, 0.36, real, spread, *_COLORS[3])
    panels[-1].set_xticks(range(len(transfer.PAPER)), [label for label, *_ in transfer.PAPER])
    style.tidy(panels[-1], "the paper's turn, real robot", grid="y")
    for axes in panels:
        axes.set_ylim(0, 1.05)
        axes.tick_params(axis="x", length=0)
    panels[0].set_ylabel("reward (0 to 1)", fontsize=9)
    handles = [
        Patch(facecolor=color, hatch=hatch, edgecolor="white", label=stage.label)
        for (color, hatch), stage in zip(_COLORS, transfer.stages_of(rows), strict=False)
    ]
    note = Line2D([], [], marker="$×n$", markersize=11, color=INK, linestyle="", label="n trials ended in a fall")
    style.legend_below(figure, more=[*handles, note])
    return figure


def _transfer_bars(axes: Axes, at: float, t: transfer.Transferred) -> None:
    for k, ((color, hatch), rewards, falls) in enumerate(zip(_COLORS, t.rewards, t.falls, strict=False)):
        step = 0.8 / len(t.rewards)
        x = at + step * (k - 0.5 * (len(t.rewards) - 1))
        _transfer_bar(axes, x, 0.9 * step, float(rewards.mean()), float(rewards.std()), color, hatch)
        if falls:
            axes.annotate(f"×{falls}", (x, 0.02), ha="center", fontsize=8, color="white", fontweight="bold")


def _transfer_bar(axes: Axes, x: float, width: float, mean: float, std: float, color: str, hatch: str) -> None:
    axes.bar(x, mean, width, color=color, hatch=hatch, edgecolor="white", linewidth=0, zorder=2)
    axes.errorbar(x, mean, std, color=INK, capsize=2, linewidth=1.0, zorder=3)
    style.write_at(axes, f"{mean:.2f}", (x, min(mean + std, 1.0)), (0, 2), 7)
