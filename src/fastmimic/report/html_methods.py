"""The plots of a comparison: methods and ablations, with every seed. The numbers are those of results.csv."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from fastmimic.experiments.ablations import ABLATED
from fastmimic.experiments.tables import Summary
from fastmimic.imitation.methods import ALL_METHODS, method_named
from fastmimic.report.html_parts import Figure, Key, Panel, numbers
from fastmimic.report.html_traces import layout_of

_STYLES: Final = {  # colour, pattern of a bar, symbol of a point: no two methods share all of them
    "rl": ("var(--rl)", ".", "cross"),
    "raibert": ("var(--raibert)", "/", "square"),
    "mbc": ("var(--mbc)", "", "triangle-up"),
    "lh": ("var(--lh)", "\\", "triangle-down"),
    "mbc-dmp": ("var(--mbcdmp)", "", "diamond"),
    "lh-dmp": ("var(--lhdmp)", "x", "star"),
}
_OTHER: Final = ("var(--muted)", "-", "circle")
_BAR: Final = 0.84
"""Share of a group's width that its bars take."""
_ALIKE: Final = 0.005
"""Rewards that differ by less are called alike."""
_SEED: Final = Key("each seed", "var(--ink)", "o")
_ROUGH: Final = Key("from perturbed starts", "var(--ink)", "o")
_WHOLE: Final = Key(f"{method_named(ABLATED).label} as it is", "var(--muted)", "dash")
_BEFORE: Final = Key("before the optimisation", "var(--ink)", "solid")


@dataclass(frozen=True)
class Measure:
    """A column of `results.csv` as it is drawn.

    Attributes:
        column: its name.
        title: of the panel.
        unit: of the axis.
        scale: from the column's unit to the axis'.
        top: of the axis; None for what the values need.
        before: the column of the same before the optimisation; empty for none.
    """

    column: str
    title: str
    unit: str
    scale: float = 1.0
    top: float | None = None
    before: str = ""


_REWARDS: Final = (
    Measure("reward", "Nominal episode", "reward (0 to 1)", top=1.05),
    Measure("reward_perturbed", "Perturbed starts, mean over the episodes", "reward (0 to 1)", top=1.05),
)
_HOW: Final = (
    Measure(
        "swing_clearance_least_share", "Swing clearance, least of four legs", "share of the demonstration's (%)", 100
    ),
    Measure("style_distance_realised", "Style distance of what the feet did", "0 the same, 1 not lifted"),
    Measure("foot_z_rmse_after_m", "Foot height error", "RMS, four feet (mm)", 1e3, before="foot_z_rmse_before_m"),
    Measure("foot_x_rmse_after_m", "Fore-aft error", "RMS, four feet (mm)", 1e3, before="foot_x_rmse_before_m"),
)


def rewards(found: Sequence[Summary]) -> Figure:
    """Reward of every method on every motion, nominal and from perturbed starts.

    Args:
        found: without variants.
    """
    means = {method_named(m).label: _over_motions(found, m, "reward") for m in _methods(found)}
    best = max(means.values())
    leading = [label for label, mean in means.items() if mean > best - _ALIKE]
    title = "Reward of each method on each motion"
    if len(means) > 1 and len(leading) == 1:
        title += f": {leading[0]} is best, {best:.3f} on average"
    elif len(means) > 1:
        title += f": {', '.join(leading[:-1])} and {leading[-1]} are within {_ALIKE:g}, {best:.3f} on average at best"
    return Figure(
        "rewards",
        title,
        "Bars are means over the seeds with their sample standard deviation; a circle is one seed. The perturbed starts"
        " are the same for every method, and no optimisation has seen them.",
        [_bars(found, measure) for measure in _REWARDS],
        1,
        (*_legend(found), _SEED),
    )


def manners(found: Sequence[Summary]) -> Figure:
    """How the reward was got: is it still the animal's motion, and how well is it tracked?

    Args:
        found: without variants.
    """
    return Figure(
        "manners",
        "Style and tracking: a reward that is got by shuffling shows here",
        "Swing clearance of 100 % lifts the feet as the demonstration does; a style distance of 0 is its very step. A"
        " line across a bar is the error before the optimisation.",
        [_bars(found, measure, height=270) for measure in _HOW],
        2,
        (*_legend(found), _SEED, _BEFORE),
    )


def cost(found: Sequence[Summary]) -> Figure | None:
    """Reward against processor time; None if no run has one.

    Args:
        found: without variants.
    """
    data = []
    for name in _methods(found):
        color, _, symbol = _style(name)
        rows = [row for s in found if s.method == name for row in s.rows if row.get("cpu_s")]
        if rows:
            data.append(
                {
                    "type": "scatter",
                    "mode": "markers",
                    "name": method_named(name).label,
                    "x": numbers([row["cpu_s"] for row in rows]),
                    "y": numbers([row["reward"] for row in rows], 17),
                    "text": [f"{row['motion']}, seed {row['seed']:g}" for row in rows],
                    "marker": {
                        "symbol": symbol,
                        "size": 10,
                        "color": color,
                        "line": {"width": 1, "color": "var(--paper)"},
                    },
                    "hovertemplate": "%{text}: reward %{y:.3f}, %{x:.3g} s",
                }
            )
    if not data:
        return None
    layout = layout_of("processor time (s)", "reward (0 to 1)", 330)
    layout["xaxis"]["type"] = "log"
    layout["hovermode"] = "closest"
    legend = [Key(method_named(n).label, _style(n)[0], f"symbol {_style(n)[2]}") for n in _methods(found)]
    return Figure(
        "cost",
        "What a reward costs: the processor time of each run, optimisation and evaluation",
        "One point a run, on the machine named below. Methods that optimise nothing need only the evaluation.",
        [Panel("", data, layout)],
        1,
        legend,
    )


def ablations(found: Sequence[Summary]) -> Figure:
    """Reward of the method and of its variants, a panel a motion.

    Args:
        found: the method and its variants.
    """
    variants = sorted(dict.fromkeys(s.variant for s in found), key=bool)
    losses = {v: _change(found, v) for v in variants if v}
    there = {v: loss for v, loss in losses.items() if loss is not None}
    title = "Ablations"
    if there:
        worst = min(there, key=lambda v: there[v])
        title = f"What the parts are worth: most is lost by {worst}, {there[worst]:+.3f} of reward on average"
    panels = []
    for motion in dict.fromkeys(s.motion for s in found):
        own = [s for s in found if s.motion == motion]
        names = [s.variant or ABLATED for s in own]
        data = [
            {
                **_marks(
                    _rounded([s.mean("reward") for s in own]), names, "diamond", "var(--after)", 10, "reward %{x:.3f}"
                ),
                "name": "reward",
                "error_x": {
                    "type": "data",
                    "array": numbers([s.std("reward") or 0.0 for s in own]),
                    "color": "var(--ink)",
                    "thickness": 1.2,
                    "width": 3,
                },
            },
            {
                **_marks(
                    _rounded([s.mean("reward_perturbed") for s in own]),
                    names,
                    "circle-open",
                    "var(--ink)",
                    8,
                    "perturbed starts %{x:.3f}",
                ),
                "name": "perturbed",
            },
        ]
        layout = layout_of("reward", "", 90 + 24 * len(variants))
        layout["hovermode"] = "closest"
        layout["yaxis"] |= {
            "type": "category",
            "categoryorder": "array",
            "categoryarray": [v or ABLATED for v in variants],
            "range": [len(variants) - 0.4, -0.6],
            "tickmode": "linear",
            "dtick": 1,
        }
        whole = next((s.mean("reward") for s in own if not s.variant), None)
        if whole is not None:
            dashed = {"color": "var(--muted)", "dash": "dash", "width": 1.2}
            layout["shapes"] = [
                {
                    "type": "line",
                    "xref": "x",
                    "yref": "paper",
                    "x0": whole,
                    "x1": whole,
                    "y0": 0,
                    "y1": 1,
                    "line": dashed,
                }
            ]
        panels.append(Panel(motion, data, layout))
    return Figure(
        "ablation",
        title,
        f"Each row is {method_named(ABLATED).label} with one part taken away or changed, optimised anew. The scales"
        " begin where the values do.",
        panels,
        2,
        (Key("nominal, mean ± std over the seeds", "var(--after)", "d"), _ROUGH, _WHOLE),
    )


def _bars(found: Sequence[Summary], measure: Measure, height: int = 330) -> Panel:
    """Bars in groups, a group a motion."""
    motions, methods = list(dict.fromkeys(s.motion for s in found)), _methods(found)
    width = _BAR / len(methods)
    data: list[dict[str, Any]] = []
    dots: tuple[list[float], list[float], list[str]] = ([], [], [])
    before: list[dict[str, Any]] = []
    for j, name in enumerate(methods):
        color, pattern, _ = _style(name)
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
                "marker": {
                    "color": color,
                    "pattern": {
                        "shape": pattern,
                        "fillmode": "overlay",
                        "fgcolor": "var(--paper)",
                        "fgopacity": 0.7,
                        "size": 7,
                        "solidity": 0.25,
                    },
                },
                "error_y": {
                    "type": "data",
                    "array": numbers(stds),
                    "visible": any(stds),
                    "color": "var(--ink)",
                    "thickness": 1.2,
                    "width": 3,
                },
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
    data.append(
        {
            "type": "scatter",
            "mode": "markers",
            "name": _SEED.label,
            "x": numbers(dots[0]),
            "y": numbers(dots[1], 17),
            "text": dots[2],
            "marker": {"symbol": "circle-open", "size": 5, "color": "var(--ink)", "line": {"width": 1.2}},
            "hovertemplate": "%{text}: %{y:.4g}<extra></extra>",
        }
    )
    layout = layout_of("motion", measure.unit, height)
    layout["xaxis"] |= {
        "tickmode": "array",
        "tickvals": list(range(len(motions))),
        "ticktext": motions,
        "range": [-0.55, len(motions) - 0.45],
        "showgrid": False,
    }
    layout["yaxis"] |= {"rangemode": "tozero"} if measure.top is None else {"range": [0, measure.top]}
    layout["hovermode"], layout["barmode"], layout["shapes"] = "closest", "overlay", before
    return Panel(measure.title, data, layout)


def _marks(x: list[float | None], y: list[str], symbol: str, color: str, size: int, hover: str) -> dict[str, Any]:
    return {
        "type": "scatter",
        "mode": "markers",
        "x": x,
        "y": y,
        "marker": {"symbol": symbol, "size": size, "color": color, "line": {"width": 1.6, "color": color}},
        "hovertemplate": f"%{{y}}: {hover}<extra></extra>",
    }


def _rounded(values: Sequence[float | None]) -> list[float | None]:
    return numbers([np.nan if v is None else v for v in values], 17)


def _legend(found: Sequence[Summary]) -> list[Key]:
    return [Key(method_named(n).label, _style(n)[0], f"fill{_style(n)[1]}") for n in _methods(found)]


def _style(method: str) -> tuple[str, str, str]:
    return _STYLES.get(method, _OTHER)


def _methods(found: Sequence[Summary]) -> list[str]:
    return [name for name in ALL_METHODS if any(s.method == name for s in found)]


def _over_motions(found: Sequence[Summary], method: str, column: str) -> float:
    """Mean over the motions of a method's means; −1 if there is none."""
    values = [s.mean(column) for s in found if s.method == method]
    return float(np.mean([v for v in values if v is not None])) if any(v is not None for v in values) else -1.0


def _change(found: Sequence[Summary], variant: str) -> float | None:
    """Of the reward against the method as it is, mean over the motions that have both."""
    whole = {s.motion: s.mean("reward") for s in found if not s.variant}
    changes = [
        float(s.mean("reward") or 0.0) - float(whole[s.motion] or 0.0)
        for s in found
        if s.variant == variant and whole.get(s.motion) is not None
    ]
    return float(np.mean(changes)) if changes else None
