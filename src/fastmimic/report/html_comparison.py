"""The pages of a comparison, with the plots of its methods and ablations, and of other experiments."""

import csv
import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import msgspec
import numpy as np

from fastmimic.base.errors import ConfigError, FastMimicError
from fastmimic.base.files import packaged, read_json
from fastmimic.experiments import comparison_run as compared
from fastmimic.experiments.ablations import ABLATED
from fastmimic.experiments.comparison_run import Row, finished_rows
from fastmimic.experiments.measurement import Summary, summaries
from fastmimic.imitation.methods import METHODS, method_named
from fastmimic.report import html_page as draw
from fastmimic.report.html_page import Figure, HtmlReport, Key, Plot, numbers, render
from fastmimic.runs.work_folder import ENVIRONMENT, RESULTS_CSV, TABLE

_TEXT: Final = ("motion", "method", "variant", "robot", "config", "parameters", "digest")
_BAR: Final = 0.84  # share of a group's width taken by bars
_ALIKE: Final = 0.005  # rewards closer than this are called alike
_SEED: Final = Key("each seed", "var(--ink)", symbol="circle-open")
_ROUGH: Final = Key("from perturbed starts", "var(--ink)", symbol="circle-open")
_WHOLE: Final = Key(f"{method_named(ABLATED).label} unchanged", "var(--muted)", "dash")
_BEFORE: Final = Key("before the optimisation", "var(--ink)")
_NOMINAL: Final = Key("nominal, mean ± std over the seeds", "var(--after)", symbol="diamond")
_INK_BARS: Final = {"color": "var(--ink)", "thickness": 1.2, "width": 3}


class Measure(msgspec.Struct, frozen=True):
    column: str
    title: str
    unit: str  # of the axis
    scale: float = 1.0  # from the column's unit to the axis'
    top: float | None = None  # of the axis; None for automatic
    before: str = ""  # the same column before optimisation


_MEASURES: Final = packaged("fastmimic.report", "measures.json", dict[str, tuple[Measure, ...]])


def comparison_page(path: Path) -> HtmlReport:
    """The page of a comparison's folder; raises `ConfigError` if its files cannot be read, or without Plotly."""
    about = read_json(path / ENVIRONMENT)
    missing: list[str] = []
    try:
        settings, motions = about["settings"], list(about["motions"])
        settings = {"motions": ", ".join(motions), "methods": ", ".join(about["methods"]), **settings}
    except (KeyError, TypeError) as error:
        raise ConfigError(f"{path / ENVIRONMENT}: cannot be read ({error})") from None
    rows = _rows(path, missing)
    parts = {"methods": _methods_part(path, [row for row in rows if not row["variant"]], missing)}
    of = {row["motion"] for row in rows if row["variant"]}
    if of or about.get("ablations"):
        own = [row for row in rows if row["motion"] in of and row["method"] == ABLATED]
        figures, pictures = ([ablations(summaries(own))], []) if own else ([], [compared.ABLATION_FIGURE])
        parts["ablations"] = _part(path, figures, pictures, compared.ABLATION_TABLE, missing)
    sections = {name: part["figures"] for name, part in parts.items()}
    shown: dict[str, Any] = {"about": about, "settings": settings, "parts": parts, "rows": rows}
    return render("comparison.html", sections, title="Comparison", missing=missing, **shown)


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
    return render("results.html", {}, title=title, missing=missing, about=about, pictures=pictures, table=table)


def _text(path: Path) -> str | None:
    try:
        return path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError):
        return None


def _methods_part(path: Path, rows: list[Row], missing: list[str]) -> dict[str, Any]:
    """Plots of the methods, or their picture if no run has finished, pictures of the tracking, and the table."""
    figures, pictures = [], []
    if rows:
        found = summaries(rows)
        figures = [rewards(found), manners(found), *cost(found)]
    else:
        pictures.append(compared.COMPARISON)
    if not rows or any(method_named(row["method"]).optimises for row in rows):
        pictures.append(compared.TRACKING_FIGURE)
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
    """The rows of `results.csv`: text and numbers, None if empty or not finite; raises `ValueError` and `KeyError`."""
    rows: list[Row] = []
    for line in csv.DictReader(text.splitlines()):
        row: Row = {}
        if None in line:
            raise ValueError(f"a line has more than the {len(line) - 1} cells of the header")
        for name in ("motion", "method", "variant", "seed", "reward_mean", *line):
            value = line[name]
            if name in _TEXT or name.endswith("_version"):
                row[name] = value
            else:
                found = float(value or "nan")
                row[name] = found if math.isfinite(found) else None
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
    found = list(finished_rows(path).values())
    kept = f"{len(found)} finished runs are shown" if found else "without plots"
    missing.append(f"{path / RESULTS_CSV} is missing, as in a comparison that is not finished: {kept}")
    return found


def rewards(found: Sequence[Summary]) -> Figure:
    """Reward of every method on every motion, nominal and from perturbed starts; without variants."""
    means = {method_named(m).label: _over_motions(found, m) for m in _methods(found)}
    best = max(means.values())
    leading = [label for label, mean in means.items() if mean > best - _ALIKE]
    title = "Reward of each method on each motion"
    if len(means) > 1 and len(leading) == 1:
        title += f": {leading[0]} is best, {best:.3f} on average"
    elif len(leading) > 1:
        title += f": {', '.join(leading[:-1])} and {leading[-1]} are within {_ALIKE:g}, {best:.3f} on average at best"
    plots = [_bars(found, measure) for measure in _MEASURES["rewards"]]
    return Figure("rewards", title, plots, 1, (*map(_key, _methods(found)), _SEED))


def manners(found: Sequence[Summary]) -> Figure:
    """Similarity to the animal's motion, and tracking; without variants."""
    title = "Style and tracking: a reward that is got by shuffling shows here"
    plots = [_bars(found, measure, height=270) for measure in _MEASURES["manners"]]
    return Figure("manners", title, plots, 2, (*map(_key, _methods(found)), _SEED, _BEFORE))


def cost(found: Sequence[Summary]) -> list[Figure]:
    """Reward against processor time, without variants; none if no run has one."""
    data = []
    for name in _methods(found):
        rows = [row for s in found if s.method == name for row in s.rows if row.get("cpu_s")]
        if rows:
            x, y = numbers([row["cpu_s"] for row in rows]), numbers([row["reward_mean"] for row in rows], 17)
            trace = draw.points(x, y, _key(name), "%{text}: reward %{y:.3f}, %{x:.3g} s")
            trace["marker"]["line"] = {"width": 1, "color": "var(--paper)"}
            data.append({**trace, "text": [f"{row['motion']}, seed {row['seed']:g}" for row in rows]})
    if not data:
        return []
    layout = draw.layout_of("processor time (s)", "reward (0 to 1)", 330, hovermode="closest")
    layout["xaxis"]["type"] = "log"
    title = "What a reward costs: the processor time of each run, optimisation and evaluation"
    legend = [replace(_key(name), pattern=None) for name in _methods(found)]
    return [Figure("cost", title, [Plot("", data, layout)], 1, legend)]


def ablations(found: Sequence[Summary]) -> Figure:
    """Reward of the method and of its variants, one panel per motion."""
    variants = sorted(dict.fromkeys(s.variant for s in found), key=bool)
    losses = {v: _change(found, v) for v in variants if v}
    there = {v: loss for v, loss in losses.items() if loss is not None}
    title = "Ablations"
    if there:
        worst = min(there, key=lambda v: there[v])
        title = f"What the parts contribute: most is lost by {worst}, {there[worst]:+.3f} of reward on average"
    plots = []
    for motion in dict.fromkeys(s.motion for s in found):
        own = [s for s in found if s.motion == motion]
        names = [s.variant or ABLATED for s in own]
        data = []
        for column, key, hover, size in (
            ("reward_mean", _NOMINAL, "reward", 10),
            ("reward_mean_perturbed", _ROUGH, "perturbed starts", 8),
        ):
            means = numbers([np.nan if (mean := s.mean(column)) is None else mean for s in own], 17)
            data.append(draw.points(means, names, key, f"%{{y}}: {hover} %{{x:.3f}}<extra></extra>", size=size))
        stds = numbers([s.std("reward_mean") or 0.0 for s in own])
        data[0]["error_x"] = {"type": "data", "array": stds, **_INK_BARS}
        layout = draw.layout_of("reward", "", 90 + 24 * len(variants), hovermode="closest")
        layout["yaxis"] |= draw.rows_axis([v or ABLATED for v in variants])
        whole = next((s.mean("reward_mean") for s in own if not s.variant), None)
        if whole is not None:
            layout["shapes"] = [draw.rule(_WHOLE, x=whole, width=1.2)]
        plots.append(Plot(motion, data, layout))
    return Figure("ablation", title, plots, 2, (_NOMINAL, _ROUGH, _WHOLE), told={"method": method_named(ABLATED).label})


def _bars(found: Sequence[Summary], measure: Measure, height: int = 330) -> Plot:
    motions, methods = list(dict.fromkeys(s.motion for s in found)), _methods(found)
    width = _BAR / len(methods)
    data: list[dict[str, Any]] = []
    dots: tuple[list[float], list[float], list[str]] = ([], [], [])
    before: list[dict[str, Any]] = []
    for j, name in enumerate(methods):
        own = [s for s in found if s.method == name and s.mean(measure.column) is not None]
        at = [motions.index(s.motion) - _BAR / 2 + (j + 0.5) * width for s in own]
        means = [measure.scale * float(s.mean(measure.column) or 0.0) for s in own]
        stds = [measure.scale * float(s.std(measure.column) or 0.0) for s in own]
        label = method_named(name).label
        data.append(
            {
                "type": "bar",
                "name": label,
                "x": numbers(at),
                "y": numbers(means, 17),
                "width": numbers([0.9 * width] * len(own)),
                "customdata": [[s.motion, std] for s, std in zip(own, numbers(stds), strict=True)],
                "marker": draw.bar_marker(_key(name), fgopacity=0.7, size=7, solidity=0.25),
                "error_y": {"type": "data", "array": numbers(stds), "visible": any(stds), **_INK_BARS},
                "hovertemplate": f"{label} on %{{customdata[0]}}: %{{y:.4g}} ± %{{customdata[1]:.2g}}<extra></extra>",
            }
        )
        for s, x in zip(own, at, strict=True):
            values = s.values(measure.column)
            if len(values) > 1:
                dots[0].extend([x] * len(values))
                dots[1].extend(measure.scale * v for v in values)
                dots[2].extend(f"{label} on {s.motion}, seed {row['seed']:g}" for row in s.rows)
            was = s.mean(measure.before) if measure.before and method_named(name).optimises else None
            if was is not None:
                y = measure.scale * was
                ends = {"xref": "x", "yref": "y", "x0": x - 0.45 * width, "x1": x + 0.45 * width, "y0": y, "y1": y}
                before.append({"type": "line", **ends, "line": {"color": "var(--ink)", "width": 2}})
    seeds = draw.points(numbers(dots[0]), numbers(dots[1], 17), _SEED, "%{text}: %{y:.4g}<extra></extra>", size=5)
    data.append({**seeds, "text": dots[2]})
    layout = draw.layout_of("motion", measure.unit, height, hovermode="closest", barmode="overlay", shapes=before)
    layout["xaxis"] |= {"tickmode": "array", "tickvals": list(range(len(motions))), "ticktext": motions}
    layout["xaxis"] |= {"range": [-0.55, len(motions) - 0.45], "showgrid": False}
    layout["yaxis"] |= {"rangemode": "tozero"} if measure.top is None else {"range": [0, measure.top]}
    return Plot(measure.title, data, layout)


def _key(method: str) -> Key:
    known = METHODS[method]
    return Key(known.label, f"var(--method-{method})", symbol=known.symbol, pattern=known.hatch[:1])


def _methods(found: Sequence[Summary]) -> list[str]:
    return [name for name in METHODS if any(s.method == name for s in found)]


def _over_motions(found: Sequence[Summary], method: str) -> float:
    """Mean over the motions of a method's mean rewards; −1 without any."""
    values = [mean for s in found if s.method == method and (mean := s.mean("reward_mean")) is not None]
    return float(np.mean(values)) if values else -1.0


def _change(found: Sequence[Summary], variant: str) -> float | None:
    """Change of the reward against the unchanged method, mean over the motions that have both."""
    whole = {s.motion: s.mean("reward_mean") for s in found if not s.variant}
    changes = [
        float(s.mean("reward_mean") or 0.0) - float(whole[s.motion] or 0.0)
        for s in found
        if s.variant == variant and whole.get(s.motion) is not None
    ]
    return float(np.mean(changes)) if changes else None
