"""The plots of a run, as plain Plotly traces and layouts. Colours are names of the style sheet's."""

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from fastmimic.conventions import GRAVITY, JOINTS_PER_LEG, LEGS
from fastmimic.imitation.reward import TERMS, WEIGHTS
from fastmimic.imitation.rollout import Log, Rollout
from fastmimic.report.html_parts import Figure, Key, Panel, numbers
from fastmimic.report.html_run import Course, Episodes
from fastmimic.report.tracks import realised_feet
from fastmimic.simulation.mujoco_sim import GROUND_FRICTION

Array = NDArray[np.float64]

BEFORE: Final = Key("before: as retargeted", "var(--before)", "2px,5px")
AFTER: Final = Key("after: optimised", "var(--after)", "solid")
ONLY: Final = Key("as retargeted, not optimised", "var(--after)", "solid")
DEMONSTRATION: Final = Key("demonstration", "var(--demo)", "dash")
STANCE: Final = Key("stance wanted", "var(--stance)", "fill")
LIMIT: Final = Key("limit", "var(--limit)", "dashdot")
POINTS: Final = 1000
"""Points of a curve at most: a page is to open on a phone."""
LOADED: Final = 0.05
"""Share of the robot's weight above which a foot counts as loaded in the plot of friction."""
CYCLES: Final = 2  # shown at first
TRANSITION_S: Final = 2.0  # of a stitched motion, shown at first


def convergence(course: Course, before: float, after: float) -> Figure:
    """Scores of the candidates by generation, and how far apart they still are.

    Args:
        course: of the optimiser.
        before, after: rewards of the run.
    """
    scores = course.scores
    k = np.arange(1, len(scores) + 1)
    mean, std = scores.mean(axis=1), scores.std(axis=1)
    best = np.maximum.accumulate(scores.max(axis=1))
    spread = course.candidates.std(axis=1).mean(axis=1)
    x, mode = k.tolist(), "lines" if len(k) > 2 else "lines+markers"
    band = Key("candidates, ± 1 std", "var(--band)", "fill")
    average = Key("candidates, mean", "var(--before)", "dot")
    leader = Key("best so far", "var(--after)", "solid")
    start = Key("reward before", "var(--demo)", "dash")
    data = [
        _line(x, mean - std, Key("", "rgba(0,0,0,0)"), hoverinfo="skip"),
        _line(x, mean + std, Key("", "rgba(0,0,0,0)"), fill="tonexty", fillcolor="var(--band)", hoverinfo="skip"),
        _line(x, mean, average, mode=mode),
        _line(x, best, leader, mode=mode),
        _line([x[0], x[-1]], np.array([before, before]), start),
    ]
    drawn = np.concatenate([mean - std, best, [before]])
    low, high = float(np.percentile(drawn, 2)), float(max(best.max(), before))
    margin = 0.08 * max(high - low, 1e-3)
    reward = _layout("iteration", "score (reward − penalty)", height=330, yrange=(low - margin, high + margin))
    step = _layout("iteration", "spread (share of the range)", height=330)
    step["yaxis"]["type"] = "log"
    for layout in (reward, step):
        layout["xaxis"] |= {"tickmode": "linear", "dtick": 1, "tick0": 0} if len(k) <= 10 else {}
    gained = after - before
    verb = "rises" if gained > 5e-4 else "falls" if gained < -5e-4 else "hardly changes"
    return Figure(
        "convergence",
        f"The reward {verb}: {before:.3f} before, {after:.3f} after {len(k)} iteration{'s' if len(k) > 1 else ''}",
        "Left, the candidates' scores: the reward of an episode less the penalty for feet lifted too little; the"
        " result is chosen among the best by longer, perturbed episodes. Right, how far the candidates of CMA-ES are"
        " apart, mean standard deviation over the parameters: it falls as the search settles.",
        [Panel("Score", data, reward), Panel("Spread of the candidates", [_line(x, spread, leader, mode=mode)], step)],
        2,
        (leader, average, band, start),
    )


def parameters(found: Sequence[dict[str, Any]]) -> Figure:
    """Baselines and amplitudes between their bounds.

    Args:
        found: of `metrics.json`.
    """
    panels = []
    for kind, title, axis, unit in (
        ("goal", "Baseline g", "change of the baseline (mm)", "mm"),
        ("amplitude", "Amplitude a", "amplitude (1 = as fitted)", ""),
    ):
        own = [p for p in found if p["name"].endswith(f".{kind}")]
        if not own:
            continue
        scale = 1e3 if kind == "goal" else 1.0
        shift = [p["initial"] if kind == "goal" else 0.0 for p in own]
        names = [p["name"].rsplit(".", 1)[0].replace("_foot_z", " foot z").replace("_", " ") for p in own]
        ends: list[float | None] = []
        for p, s in zip(own, shift, strict=True):
            ends += [*numbers([scale * (p["lower"] - s), scale * (p["upper"] - s)]), None]
        rows = [name for name in names for _ in range(3)]
        data = [
            {
                **_line(ends, rows, Key("bounds", "var(--muted)")),
                "mode": "lines+markers",
                "marker": {"symbol": "line-ns-open", "size": 11, "color": "var(--muted)"},
                "line": {"color": "var(--grid)", "width": 6},
            },
            _points(
                numbers([scale * (p["initial"] - s) for p, s in zip(own, shift, strict=True)]),
                names,
                Key("as fitted", "var(--before)", "o"),
                unit,
            ),
            _points(
                numbers([scale * (p["value"] - s) for p, s in zip(own, shift, strict=True)]),
                names,
                Key("found", "var(--after)", "d"),
                unit,
            ),
        ]
        layout = _layout(axis, "", height=70 + 26 * len(own))
        layout["yaxis"] |= {
            "autorange": "reversed",
            "showgrid": False,
            "tickmode": "linear",
            "dtick": 1,
            "type": "category",
        }
        layout["hovermode"] = "closest"
        panels.append(Panel(title, data, layout))
    at = sum(min(p["value"] - p["lower"], p["upper"] - p["value"]) < 0.01 * (p["upper"] - p["lower"]) for p in found)
    ending = "none at a bound" if not at else f"{at} at a bound, where the search would have gone further"
    return Figure(
        "parameters",
        f"What the optimiser chose: {len(found)} parameters, {ending}",
        "Each grey bar is what the search may use. The baseline moves a foot's path up or down, the amplitude stretches"
        " it about its mean; the shape stays the animal's.",
        panels,
        2,
        (
            Key("as fitted", "var(--before)", "o"),
            Key("found", "var(--after)", "d"),
            Key("bounds", "var(--grid)", "fill"),
        ),
    )


def feet(e: Episodes) -> list[Figure]:
    """Height and fore-aft position of the four feet, two figures."""
    log = _log(e.before)
    time = _time(log)
    window = first_window(e)
    shown = (time >= window[0]) & (time <= window[1])
    wanted = log.demonstration["foot_pos"][0]
    realised = [realised_feet(r, e.robot) for r, _ in _series(e)]
    figures = []
    for axis, name, what in ((2, "foot-z", "Foot height"), (0, "foot-x", "Fore-aft position of the feet")):
        values = np.concatenate([wanted[shown], *(f[shown] for f in realised)])[:, :, axis]
        low, high = np.nanmin(values, axis=0), np.nanmax(values, axis=0)
        half = 0.56 * max(float(np.max(high - low)), 0.01)
        panels = []
        for leg, label in enumerate(LEGS):
            data = [_curve(time, wanted[:, leg, axis], DEMONSTRATION)]
            errors = []
            for path, (rollout, key) in zip(realised, _series(e), strict=True):
                data.insert(1, _curve(time, path[:, leg, axis], key))  # the dots of before over the line of after
                errors.append(1e3 * float(rollout.foot_rmse[0, leg, axis]))
            centre = float(low[leg] + high[leg]) / 2
            layout = _layout("time (s)", f"{'xyz'[axis]}, body frame (m)", 230, window, (centre - half, centre + half))
            layout["shapes"] = _shades(time, log.wanted[0, :, leg]) + _segment_lines(e)
            panels.append(Panel(f"{label} <small>RMS error {_arrow(errors, 1)} mm</small>", data, layout))
        rms = [1e3 * float(np.sqrt(np.mean(r.foot_rmse[0, :, axis] ** 2))) for r, _ in _series(e)]
        figures.append(
            Figure(
                name,
                f"{what}: RMS error {_arrow(rms, 1)} mm over the four feet",
                "Realised paths against the demonstration that the reward compares with, until a fall; the panels have"
                " one scale.",
                panels,
                4,
                (DEMONSTRATION, *_keys(e), STANCE),
            )
        )
    return figures


def gait(e: Episodes) -> Figure:
    """What the schedule wants of each leg, what its state machine decided, and whether the foot is loaded."""
    threshold = e.config.gait.release_threshold * e.robot.mass * GRAVITY
    rows = [
        Key("wanted by the motion", "var(--demo)", "fill"),
        Key("state machine: stance", "var(--after)", "fill"),
        Key("foot loaded", "var(--before)", "fill"),
    ]
    patterns = ("", "/", ".")
    shares: list[float] = []
    panels = []
    for rollout, key in _series(e):
        log = _log(rollout)
        alive = int(rollout.steps[0])
        loaded = log.observation["foot_force"][0, :, :, 2] > threshold
        data = []
        for source, row, pattern, word in zip(
            (log.wanted[0], log.stance[0], loaded), rows, patterns, ("wanted", "state", "loaded"), strict=True
        ):
            base, length, names = [], [], []
            for leg, label in enumerate(LEGS):
                for a, b in _intervals(source[:alive, leg]):
                    base.append(a / log.rate_hz)
                    length.append((b - a) / log.rate_hz)
                    names.append(f"{label} {word}")
            data.append(
                {
                    "type": "bar",
                    "orientation": "h",
                    "name": row.label,
                    "y": names,
                    "base": numbers(base),
                    "x": numbers(length),
                    "width": 0.72,
                    "marker": {
                        "color": row.color,
                        "line": {"width": 0},
                        "pattern": {
                            "shape": pattern,
                            "fillmode": "overlay",
                            "fgcolor": "var(--paper)",
                            "fgopacity": 0.6,
                            "size": 6,
                            "solidity": 0.2,
                        },
                    },
                    "hovertemplate": "%{y}: from %{base:.3f} s for %{x:.3f} s<extra></extra>",
                }
            )
        layout = _layout("time (s)", "", 330, first_window(e))
        order = [f"{leg} {word}" for leg in LEGS for word in ("wanted", "state", "loaded")]
        layout["yaxis"] |= {
            "categoryorder": "array",
            "categoryarray": order,
            "range": [len(order) - 0.4, -0.6],
            "showgrid": False,
            "tickmode": "linear",
            "dtick": 1,
            "type": "category",
        }
        layout["hovermode"] = "closest"
        layout["barmode"] = "overlay"
        layout["shapes"] = [*(_between_rows(3 * leg - 0.5) for leg in range(1, 4)), *_segment_lines(e)]
        shares.append(100 * float(np.mean(log.stance[0, :alive] == log.wanted[0, :alive])) if alive else 0.0)
        panels.append(Panel(_short(key) if key is not ONLY else "", data, layout))
    return Figure(
        "gait",
        f"Gait: the legs are in the state that the motion wants {_arrow(shares, 1)} % of the time",
        f"Three bars a leg. A foot counts as loaded above {100 * e.config.gait.release_threshold:g} % of the weight"
        f" ({threshold:.0f} N), below which the state machine takes it for free.",
        panels,
        len(panels),
        rows,
    )


def reward(e: Episodes) -> Figure:
    """The reward and its five terms over time."""
    panels = []
    for i, name in enumerate(("reward", *TERMS)):
        data: list[dict[str, Any]] = []
        means = []
        for rollout, key in _series(e):
            log = _log(rollout)
            values = log.reward[0] if i == 0 else log.terms[0, :, i - 1]
            data.insert(0, _curve(_time(log), values, key))
            means.append(float(rollout.reward[0] if i == 0 else rollout.terms[0, i - 1]))
        label = "Reward" if i == 0 else f"{name.replace('_', ' ').capitalize()}, weight {WEIGHTS[i - 1]:g}"
        lowest = min(v for d in data for v in d["y"] if v is not None)
        layout = _layout(
            "time (s)", "0 to 1", 210, whole_episode(e), yrange=(max(-0.02, lowest - 0.06 * (1 - lowest) - 0.01), 1.012)
        )
        layout["shapes"] = _segment_lines(e)
        panels.append(Panel(f"{label} <small>mean {_arrow(means, 3)}</small>", data, layout))
    falls = [
        f"{_short(key).lower()} falls after {rollout.steps[0] / _log(rollout).rate_hz:.2f} s"
        for rollout, key in _series(e)
        if rollout.fell[0]
    ]
    lowest_term = int(np.argmin(_series(e)[-1][0].terms[0] * np.array(WEIGHTS) - np.array(WEIGHTS)))
    seen = ", ".join(falls) or f"most is left to gain in the {TERMS[lowest_term].replace('_', ' ')} term"
    return Figure(
        "reward",
        f"Reward over time: {seen}",
        "The reward is the weighted sum of five terms, each 1 where the robot does exactly what the demonstration does;"
        " after a fall it is 0. The vertical scales differ.",
        panels,
        3,
        _keys(e),
    )


def limits(e: Episodes) -> list[Figure]:
    """Joint torque and joint speed against the motors' limits, two figures."""
    figures = []
    for name, title, unit, limit in (
        ("torque", "Motor torque", "N·m", e.robot.torque_limit),
        ("speed", "Joint speed", "rad/s", e.robot.joint_speed_limit),
    ):
        panels, used = [], [0.0 for _ in _series(e)]
        for j, joint in enumerate(JOINTS_PER_LEG):
            most = float(np.min(limit.reshape(4, 3)[:, j]))
            data: list[dict[str, Any]] = []
            peaks = []
            for i, (rollout, key) in enumerate(_series(e)):
                log = _log(rollout)
                values = motor_torque(log, limit) if name == "torque" else log.observation["joint_vel"][0].copy()
                values[rollout.steps[0] :] = np.nan
                largest = np.abs(values).reshape(-1, 4, 3)[:, :, j].max(axis=1)
                data.insert(0, _curve(_time(log), largest, key, peak=True))
                peaks.append(_greatest(largest))
                used[i] = float(np.fmax(used[i], peaks[-1] / most))
            layout = _layout(
                "time (s)", f"greatest of four ({unit})", 230, whole_episode(e), yrange=(0, 1.08 * max(most, *peaks))
            )
            layout["shapes"] = [_level(most, LIMIT), *_segment_lines(e)]
            panels.append(
                Panel(
                    f"{joint.capitalize()} <small>peak {_arrow(peaks, 1)}, limit {most:g} {unit}</small>", data, layout
                )
            )
        beyond = ", beyond it" if max(used) > 1.0 else ""
        how = (
            "Torque of the motor law at the start of each control step, cut off at the limit."
            if name == "torque"
            else "The simulation does not cut speeds off: above the limit a real motor would not follow."
        )
        figures.append(
            Figure(
                name,
                f"{title}: at most {_arrow([100 * u for u in used], 0)} % of the limit{beyond}",
                f"The greatest absolute value among the four legs. {how}",
                panels,
                3,
                (*_keys(e), LIMIT),
            )
        )
    return figures


def friction(e: Episodes) -> Figure:
    """Tangential over normal force of each loaded foot."""
    loaded = LOADED * e.robot.mass * GRAVITY
    assumed, ground = e.config.stance.friction, GROUND_FRICTION
    mu = Key(f"μ that the controller assumes, {assumed:g}", "var(--limit)", "dashdot")
    real = Key(f"μ of the simulated ground, {ground:g}", "var(--muted)", "dot")
    panels, top = [], []
    for leg, label in enumerate(LEGS):
        data: list[dict[str, Any]] = []
        typical = []
        for rollout, key in _series(e):
            log = _log(rollout)
            force = log.observation["foot_force"][0, :, leg]
            use = np.full(len(force), np.nan)
            on = force[:, 2] > loaded
            on[rollout.steps[0] :] = False
            use[on] = np.hypot(force[on, 0], force[on, 1]) / force[on, 2]
            data.insert(0, _curve(_time(log), use, key, peak=True))
            typical.append(float(np.nanpercentile(use, 95)) if on.any() else float("nan"))
        top.append(typical)
        layout = _layout("time (s)", "|f_xy| / f_z", 230, first_window(e), (0, 1.15 * max(assumed, ground)))
        layout["shapes"] = [_level(assumed, mu), _level(ground, real), *_segment_lines(e)]
        panels.append(Panel(f"{label} <small>95 % below {_arrow(typical, 2)}</small>", data, layout))
    worst = [_greatest(np.array(column)) for column in zip(*top, strict=True)]
    return Figure(
        "friction",
        f"Friction used: 95 % of the time below {_arrow(worst, 2)} on every foot, of μ {ground:g} that the ground has",
        f"Only feet that carry more than {100 * LOADED:g} % of the weight ({loaded:.0f} N); gaps are swings. Where a"
        " curve reaches the ground's μ the foot slides.",
        panels,
        4,
        (*_keys(e), mu, real),
    )


def solve_times(e: Episodes) -> Figure | None:
    """How long the controller planned ahead; None if it never did."""
    data, legend, medians, worst = [], [], [], []
    for rollout, key in _series(e):
        log = _log(rollout)
        at = np.flatnonzero(log.solve_time[0] > 0)
        if not len(at):
            return None
        ms = 1e3 * log.solve_time[0, at]
        shown = Key(key.label, key.color, "o" if key is BEFORE else "d")
        legend.append(shown)
        data.append(_points(numbers((at + 1) / log.rate_hz), numbers(ms), shown, "", size=5))
        medians.append(float(np.median(ms)))
        worst.append(float(np.percentile(ms, 99)))
    layout = _layout("time (s)", "solve time (ms)", 260, whole_episode(e))
    layout["yaxis"]["rangemode"] = "tozero"
    return Figure(
        "solve-times",
        f"Planning ahead takes {_arrow(medians, 2)} ms, 99 % below {_arrow(worst, 2)} ms",
        f"One point a plan, {e.config.horizon.solve_rate_hz:g} a second, measured while this page was made, on the"
        " machine that made it.",
        [Panel("", data, layout)],
        1,
        legend,
    )


def motor_torque(log: Log, limit: Array) -> Array:
    """Torque of the motors at the start of each control step (t, 12), N·m; NaN in the first, whose state is not logged.

    Args:
        log: of one episode or more; the first counts.
        limit: (12,) N·m.
    """
    command, seen = log.command[0], log.observation[0]
    torque = np.full(command["torque"].shape, np.nan)
    torque[1:] = (
        command["torque"][1:]
        + command["stiffness"][1:] * (command["joint_pos"][1:] - seen["joint_pos"][:-1])
        + command["damping"][1:] * (command["joint_vel"][1:] - seen["joint_vel"][:-1])
    )
    return np.asarray(np.clip(torque, -limit, limit))


def first_window(e: Episodes) -> tuple[float, float]:
    """The times that are shown at first, s: the last cycles before the end, or the first transition."""
    log = _log(e.before)
    total = log.wanted.shape[1] / log.rate_hz
    starts = e.motion.target.segment_starts
    if len(starts) > 1:
        start = max(0.0, starts[1] / log.rate_hz - TRANSITION_S / 2)
        return start, min(total, start + TRANSITION_S)
    alive = max(int(r.steps[0]) for r, _ in _series(e)) / log.rate_hz
    start = max(0.0, alive - CYCLES * e.motion.period_s)
    return start, max(alive, start + 0.1)


def whole_episode(e: Episodes) -> tuple[float, float]:
    """From 0 to the end of the episodes, s."""
    log = _log(e.before)
    return 0.0, log.wanted.shape[1] / log.rate_hz


def _series(e: Episodes) -> list[tuple[Rollout, Key]]:
    return [(e.before, ONLY)] if e.after is None else [(e.before, BEFORE), (e.after, AFTER)]


def _keys(e: Episodes) -> tuple[Key, ...]:
    return tuple(key for _, key in _series(e))


def _short(key: Key) -> str:
    return "The robot" if key is ONLY else key.label.split(":")[0].capitalize()


def _log(rollout: Rollout) -> Log:
    assert rollout.log is not None, "the plots need rollouts with their logs"
    return rollout.log


def _time(log: Log) -> Array:
    """(t,) s, of the states after each step."""
    return np.arange(1, log.wanted.shape[1] + 1) / log.rate_hz


def _greatest(values: Array) -> float:
    """Of those that are finite; NaN if none is, as where a robot fell at once."""
    found = values[np.isfinite(values)]
    return float(found.max()) if found.size else float("nan")


def _arrow(values: Sequence[float], digits: int) -> str:
    return " → ".join(f"{v:.{digits}f}" if np.isfinite(v) else "–" for v in values)


def _curve(time: Array, values: Array, key: Key, *, peak: bool = False) -> dict[str, Any]:
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
    return _line(numbers(time[::stride]), kept, key, width=1.7)


def _line(x: Any, y: Any, key: Key, *, width: float = 2.0, **more: Any) -> dict[str, Any]:
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


def _points(x: Sequence[Any], y: Sequence[Any], key: Key, unit: str, *, size: int = 10) -> dict[str, Any]:
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


def _layout(
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


def _intervals(on: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """First index and end of each stretch of True."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], on.astype(np.int8), [0]])))
    return [(int(a), int(b)) for a, b in edges.reshape(-1, 2)]


def _shades(time: Array, stance: NDArray[np.bool_]) -> list[dict[str, Any]]:
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
        for a, b in _intervals(stance)
    ]


def _level(value: float, key: Key) -> dict[str, Any]:
    line = {"color": key.color, "dash": key.dash, "width": 1.6}
    return {"type": "line", "xref": "paper", "yref": "y", "x0": 0, "x1": 1, "y0": value, "y1": value, "line": line}


def _between_rows(y: float) -> dict[str, Any]:
    line = {"color": "var(--line)", "width": 1}
    return {"type": "line", "xref": "paper", "yref": "y", "x0": 0, "x1": 1, "y0": y, "y1": y, "line": line}


def _segment_lines(e: Episodes) -> list[dict[str, Any]]:
    """Where a stitched motion passes from one segment to the next."""
    line = {"color": "var(--muted)", "dash": "dash", "width": 1}
    rate = _log(e.before).rate_hz
    return [
        {"type": "line", "xref": "x", "yref": "paper", "x0": s / rate, "x1": s / rate, "y0": 0, "y1": 1, "line": line}
        for s in e.motion.target.segment_starts
        if s
    ]
