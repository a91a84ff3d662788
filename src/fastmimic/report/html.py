"""The report of a run or a comparison: one HTML file that holds all it shows and loads nothing."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Any, Final

from fastmimic.conventions import LEGS
from fastmimic.errors import ConfigError, OutputError
from fastmimic.files import replace_file
from fastmimic.methods import METHODS
from fastmimic.report import html_plots as plots
from fastmimic.report.comparison_folder import ENVIRONMENT
from fastmimic.report.html_parts import NONE, Page, embedded, pairs, plotly_bundle, table
from fastmimic.report.html_run import RunData, read_run
from fastmimic.report.run_folder import CONFIG, METRICS

REPORT: Final = "report.html"


@dataclass(frozen=True)
class Report:
    """What was made.

    Attributes:
        html: the whole page.
        missing: a sentence for each thing that the folder lacks: what the page goes without.
    """

    html: str
    missing: tuple[str, ...]

    def save(self, path: str | Path) -> None:
        """Writes the page in place of an earlier one; raises `OutputError`."""
        replace_file(path, lambda file: file.write(self.html.encode()))


def kind_of(folder: str | Path) -> str:
    """What a folder holds: "run" for one of `imitate` or `stitch`, "comparison" for one of `compare`.

    Raises:
        ConfigError: neither.
    """
    path = Path(folder)
    if (path / METRICS).is_file():
        return "run"
    if (path / ENVIRONMENT).is_file():
        return "comparison"
    if not path.is_dir():
        raise ConfigError(f"{path}: {'not a folder' if path.exists() else 'no such folder'}; give the folder of a run")
    if (path / CONFIG).is_file():
        raise ConfigError(f"{path}: the run is not finished ({METRICS} is missing); 'imitate --resume' may finish it")
    raise ConfigError(
        f"{path}: not the folder of a run: neither {METRICS} of imitate and stitch nor {ENVIRONMENT} of compare"
    )


def make_report(folder: str | Path) -> Report:
    """Makes the page of a folder. A run's two episodes are run again for it.

    Args:
        folder: of a run of `imitate` or `stitch`, or of a comparison.

    Raises:
        ConfigError: not such a folder, its figures cannot be read, or Plotly is not installed.
    """
    if kind_of(folder) == "comparison":
        from fastmimic.report.html_comparison import comparison_page

        page, missing = comparison_page(Path(folder))
        return Report(page.html(), missing)
    plotly_bundle()  # before the episodes: without it there is no page
    run = read_run(Path(folder))
    return Report(run_page(run).html(), run.missing)


def run_page(run: RunData) -> Page:
    """The page of a run."""
    m = run.metrics
    page = Page(f"{m['motion']} on {m['robot']}: FastMimic report")
    page.add(f"<h1>{escape(m['motion'])} on {escape(m['robot'])}</h1>", f'<p class="lead">{_summary(run)}</p>')
    page.add(_notes(run), _tiles(run), _contents(run))
    if run.video is not None:
        page.section("video", "Video")
        try:
            source = embedded(run.video, "video/mp4")
        except OSError as error:
            raise OutputError(f"{run.video}: cannot be read ({error.strerror or error})") from None
        page.add(
            f'<video controls loop muted playsinline src="{source}"></video>'
            '<p class="hint">The green ghost is the demonstration.</p>'
        )
    page.section("figures", "In numbers")
    page.add(_comparison(run))
    page.add(_segments(m))
    if m["parameters"]:
        page.section("optimisation", "Optimisation")
        if run.course is not None:
            page.figure(plots.convergence(run.course, m["reward"]["before"], m["reward"]["after"]))
        page.figure(plots.parameters(m["parameters"]))
        page.add("<details><summary>Table of the parameters</summary>", _parameters(m), "</details>")
    e = run.episodes
    if e is not None:
        page.section("tracking", "Feet and gait")
        for figure in plots.feet(e):
            page.figure(figure)
        page.figure(plots.gait(e))
        page.section("terms", "Reward")
        page.figure(plots.reward(e))
        page.section("limits", "Limits of the robot")
        for figure in plots.limits(e):
            page.figure(figure)
        page.figure(plots.friction(e))
        solved = plots.solve_times(e)
        if solved is not None:
            page.section("times", "Solve times")
            page.figure(solved)
    page.section("run", "What was run")
    page.add(_provenance(run))
    return page


def _summary(run: RunData) -> str:
    m = run.metrics
    method = METHODS.get(m.get("method", ""))
    name = f"{method.label}, {method.summary}" if method is not None else str(m.get("method", "unknown method"))
    parts = [escape(name), f"{escape(str(m.get('config', '')))} controller", f"episodes of {m['duration_s']:g} s"]
    if m.get("iterations"):
        parts.append(f"{m['iterations']} iterations, seed {m.get('seed')}")
    return "; ".join(parts) + (". The search was interrupted." if m.get("interrupted") else ".")


def _notes(run: RunData) -> str:
    lines = [escape(line) for line in run.missing]
    e = run.episodes
    if e is not None and e.differences:
        lines += [escape(line) for line in e.differences]
        lines.append(
            "The plots of the episodes are those of the episodes run again; the figures are the recorded ones."
        )
    found = ""
    if e is not None and not e.differences:
        both = "Both nominal episodes were" if e.after is not None else "The nominal episode was"
        found = (
            f'<div class="notes good" id="verified"><p>{both} run again for this page; the'
            f" reward{'s are' if e.after is not None else ' is'} to the last bit that of <code>{METRICS}</code>.</p>"
            "</div>"
        )
    if lines:
        found += f'<div class="notes" id="notes"><ul>{"".join(f"<li>{line}</li>" for line in lines)}</ul></div>'
    return found


def _contents(run: RunData) -> str:
    entries = {
        "video": ("Video", run.video is not None),
        "figures": ("In numbers", True),
        "optimisation": ("Optimisation", run.optimised),
        "tracking": ("Feet and gait", run.episodes is not None),
        "terms": ("Reward", run.episodes is not None),
        "limits": ("Limits", run.episodes is not None),
        "run": ("What was run", True),
    }
    return f"<nav>{''.join(f'<a href=#{k}>{text}</a>' for k, (text, there) in entries.items() if there)}</nav>"


def _value(metrics: Mapping[str, Any], key: str) -> Any:
    """By its path, such as `reward.before` or `swing_clearance_m.after.2`; None if it is not there."""
    found: Any = metrics
    for name in key.split("."):
        if isinstance(found, list):
            found = found[int(name)] if int(name) < len(found) else None
        else:
            found = found.get(name) if isinstance(found, dict) else None
    return found


def _number(metrics: Mapping[str, Any], key: str, digits: int, scale: float = 1.0) -> str:
    """A figure of `metrics.json`, with its exact value as data."""
    value = _value(metrics, key)
    if value is None:
        return NONE
    shown = ("yes" if value else "no") if isinstance(value, bool) else f"{scale * value:.{digits}f}"
    return f'<data data-metric="{key}" value="{value!r}">{shown}</data>'


def _tiles(run: RunData) -> str:
    m = run.metrics
    now = "after" if run.optimised else "before"
    rows = (
        ("Reward", "reward", 3, 1.0, ""),
        ("Fell", "fell", 0, 1.0, ""),
        ("Drift", "drift_m_per_s", 3, 1.0, "m/s"),
        ("Foot height error", "foot_z_rmse_m", 1, 1e3, "mm"),
        ("Fore-aft error", "foot_x_rmse_m", 1, 1e3, "mm"),
    )
    tiles = []
    for label, key, digits, scale, unit in rows:
        was = f"before {_number(m, f'{key}.before', digits, scale)}" if run.optimised else "not optimised"
        was = f"RMS, {was}" if "rmse" in key else was
        unit = f" <small>{unit}</small>" if unit else ""
        value = _number(m, f"{key}.{now}", digits, scale)
        tiles.append(f'<div class="tile"><dt>{label}</dt><dd>{value}{unit}<span class="was">{was}</span></dd></div>')
    share, was = _least_share(m, now), _least_share(m, "before")
    before = f"before {was}" if run.optimised else "not optimised"
    tiles.insert(
        2, f'<div class="tile"><dt>Swing clearance</dt><dd>{share}<span class="was">{before}</span></dd></div>'
    )
    return f'<dl class="tiles">{"".join(tiles)}</dl>'


def _least_share(m: Mapping[str, Any], when: str) -> str:
    """The smallest share of the demonstration's swing clearance among the legs that swing."""
    wanted, got = _value(m, "swing_clearance_m.demonstration"), _value(m, f"swing_clearance_m.{when}")
    shares = [g / w for g, w in zip(got or [], wanted or [], strict=False) if g is not None and w]
    return f"{100 * min(shares):.0f} <small>%</small>" if shares else NONE


def _comparison(run: RunData) -> str:
    m = run.metrics
    columns = ("before", "after") if run.optimised else ("before",)
    rows: list[list[str]] = []

    def row(label: str, keys: list[str], digits: int, scale: float = 1.0, sub: bool = False) -> None:
        head = f"<th>{escape(label)}</th>"
        rows.append([head, *(_number(m, key, digits, scale) for key in keys)])
        if sub:
            rows[-1][0] = f'<th style="padding-left:18px">{escape(label)}</th>'

    row("reward", [f"reward.{c}" for c in columns], 4)
    for term in _value(m, "reward.components_before") or {}:
        row(term.replace("_", " "), [f"reward.components_{c}.{term}" for c in columns], 4, sub=True)
    split = len(rows)
    row("fell", [f"fell.{c}" for c in columns], 0)
    row("drift, m/s", [f"drift_m_per_s.{c}" for c in columns], 3)
    for i, leg in enumerate(LEGS):
        wanted = _number(m, f"swing_clearance_m.demonstration.{i}", 1, 1e3)
        row(f"swing clearance {leg}, mm", [f"swing_clearance_m.{c}.{i}" for c in columns], 1, 1e3)
        rows[-1][0] = f"<th>swing clearance {leg}, mm (of {wanted})</th>"
    row("early contacts, 1/s", [f"early_contacts_per_s.{c}" for c in columns], 1)
    row("stance slip, mm", [f"stance_slip_m.{c}" for c in columns], 2, 1e3)
    row("foot height error, RMS, mm", [f"foot_z_rmse_m.{c}" for c in columns], 2, 1e3)
    row("foot fore-aft error, RMS, mm", [f"foot_x_rmse_m.{c}" for c in columns], 2, 1e3)
    row("steps without a QP solution", [f"qp_failures.{c}" for c in columns], 0)
    names = ("before", "after") if run.optimised else ("not optimised",)
    effort = [
        f"{_number(m, 'evaluations', 0)} episodes",
        f"{_number(m, 'simulated_s', 0)} s simulated in {_number(m, 'wall_s', 1)} s",
    ]
    tables = "".join(table(("", *names), part) for part in (rows[:split], rows[split:]))
    return (
        f'<div class="two">{tables}</div><p class="hint">Swing clearance above: the least share of the demonstration\'s'
        f" that a leg realises. RMS errors are over the four feet. {', '.join(effort)}.</p>"
    )


def _segments(m: Mapping[str, Any]) -> str:
    """Of a stitched motion: its segments, and the transitions between them."""
    found = m.get("segments")
    if not found:
        return ""
    rows = []
    for i, s in enumerate(found):
        own = _number(m, f"individual_optima.segments.{i}", 3)
        rows.append(
            [
                f"<th>{escape(str(s['motion']))}</th>",
                *(_number(m, f"segments.{i}.{k}", d) for k, d in (("cycles", 0), ("first_s", 2), ("last_s", 2))),
                *(_number(m, f"segments.{i}.reward.before", 3), own, _number(m, f"segments.{i}.reward.after", 3)),
                _number(m, f"segments.{i}.fell.after", 0),
            ]
        )
    header = ("segment", "cycles", "from, s", "to, s", "reward before", "own optimum", "after", "fell")
    return "<h3 class='next'>Segments</h3>" + table(header, rows)


def _parameters(m: Mapping[str, Any]) -> str:
    rows = [
        [
            f"<th><code>{escape(p['name'])}</code></th>",
            *(_number(m, f"parameters.{i}.{k}", 4) for k in ("lower", "initial", "value", "upper")),
            escape(p["unit"] if p["unit"] != "1" else NONE),
        ]
        for i, p in enumerate(m["parameters"])
    ]
    return table(("parameter", "lower bound", "as fitted", "found", "upper bound", "unit"), rows)


def _provenance(run: RunData) -> str:
    m, config = run.metrics, run.config
    arguments = {
        k.replace("_", "-"): v
        for k, v in config.get("arguments", {}).items()
        if v is not False and v not in (None, "", [])
    }
    for name in ("motions", "cycles"):
        if name in arguments:
            arguments[name] = " ".join(str(v) for v in arguments[name])
    arguments = {k: "yes" if v is True else v for k, v in arguments.items()}
    source = config.get("source")
    about: dict[str, Any] = {"motion": m["motion"], "robot": m["robot"]}
    if isinstance(source, dict):
        about |= {k: v for k, v in source.items() if isinstance(v, str | int | float)}
    if config.get("licence"):
        about["licence"] = config["licence"]
    html = '<div class="two"><div><h3>Arguments</h3>'
    html += pairs(arguments) if arguments else f'<p class="hint">{CONFIG} does not tell.</p>'
    html += f"</div><div><h3>Motion</h3>{pairs(about)}"
    html += f"<h3 class='next'>Versions</h3>{pairs(m.get('versions', {}))}</div></div>"
    if config.get("controller"):
        record = escape(json.dumps(config["controller"], indent=2, ensure_ascii=False))
        html += f"<details><summary>All parameters of the controller</summary><pre>{record}</pre></details>"
    return html
