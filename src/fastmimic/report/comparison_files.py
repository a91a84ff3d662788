"""The tables and figures that `fastmimic compare` writes."""

from collections.abc import Sequence
from typing import Final

import numpy as np

from fastmimic.base.errors import OutputError
from fastmimic.base.files import remove_file
from fastmimic.experiments.ablations import ABLATED
from fastmimic.experiments.compare import ComparisonPlan
from fastmimic.experiments.comparison_folder import (
    ABLATION_FIGURE,
    ABLATION_TABLE,
    COMPARISON,
    RUNS,
    TRACKING_FIGURE,
    WRITTEN,
    ComparisonFolder,
)
from fastmimic.experiments.comparison_run import TRACKING, Row, Run, run_of
from fastmimic.experiments.tables import ablation_table, comparison_table, summaries, to_csv
from fastmimic.imitation.methods import method_named
from fastmimic.render.figure_style import save
from fastmimic.report.comparison_figures import ablation_figure, comparison_figure, tracking_bars
from fastmimic.runs.work_folder import RESULTS_CSV, TABLE

SHOWN: Final = "dog:pace"  # the tracking figure's motion, as in the paper; else the first one compared


def write_comparison(
    folder: ComparisonFolder, plan: ComparisonPlan, rows: Sequence[Row], kept: Sequence[Row] = ()
) -> None:
    """Writes the tables and figures of all rows, replacing earlier ones; says so if runs are missing. `kept` are rows
    of the folder's other finished runs. Raises `OutputError`."""
    missing = {*plan.runs} - {run_of(row) for row in rows}
    found = folder.in_order([*kept, *rows])
    written = [RESULTS_CSV]
    folder.write(RESULTS_CSV, to_csv(found))
    whole = [row for row in found if not row["variant"]]
    if whole:
        written += _write_comparison(folder, whole, len(whole) + sum(not run.variant for run in missing))
    of = {row["motion"] for row in found if row["variant"]} | {*(plan.motions if plan.ablations else ())}
    own = [row for row in found if row["method"] == ABLATED and row["motion"] in of]
    if own:
        left = sum(run.method == ABLATED and run.motion in of for run in missing)
        written += _write_ablations(folder, own, len(own) + left)
    for name in WRITTEN:
        if name not in written:
            remove_file(folder.path / name)


def _write_comparison(folder: ComparisonFolder, rows: Sequence[Row], expected: int) -> list[str]:

    folder.write(TABLE, comparison_table(rows, expected))
    found = summaries(rows)
    save(comparison_figure(found, f"Reward by method, {rows[0]['robot']}"), folder.path / COMPARISON)
    return [TABLE, COMPARISON, *_write_tracking(folder, rows)]


def _write_tracking(folder: ComparisonFolder, rows: Sequence[Row]) -> list[str]:
    """Of the paper's method, or else the first optimising one; nothing without one."""

    methods = [row["method"] for row in rows if method_named(row["method"]).optimises]
    if not methods:
        return []
    method = ABLATED if ABLATED in methods else methods[0]
    own = [row for row in rows if row["method"] == method]
    row = next((row for row in own if row["motion"] == SHOWN), own[0])
    run = Run(row["motion"], method, "", row["seed"])
    try:
        with np.load(folder.path / RUNS / run.folder / TRACKING, allow_pickle=False) as file:
            courses = {name: file[name] for name in ("demonstration", "before", "after")}
            rate_hz, start_s = float(file["rate_hz"]), float(file["start_s"])
    except (OSError, ValueError, KeyError) as error:
        raise OutputError(
            f"{folder.path / RUNS / run.folder / TRACKING}: cannot be read ({error}); remove that folder, and"
            " --resume makes it anew"
        ) from None
    title = f"Tracking before and after {method_named(method).label}, {row['robot']} (course: {run.motion})"
    save(tracking_bars(summaries(own), courses, rate_hz, start_s, title), folder.path / TRACKING_FIGURE)
    return [TRACKING_FIGURE]


def _write_ablations(folder: ComparisonFolder, rows: Sequence[Row], expected: int) -> list[str]:

    folder.write(ABLATION_TABLE, ablation_table(rows, expected))
    title = f"What the parts of {method_named(ABLATED).label} are worth, {rows[0]['robot']}"
    save(ablation_figure(summaries(rows), title), folder.path / ABLATION_FIGURE)
    return [ABLATION_TABLE, ABLATION_FIGURE]
