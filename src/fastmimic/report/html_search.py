"""The plots of the optimisation."""

from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np

from fastmimic.report.html_plots import Figure, Key, Plot, layout_of, line, numbers, points, rows_axis
from fastmimic.report.html_run import SearchHistory

_FITTED: Final = Key("as fitted", "var(--before)", symbol="circle-open")
_FOUND: Final = Key("found", "var(--after)", symbol="diamond")
_CHOICE: Final = (
    "the reward of an episode less the penalty for feet lifted too little. The result is chosen by longer, perturbed"
    " episodes among the best of them and the motion as fitted."
)
_CHOICE_OVER_ROBOTS: Final = (
    "the reward of an episode less the penalty for feet lifted too little, over several robots, others in each"
    " iteration. The result is chosen on yet others, by longer episodes, among the last iterations' best candidates,"
    " the means of the search then, and the motion as fitted."
)


def convergence(
    search: SearchHistory, before: float, after: float, *, unchanged: bool = False, randomized: bool = False
) -> Figure:
    """Scores of the candidates by generation, and their spread.

    Args:
        before, after: rewards of the run.
        unchanged: whether the motion as fitted is the result.
        randomized: whether each iteration scored on other robots.
    """
    scores = search.scores
    k = np.arange(1, len(scores) + 1)
    mean, std = scores.mean(axis=1), scores.std(axis=1)
    best = scores.max(axis=1) if randomized else np.maximum.accumulate(scores.max(axis=1))
    spread = search.candidates.std(axis=1).mean(axis=1)
    x, mode = k.tolist(), "lines" if len(k) > 2 else "lines+markers"
    band = Key("candidates, ± 1 std", "var(--band)", pattern="")
    average = Key("candidates, mean", "var(--before)", "dot")
    leader = Key("best of the iteration" if randomized else "best so far", "var(--after)", "solid")
    start = Key("reward before", "var(--demo)", "dash")
    data = [
        line(x, mean - std, Key("", "rgba(0,0,0,0)"), hoverinfo="skip"),
        line(x, mean + std, Key("", "rgba(0,0,0,0)"), fill="tonexty", fillcolor="var(--band)", hoverinfo="skip"),
        line(x, mean, average, mode=mode),
        line(x, best, leader, mode=mode),
        line([x[0], x[-1]], np.array([before, before]), start),
    ]
    drawn = np.concatenate([mean - std, best, [before]])
    low, high = float(np.percentile(drawn, 2)), float(max(best.max(), before))
    margin = 0.08 * max(high - low, 1e-3)
    reward = layout_of("iteration", "score (reward − penalty)", height=330, yrange=(low - margin, high + margin))
    step = layout_of("iteration", "spread (share of the range)", height=330)
    step["yaxis"]["type"] = "log"
    for layout in (reward, step):
        layout["xaxis"] |= {"tickmode": "linear", "dtick": 1, "tick0": 0} if len(k) <= 10 else {}
    gained = after - before
    verb = "rises" if gained > 5e-4 else "falls" if gained < -5e-4 else "hardly changes"
    effort = f"{len(k)} iteration{'s' if len(k) > 1 else ''}"
    title = f"The reward {verb}: {before:.3f} before, {after:.3f} after {effort}"
    if unchanged:
        title = f"{effort.capitalize()} found nothing better than the motion as fitted (reward {after:.3f})"
    return Figure(
        "convergence",
        title,
        f"Left, the candidates' scores: {_CHOICE_OVER_ROBOTS if randomized else _CHOICE} Right, how far the"
        " candidates of CMA-ES are apart, mean standard deviation over the parameters: it falls as the search settles.",
        [Plot("Score", data, reward), Plot("Spread of the candidates", [line(x, spread, leader, mode=mode)], step)],
        2,
        (leader, average, band, start),
    )


def as_fitted(found: Sequence[Mapping[str, Any]]) -> bool:
    """Whether the result is the motion as fitted, from the parameters of `metrics.json`."""
    return all(p["value"] == p["initial"] for p in found)


def parameters(found: Sequence[dict[str, Any]]) -> Figure:
    """Baselines and amplitudes between their bounds, from the parameters of `metrics.json`."""
    plots = []
    for kind, measured, title, axis, unit, scale in (
        ("goal", "m", "Baseline g", "change of the baseline (mm)", "mm", 1e3),
        ("goal", "rad", "Baseline g of angles", "change of the baseline (°)", "°", float(np.degrees(1.0))),
        ("amplitude", "1", "Amplitude a", "amplitude (1 = as fitted)", "", 1.0),
    ):
        own = [p for p in found if p["name"].endswith(f".{kind}") and p["unit"] == measured]
        if not own:
            continue
        shift = [p["initial"] if kind == "goal" else 0.0 for p in own]
        names = [p["name"].rsplit(".", 1)[0].replace("_foot_z", " foot z").replace("_", " ") for p in own]
        ends: list[float | None] = []
        for p, s in zip(own, shift, strict=True):
            ends += [*numbers([scale * (p["lower"] - s), scale * (p["upper"] - s)]), None]
        rows = [name for name in names for _ in range(3)]
        data = [
            {
                **line(ends, rows, Key("bounds", "var(--muted)")),
                "mode": "lines+markers",
                "marker": {"symbol": "line-ns-open", "size": 11, "color": "var(--muted)"},
                "line": {"color": "var(--grid)", "width": 6},
            },
            *(
                points(
                    numbers([scale * (p[value] - s) for p, s in zip(own, shift, strict=True)]),
                    names,
                    key,
                    f"%{{y}}: %{{x:.4g}} {unit}".rstrip(),
                    size=size,
                )
                for value, key, size in (("initial", _FITTED, 15), ("value", _FOUND, 10))
            ),
        ]
        layout = layout_of(axis, "", height=70 + 26 * len(own), hovermode="closest")
        layout["yaxis"] |= {**rows_axis(names), "showgrid": False}
        plots.append(Plot(title, data, layout))
    at = sum(min(p["value"] - p["lower"], p["upper"] - p["value"]) < 0.01 * (p["upper"] - p["lower"]) for p in found)
    ending = "none at a bound" if not at else f"{at} at a bound, where the search would have gone further"
    if as_fitted(found):
        ending = "all as they were fitted"
    return Figure(
        "parameters",
        f"What the optimiser chose: {len(found)} parameters, {ending}",
        "Each grey bar is what the search may use. The baseline moves a foot's path up or down, the amplitude stretches"
        " it about its mean; the shape stays the animal's.",
        plots,
        2,
        (_FITTED, _FOUND, Key("bounds", "var(--grid)", pattern="")),
    )
