"""The figures of a run: those of metrics.json, each with its name and its exact value as data."""

from collections.abc import Mapping
from html import escape
from typing import Any

from fastmimic.base.conventions import LEGS
from fastmimic.report.html_parts import NONE, table
from fastmimic.report.html_run import RunData


def tiles(run: RunData) -> str:
    """The figures that matter most, large."""
    m = run.metrics
    now = "after" if run.optimised else "before"
    rows = (
        ("Reward", "reward", 3, 1.0, ""),
        ("Fell", "fell", 0, 1.0, ""),
        ("Drift", "drift_m_per_s", 3, 1.0, "m/s"),
        ("Foot height error", "foot_z_rmse_m", 1, 1e3, "mm"),
        ("Fore-aft error", "foot_x_rmse_m", 1, 1e3, "mm"),
    )
    made = []
    for label, key, digits, scale, unit in rows:
        if key == "drift_m_per_s" and _done_once(run):
            continue  # 0, as nothing is synchronised: no merit
        was = f"before {_number(m, f'{key}.before', digits, scale)}" if run.optimised else "not optimised"
        was = f"RMS, {was}" if "rmse" in key else was
        unit = f" <small>{unit}</small>" if unit else ""
        value = _number(m, f"{key}.{now}", digits, scale)
        made.append(f'<div class="tile"><dt>{label}</dt><dd>{value}{unit}<span class="was">{was}</span></dd></div>')
    share, was = _least_share(m, now), _least_share(m, "before")
    before = f"before {was}" if run.optimised else "not optimised"
    made.insert(2, f'<div class="tile"><dt>Swing clearance</dt><dd>{share}<span class="was">{before}</span></dd></div>')
    return f'<dl class="tiles">{"".join(made)}</dl>'


def before_and_after(run: RunData) -> str:
    """All figures, before and after."""
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
    if "randomization" in m:
        others = f"{_value(m, 'randomization.held_out.robots')} other robots"
        for label, key in (("mean over", "mean"), ("worst of", "worst"), ("share of falls,", "fell")):
            row(f"{label} {others}", [f"randomization.held_out.{c}.{key}" for c in columns], 4)
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
    drift = (
        " Drift is what synchronising the reference at a cycle's start hides: none here, as the motion is done once."
        if _done_once(run)
        else ""
    )
    tables = "".join(table(("", *names), part) for part in (rows[:split], rows[split:]))
    return (
        f'<div class="two">{tables}</div><p class="hint">Swing clearance above: the least share of the demonstration\'s'
        f" that a leg realises. RMS errors are over the four feet. {', '.join(effort)}.{drift}</p>"
    )


def _done_once(run: RunData) -> bool:
    return run.episodes is not None and run.episodes.done_once


def segments(m: Mapping[str, Any]) -> str:
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


def parameter_table(m: Mapping[str, Any]) -> str:
    """The parameters with their bounds."""
    rows = [
        [
            f"<th><code>{escape(p['name'])}</code></th>",
            *(_number(m, f"parameters.{i}.{k}", 4) for k in ("lower", "initial", "value", "upper")),
            escape(p["unit"] if p["unit"] != "1" else NONE),
        ]
        for i, p in enumerate(m["parameters"])
    ]
    return table(("parameter", "lower bound", "as fitted", "found", "upper bound", "unit"), rows)


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


def _least_share(m: Mapping[str, Any], when: str) -> str:
    """The smallest share of the demonstration's swing clearance among the legs that swing."""
    wanted, got = _value(m, "swing_clearance_m.demonstration"), _value(m, f"swing_clearance_m.{when}")
    shares = [g / w for g, w in zip(got or [], wanted or [], strict=False) if g is not None and w]
    return f"{100 * min(shares):.0f} <small>%</small>" if shares else NONE
