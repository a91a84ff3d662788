"""The page of a comparison."""

import csv
from pathlib import Path
from typing import Any, Final

from markupsafe import Markup

from fastmimic.base.errors import ConfigError, FastMimicError
from fastmimic.base.files import read_json
from fastmimic.base.text import NONE
from fastmimic.experiments.ablations import ABLATED
from fastmimic.experiments.comparison_folder import ABLATION_FIGURE, ABLATION_TABLE, COMPARISON, RUNS, TRACKING_FIGURE
from fastmimic.experiments.comparison_run import Row, finished_row
from fastmimic.experiments.tables import summaries
from fastmimic.imitation.methods import method_named
from fastmimic.report import html_methods
from fastmimic.report.html_page import render
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
_PICTURES: Final = {
    COMPARISON: "Reward of each method on each motion.",
    TRACKING_FIGURE: "A foot before and after optimisation, and the errors of all feet.",
    ABLATION_FIGURE: "What each part of the method contributes.",
}


def comparison_page(path: Path) -> tuple[str, tuple[str, ...]]:
    """The page of a comparison's folder, and a sentence for each thing missing in it. Raises `ConfigError` if
    `environment.json` or `results.csv` cannot be read, or Plotly is not installed."""
    environment = read_json(path / ENVIRONMENT)
    try:
        settings = environment["settings"]
        methods, motions = list(environment["methods"]), list(environment["motions"])
    except (KeyError, TypeError) as error:
        raise ConfigError(f"{path / ENVIRONMENT}: cannot be read ({error})") from None
    missing: list[str] = []
    rows = _rows(path, missing)
    whole = [row for row in rows if not row["variant"]]
    parts: dict[str, Any] = {"methods": _methods(path, whole, missing), "ablations": None}
    of = {row["motion"] for row in rows if row["variant"]}
    if of or environment.get("ablations"):
        own = [row for row in rows if row["motion"] in of and row["method"] == ABLATED]
        parts["ablations"] = _ablations(path, own, missing)
    columns, lines, left = _each(rows)
    page = render(
        "comparison.html",
        [figure for part in parts.values() if part for figure in part["figures"]],
        title="Comparison",
        lead=f"{len(methods)} methods on {len(motions)} motions; {settings.get('robot')}, {settings.get('config')}"
        f" controller, {environment.get('seeds')} seed(s) where something is optimised.",
        missing=missing,
        columns=columns,
        rows=lines,
        left=left,
        settings={"motions": ", ".join(motions), "methods": ", ".join(methods), **settings},
        machine=environment.get("machine", {}),
        versions=environment.get("versions", {}),
        **parts,
    )
    return page, tuple(missing)


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


def _ablations(path: Path, rows: list[Row], missing: list[str]) -> dict[str, Any]:
    figures = [html_methods.ablations(summaries(rows))] if rows else []
    return _part(path, figures, [] if rows else [ABLATION_FIGURE], ABLATION_TABLE, missing)


def _part(path: Path, figures: list[Figure], names: list[str], table: str, missing: list[str]) -> dict[str, Any]:
    """A part of the page: its plots, existing pictures, and table in Markdown."""
    there = [name for name in names if (path / name).is_file()]
    missing += [f"{path / name} is missing: without that figure" for name in names if name not in there]
    pictures = [(path / name, _PICTURES[name]) for name in there]
    try:
        text = (path / table).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError):
        text = ""
        missing.append(f"{path / table} is missing: without that table; 'compare --resume' writes it when it is done")
    return {"figures": figures, "pictures": pictures, "table": text}


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


def _each(rows: list[Row]) -> tuple[list[str], list[list[Any]], int]:
    """A line per run with exact values as data: headings, cells, and the number of text columns."""
    columns = [column for column in _EACH if any(row.get(column[0]) is not None for row in rows)]
    texts = ["motion", "method", *(["variant"] if any(row["variant"] for row in rows) else [])]
    lines = []
    for row in rows:
        cells: list[Any] = [Markup("<code>{}</code>").format(row["motion"]), method_named(row["method"]).label]
        cells += [row[name] for name in texts[2:]]
        cells.append(f"{row['seed']:g}")
        for key, _, digits, scale in columns:
            value = row.get(key)
            if value is None:
                cells.append(NONE)
            elif isinstance(value, bool):
                cells.append({"value": int(value), "text": "yes" if value else "no"})
            else:
                cells.append({"value": repr(value), "text": f"{scale * value:.{digits}f}"})
        lines.append(cells)
    return [*texts, "seed", *(name for _, name, _, _ in columns)], lines, len(texts)
