"""What the plots of a run have in common, as plain Plotly: lines, layouts, the two series before and after, and which
times are shown. Colours are names of the style sheet's."""

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from fastmimic.base.arrays import Array
from fastmimic.episode.rollout import Log, Rollout
from fastmimic.report.html_parts import Key, numbers
from fastmimic.report.html_run import Episodes

BEFORE: Final = Key("before: as retargeted", "var(--before)", "2px,5px")
AFTER: Final = Key("after: optimised", "var(--after)", "solid")
ONLY: Final = Key("as retargeted, not optimised", "var(--after)", "solid")
DEMONSTRATION: Final = Key("demonstration", "var(--demo)", "dash")
STANCE: Final = Key("stance wanted", "var(--stance)", "fill")
LIMIT: Final = Key("limit", "var(--limit)", "dashdot")
POINTS: Final = 1000
"""Points of a curve at most: a page is to open on a phone."""
CYCLES: Final = 2  # shown at first
TRANSITION_S: Final = 2.0  # of a stitched motion, shown at first


def first_window(e: Episodes) -> tuple[float, float]:
    """The times that are shown at first, s: the last cycles before the end, or the first transition."""
    log = log_of(e.before)
    total = log.wanted.shape[1] / log.rate_hz
    starts = e.motion.target.segment_starts
    if len(starts) > 1:
        start = max(0.0, starts[1] / log.rate_hz - TRANSITION_S / 2)
        return start, min(total, start + TRANSITION_S)
    alive = max(int(r.steps[0]) for r, _ in series(e)) / log.rate_hz
    start = max(0.0, alive - CYCLES * e.motion.period_s)
    return start, max(alive, start + 0.1)


def whole_episode(e: Episodes) -> tuple[float, float]:
    """From 0 to the end of the episodes, s."""
    log = log_of(e.before)
    return 0.0, log.wanted.shape[1] / log.rate_hz


def series(e: Episodes) -> list[tuple[Rollout, Key]]:
    return [(e.before, ONLY)] if e.after is None else [(e.before, BEFORE), (e.after, AFTER)]


def keys(e: Episodes) -> tuple[Key, ...]:
    return tuple(key for _, key in series(e))


def short(key: Key) -> str:
    return "The robot" if key is ONLY else key.label.split(":")[0].capitalize()


def log_of(rollout: Rollout) -> Log:
    assert rollout.log is not None, "the plots need rollouts with their logs"
    return rollout.log


def times(log: Log) -> Array:
    """(t,) s, of the states after each step."""
    return np.arange(1, log.wanted.shape[1] + 1) / log.rate_hz


def greatest(values: Array) -> float:
    """Of those that are finite; NaN if none is, as where a robot fell at once."""
    found = values[np.isfinite(values)]
    return float(found.max()) if found.size else float("nan")


def arrow(values: Sequence[float], digits: int) -> str:
    return " → ".join(f"{v:.{digits}f}" if np.isfinite(v) else "–" for v in values)


def curve(time: Array, values: Array, key: Key, *, peak: bool = False) -> dict[str, Any]:
    """A line of at most `POINTS` points: every so many samples, or, with `peak`, the greatest of so many."""
    stride = -(-len(time) // POINTS)
    if stride > 1 and peak:
        whole = np.full(stride * -(-len(values) // stride), np.nan)
        whole[: len(values)] = values
        blocks = whole.reshape(-1, stride)
        there = np.isfinite(blocks).any(axis=1)
        kept = np.where(there, np.where(np.isfinite(blocks), blocks, -np.inf).max(axis=1), np.nan)
    else:
        kept = values[::stride]
    return line(numbers(time[::stride]), kept, key, width=1.7)


def line(x: Any, y: Any, key: Key, *, width: float = 2.0, **more: Any) -> dict[str, Any]:
    return {
        "type": "scatter",
        "mode": "lines",
        "name": key.label,
        "x": x,
        "y": numbers(y) if isinstance(y, np.ndarray) else y,
        "line": {"color": key.color, "dash": key.dash, "width": width},
        "hovertemplate": "%{y:.4g}",
        **more,
    }


def points(x: Sequence[Any], y: Sequence[Any], key: Key, unit: str, *, size: int = 10) -> dict[str, Any]:
    symbol, share = {"o": ("circle-open", 1.5), "d": ("diamond", 1.0)}[key.dash]
    return {
        "type": "scatter",
        "mode": "markers",
        "name": key.label,
        "x": list(x),
        "y": list(y),
        "marker": {
            "symbol": symbol,
            "size": share * size,
            "color": key.color,
            "line": {"width": 1.8, "color": key.color},
        },
        "hovertemplate": f"%{{y}}: %{{x:.4g}} {unit}".rstrip(),
    }


def layout_of(
    x: str,
    y: str,
    height: int = 240,
    xrange: tuple[float, float] | None = None,
    yrange: tuple[float, float] | None = None,
) -> dict[str, Any]:
    xaxis: dict[str, Any] = {"title": {"text": x}}
    yaxis: dict[str, Any] = {"title": {"text": y}}
    if xrange is not None:
        xaxis["range"] = numbers(xrange)
    if yrange is not None:
        yaxis["range"] = numbers(yrange)
    return {"height": height, "xaxis": xaxis, "yaxis": yaxis}


def intervals(on: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """First index and end of each stretch of True."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], on.astype(np.int8), [0]])))
    return [(int(a), int(b)) for a, b in edges.reshape(-1, 2)]


def shades(time: Array, stance: NDArray[np.bool_]) -> list[dict[str, Any]]:
    ends = np.append(time, time[-1])
    return [
        {
            "type": "rect",
            "xref": "x",
            "yref": "paper",
            "x0": float(ends[a]),
            "x1": float(ends[b]),
            "y0": 0,
            "y1": 1,
            "fillcolor": STANCE.color,
            "line": {"width": 0},
            "layer": "below",
        }
        for a, b in intervals(stance)
    ]


def level(value: float, key: Key) -> dict[str, Any]:
    line = {"color": key.color, "dash": key.dash, "width": 1.6}
    return {"type": "line", "xref": "paper", "yref": "y", "x0": 0, "x1": 1, "y0": value, "y1": value, "line": line}


def between_rows(y: float) -> dict[str, Any]:
    line = {"color": "var(--line)", "width": 1}
    return {"type": "line", "xref": "paper", "yref": "y", "x0": 0, "x1": 1, "y0": y, "y1": y, "line": line}


def segment_lines(e: Episodes) -> list[dict[str, Any]]:
    """Where a stitched motion passes from one segment to the next."""
    line = {"color": "var(--muted)", "dash": "dash", "width": 1}
    rate = log_of(e.before).rate_hz
    return [
        {"type": "line", "xref": "x", "yref": "paper", "x0": s / rate, "x1": s / rate, "y0": 0, "y1": 1, "line": line}
        for s in e.motion.target.segment_starts
        if s
    ]
