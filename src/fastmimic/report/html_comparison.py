"""The page of a comparison: its plots, its tables, and what it was made with."""

import csv
import json
import re
from html import escape
from pathlib import Path
from typing import Any, Final

from fastmimic.base.errors import ConfigError, FastMimicError
from fastmimic.experiments.ablations import ABLATED
from fastmimic.experiments.compare import RUNS
from fastmimic.experiments.comparison_run import Row, finished_row
from fastmimic.experiments.tables import summaries
from fastmimic.imitation.methods import method_named
from fastmimic.report import html_methods
from fastmimic.report.comparison_folder import (
    ABLATION_FIGURE,
    ABLATION_TABLE,
    COMPARISON,
    ENVIRONMENT,
    RESULTS_CSV,
    TABLE,
    TRACKING_FIGURE,
)
from fastmimic.report.html_parts import NONE, Page, embedded, pairs, plotly_bundle, table

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
    ABLATION_FIGURE: "What each part of the method is worth.",
}


def comparison_page(path: Path) -> tuple[Page, tuple[str, ...]]:
    """The page of a comparison's folder, and a sentence for each thing that the folder lacks.

    Raises:
        ConfigError: `environment.json` or `results.csv` cannot be read.
    """
    try:
        environment = json.loads((path / ENVIRONMENT).read_text(encoding="utf-8"))
        settings = environment["settings"]
        methods, motions = list(environment["methods"]), list(environment["motions"])
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise ConfigError(f"{path / ENVIRONMENT}: cannot be read ({error})") from None
    missing: list[str] = []
    rows = _rows(path, missing)
    plotted = bool(rows)
    try:
        plotly_bundle()
    except ConfigError as error:
        missing.append(f"{error}: with pictures in place of the plots")
        plotted = False
    page = Page("Comparison: FastMimic report")
    page.add(
        "<h1>Comparison</h1>",
        f'<p class="lead">{len(methods)} methods on {len(motions)} motions; {escape(str(settings.get("robot")))},'
        f" {escape(str(settings.get('config')))} controller, {environment.get('seeds')} seed(s) where something is"
        " optimised.</p>",
    )
    at = len(page.body)
    page.add('<p class="hint screen">The heading of a column sorts its table.</p>')
    whole = [row for row in rows if not row["variant"]]
    page.section("methods", "Methods")
    if plotted and whole:
        found = summaries(whole)
        page.figure(html_methods.rewards(found))
        page.figure(html_methods.manners(found))
        spent = html_methods.cost(found)
        if spent is not None:
            page.figure(spent)
    else:
        _picture(page, path / COMPARISON, missing)
    if not whole or any(method_named(row["method"]).optimises for row in whole):
        _picture(page, path / TRACKING_FIGURE, missing)
    _text(page, path / TABLE, missing)
    of = {row["motion"] for row in rows if row["variant"]}
    if of or environment.get("ablations"):
        page.section("ablations", "Ablations")
        own = [row for row in rows if row["motion"] in of and row["method"] == ABLATED]
        if plotted and own:
            page.figure(html_methods.ablations(summaries(own)))
        else:
            _picture(page, path / ABLATION_FIGURE, missing)
        _text(page, path / ABLATION_TABLE, missing)
    if rows:
        page.section("runs", "Every run")
        page.add(f"<details><summary>{len(rows)} runs with their figures</summary>", _each(rows), "</details>")
    page.section("run", "What was run")
    said: dict[str, Any] = {"motions": ", ".join(motions), "methods": ", ".join(methods), **settings}
    page.add(
        f'<div class="two"><div><h3>Settings</h3>{pairs(said)}</div><div><h3>Machine</h3>'
        f"{pairs(environment.get('machine', {}))}<h3 class='next'>Versions</h3>"
        f"{pairs(environment.get('versions', {}))}</div></div>"
    )
    if missing:
        notes = "".join(f"<li>{escape(m)}</li>" for m in missing)
        page.body.insert(at, f'<div class="notes" id="notes"><ul>{notes}</ul></div>')
    return page, tuple(missing)


def read_rows(text: str) -> list[Row]:
    """The rows of `results.csv`: text, whether it fell, and numbers; None for what is empty.

    Raises:
        ValueError: a number cannot be read.
        KeyError: a column is missing.
    """
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
    """Of the whole comparison, or of what is finished of it."""
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


def _picture(page: Page, file: Path, missing: list[str]) -> None:
    what = _PICTURES[file.name]
    try:
        source = embedded(file, "image/png")
    except OSError:
        missing.append(f"{file} is missing: without that figure")
        return
    page.add(f'<figure><img alt="{escape(what)}" src="{source}">')
    page.add(f'<figcaption><p class="hint">{escape(what)}</p></figcaption></figure>')


def _text(page: Page, file: Path, missing: list[str]) -> None:
    try:
        page.add(markdown(file.read_text(encoding="utf-8")))
    except (OSError, UnicodeDecodeError):
        missing.append(f"{file} is missing: without that table; 'compare --resume' writes it when it is done")


def _each(rows: list[Row]) -> str:
    """A line a run, with the values of `results.csv` as data."""
    columns = [column for column in _EACH if any(row.get(column[0]) is not None for row in rows)]
    variants = any(row["variant"] for row in rows)
    header = ["motion", "method", *(["variant"] if variants else []), "seed", *(name for _, name, _, _ in columns)]
    body = []
    for row in rows:
        cells = [f"<code>{escape(row['motion'])}</code>", escape(method_named(row["method"]).label)]
        cells += [escape(row["variant"])] if variants else []
        cells.append(f'<td class="n">{row["seed"]:g}</td>')
        for key, _, digits, scale in columns:
            value = row.get(key)
            if isinstance(value, bool):
                cells.append(f'<td class="n" data-value="{int(value)}">{"yes" if value else "no"}</td>')
            elif value is None:
                cells.append(f'<td class="n">{NONE}</td>')
            else:
                cells.append(f'<td class="n" data-value="{value!r}">{scale * value:.{digits}f}</td>')
        body.append(cells)
    lines = table(header, body, left=3 if variants else 2, sortable=True)
    return f'<div class="dense" id="each">{lines}</div>'


def markdown(text: str) -> str:
    """HTML of the Markdown that a comparison's tables are written in: tables, lists, paragraphs, `code`, **bold** and
    *italics*. The tables can be sorted."""
    html = []
    for block in re.split(r"\n\s*\n", text.strip()):
        lines = block.splitlines()
        if lines[0].startswith("|"):
            rows = [[_inline(cell.strip()) for cell in line.strip("| ").split(" | ")] for line in lines]
            html.append('<div class="dense">')
            html.append(table([cell for cell in lines[0].strip("| ").split(" | ")], rows[2:], left=2, sortable=True))
            html.append("</div>")
        elif lines[0].startswith("- "):
            html.append(f"<ul>{''.join(f'<li>{_inline(line[2:])}</li>' for line in lines)}</ul>")
        else:
            html.append(f"<p>{_inline(' '.join(lines))}</p>")
    return "\n".join(html)


def _inline(text: str) -> str:
    text = escape(text)
    text = re.sub(r"`([^`]+)`", r"<code>\1</code>", text)
    text = re.sub(r"\*\*([^*]+)\*\*", r"<strong>\1</strong>", text)
    return re.sub(r"\*([^*]+)\*", r"<em>\1</em>", text)
