"""The pages of a comparison and of other experiments."""

import csv
from pathlib import Path
from typing import Any, Final

from fastmimic.base.errors import ConfigError, FastMimicError
from fastmimic.base.files import read_json
from fastmimic.experiments.ablations import ABLATED
from fastmimic.experiments.comparison_run import (
    ABLATION_FIGURE,
    ABLATION_TABLE,
    COMPARISON,
    RUNS,
    TRACKING_FIGURE,
    Row,
    finished_row,
)
from fastmimic.experiments.tables import summaries
from fastmimic.imitation.methods import method_named
from fastmimic.report import html_methods
from fastmimic.report.html_page import HtmlReport, render
from fastmimic.report.html_plots import Figure
from fastmimic.runs.work_folder import ENVIRONMENT, RESULTS_CSV, TABLE

_TEXT: Final = ("motion", "method", "variant", "robot", "config", "parameters", "digest")
_EACH: Final = (  # column of results.csv, heading, digits, scale
    ("reward", "reward", 4, 1.0),
    ("reward_perturbed", "perturbed starts", 4, 1.0),
    ("reward_before", "before", 4, 1.0),
    ("fell", "fell", 0, 1.0),
    ("fell_perturbed", "fell, perturbed, %", 0, 100.0),
    ("swing_clearance_least_share", "least clearance, %", 0, 100.0),
    ("style_distance_realised", "style, realised", 3, 1.0),
    ("foot_z_rmse_after_m", "foot z, mm", 2, 1e3),
    ("foot_x_rmse_after_m", "foot x, mm", 2, 1e3),
    ("drift_m_per_s", "drift, m/s", 3, 1.0),
    ("stance_slip_m", "slip, mm", 2, 1e3),
    ("cpu_s", "processor time, s", 1, 1.0),
    ("evaluations", "episodes", 0, 1.0),
)


def comparison_page(path: Path) -> HtmlReport:
    """The page of a comparison's folder. Raises `ConfigError` if `environment.json` or `results.csv` cannot be read, or
    Plotly is not installed."""
    about = read_json(path / ENVIRONMENT)
    missing: list[str] = []
    try:
        settings, motions = about["settings"], list(about["motions"])
        settings = {"motions": ", ".join(motions), "methods": ", ".join(about["methods"]), **settings}
    except (KeyError, TypeError) as error:
        raise ConfigError(f"{path / ENVIRONMENT}: cannot be read ({error})") from None
    rows = _rows(path, missing)
    parts = {"methods": _methods(path, [row for row in rows if not row["variant"]], missing)}
    of = {row["motion"] for row in rows if row["variant"]}
    if of or about.get("ablations"):
        own = [row for row in rows if row["motion"] in of and row["method"] == ABLATED]
        figures = [html_methods.ablations(summaries(own))] if own else []
        parts["ablations"] = _part(path, figures, [] if own else [ABLATION_FIGURE], ABLATION_TABLE, missing)
    return render(
        "comparison.html",
        [figure for part in parts.values() for figure in part["figures"]],
        title="Comparison",
        missing=missing,
        about=about,
        settings=settings,
        parts=parts,
        rows=rows,
        columns=[column for column in _EACH if any(row.get(column[0]) is not None for row in rows)],
    )


def results_page(path: Path) -> HtmlReport:
    """The page of an experiment with a table and figures, `stress` or `transfer`."""
    about, missing = read_json(path / ENVIRONMENT), []
    table = _text(path / TABLE)
    if table is None:
        missing.append(f"{path / TABLE} is missing: without the table; --resume writes it when something is done")
    pictures = sorted(path.glob("*.png"))
    if not pictures:
        missing.append(f"{path} has no figures: without them")
    title = str(about["experiment"]).capitalize()
    return render("results.html", [], title=title, missing=missing, about=about, pictures=pictures, table=table)


def _text(path: Path) -> str | None:
    try:
        return path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError):
        return None


def _methods(path: Path, rows: list[Row], missing: list[str]) -> dict[str, Any]:
    """Plots of the methods, or their picture if no run has finished, pictures of the tracking, and the table."""
    figures, pictures = [], []
    if rows:
        found = summaries(rows)
        spent = html_methods.cost(found)
        figures = [html_methods.rewards(found), html_methods.manners(found), *([] if spent is None else [spent])]
    else:
        pictures.append(COMPARISON)
    if not rows or any(method_named(row["method"]).optimises for row in rows):
        pictures.append(TRACKING_FIGURE)
    return _part(path, figures, pictures, TABLE, missing)


def _part(path: Path, figures: list[Figure], names: list[str], table: str, missing: list[str]) -> dict[str, Any]:
    """A part of the page: its plots, existing pictures, and table in Markdown."""
    there = [name for name in names if (path / name).is_file()]
    missing += [f"{path / name} is missing: without that figure" for name in names if name not in there]
    text = _text(path / table)
    if text is None:
        missing.append(f"{path / table} is missing: without that table; 'compare --resume' writes it when it is done")
    return {"figures": figures, "pictures": [path / name for name in there], "table": text or ""}


def read_rows(text: str) -> list[Row]:
    """The rows of `results.csv`: text, falls and numbers, None if empty; raises `ValueError` and `KeyError`."""
    rows: list[Row] = []
    for line in csv.DictReader(text.splitlines()):
        row: Row = {}
        for name in ("motion", "method", "variant", "seed", "reward", *line):
            value = line[name]
            if name in _TEXT or name.endswith("_version"):
                row[name] = value
            elif value in ("True", "False"):
                row[name] = value == "True"
            else:
                row[name] = float(value) if value else None
        rows.append(row)
    return rows


def _rows(path: Path, missing: list[str]) -> list[Row]:
    """Rows of the whole comparison, or of its finished part."""
    try:
        rows = read_rows((path / RESULTS_CSV).read_text(encoding="utf-8"))
        for row in rows:
            method_named(row["method"])
        return rows
    except FileNotFoundError:
        pass
    except (OSError, ValueError, KeyError, TypeError, FastMimicError) as error:
        raise ConfigError(f"{path / RESULTS_CSV}: cannot be read ({error})") from None
    runs = path / RUNS
    folders = sorted(folder for folder in runs.iterdir() if folder.is_dir()) if runs.is_dir() else []
    found = [row for row in map(finished_row, folders) if row is not None]
    kept = f"{len(found)} finished runs are shown" if found else "without plots"
    missing.append(f"{path / RESULTS_CSV} is missing, as in a comparison that is not finished: {kept}")
    return found
