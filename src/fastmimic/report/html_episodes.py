"""The plots of an episode: feet, gait, reward."""

from typing import Any

import numpy as np

from fastmimic.base.conventions import LEGS
from fastmimic.episode.metrics import swing_clearance
from fastmimic.episode.reward import REWARD_TERMS, reward_weights
from fastmimic.render.tracks import realised_feet
from fastmimic.report.html_plots import (
    DEMONSTRATION,
    ONLY,
    STANCE,
    Figure,
    Key,
    Plot,
    arrow,
    bar_marker,
    curve,
    first_window,
    intervals,
    keys,
    layout_of,
    line,
    log_of,
    numbers,
    rows_axis,
    rule,
    segment_lines,
    series,
    shades,
    short,
    times,
    whole_episode,
)
from fastmimic.report.html_run import RerunEpisodes


def feet(e: RerunEpisodes) -> list[Figure]:
    """Height and fore-aft position of the four feet, two figures."""
    log = log_of(e.before)
    time = times(log)
    window = first_window(e)
    shown = (time >= window[0]) & (time <= window[1])
    wanted = log.demonstration["foot_pos"][0]
    realised = [realised_feet(r, e.robot) for r, _ in series(e)]
    figures = []
    for axis, name, what in ((2, "foot-z", "Foot height"), (0, "foot-x", "Fore-aft position of the feet")):
        values = np.concatenate([wanted[shown], *(f[shown] for f in realised)])[:, :, axis]
        low, high = np.nanmin(values, axis=0), np.nanmax(values, axis=0)
        half = 0.56 * max(float(np.max(high - low)), 0.01)
        plots = []
        for leg, label in enumerate(LEGS):
            data = [curve(time, wanted[:, leg, axis], DEMONSTRATION)]
            errors = []
            for path, (rollout, key) in zip(realised, series(e), strict=True):
                data.insert(1, curve(time, path[:, leg, axis], key))  # the dots of before over the line of after
                errors.append(1e3 * float(rollout.foot_rmse[0, leg, axis]))
            centre = float(low[leg] + high[leg]) / 2
            layout = layout_of(
                "time (s)", f"{'xyz'[axis]}, body frame (m)", 230, window, (centre - half, centre + half)
            )
            layout["shapes"] = shades(time, log.wanted[0, :, leg]) + segment_lines(e)
            plots.append(Plot(label, data, layout, f"RMS error {arrow(errors, 1)} mm"))
        rms = [1e3 * float(np.sqrt(np.mean(r.foot_rmse[0, :, axis] ** 2))) for r, _ in series(e)]
        figures.append(
            Figure(
                name,
                f"{what}: RMS error {arrow(rms, 1)} mm over the four feet",
                "Realised paths against the demonstration that the reward compares with, until a fall; the panels have"
                " one scale.",
                plots,
                4,
                (DEMONSTRATION, *keys(e), STANCE),
            )
        )
    return figures


def paths(e: RerunEpisodes) -> Figure:
    """The feet from the side: fore-aft position against height."""
    log = log_of(e.before)
    time = times(log)
    window = first_window(e)
    shown = (time >= window[0]) & (time <= window[1])
    wanted = log.demonstration["foot_pos"][0]
    realised = [realised_feet(rollout, e.robot) for rollout, _ in series(e)]
    lifted = swing_clearance(e.motion.target, e.robot.foot_radius)
    plots = []
    shares: list[list[float]] = []
    for leg, label in enumerate(LEGS):
        drawn = [(wanted, DEMONSTRATION), *zip(reversed(realised), reversed(keys(e)), strict=True)]
        data = [
            line(
                numbers(path[shown, leg, 0]),
                path[shown, leg, 2],
                key,
                width=1.7,
                hovertemplate="x %{x:.3f} m, z %{y:.3f} m",
            )
            for path, key in drawn
        ]
        layout = layout_of("x, body frame (m)", "z, body frame (m)", 230)
        layout["hovermode"] = "closest"
        share = [100 * float(rollout.clearance[0, leg] / lifted[leg]) for rollout, _ in series(e)]
        shares.append(share)
        plots.append(Plot(label, data, layout, f"lifted {arrow(share, 0)} %"))
    least = [float(np.nanmin(s)) if np.isfinite(s).any() else float("nan") for s in np.array(shares).T]
    return Figure(
        "paths",
        f"Feet from the side: every foot is lifted at least {arrow(least, 0)} % as high as in the demonstration",
        f"{'From the first posture to the last' if e.done_once else 'One loop a cycle'}. What the animal's step looks"
        " like is its shape; a motion that is only shuffled is flat. The scales of x and z differ.",
        plots,
        4,
        (DEMONSTRATION, *keys(e)),
    )


def gait(e: RerunEpisodes) -> Figure:
    """Each leg's contact schedule, gait planner state, and measured load."""
    threshold = e.config.release_force(e.robot)
    rows = [
        Key("wanted by the motion", "var(--demo)", pattern=""),
        Key("state machine: stance", "var(--after)", pattern="/"),
        Key("foot loaded", "var(--before)", pattern="."),
    ]
    words = ("wanted", "state", "loaded")
    border = Key("", "var(--line)")
    shares: list[float] = []
    plots = []
    for rollout, key in series(e):
        log = log_of(rollout)
        alive = int(rollout.steps[0])
        loaded = log.observation["foot_force"][0, :, :, 2] > threshold
        data = []
        for source, row, word in zip((log.wanted[0], log.stance[0], loaded), rows, words, strict=True):
            base, length, names = [], [], []
            for leg, label in enumerate(LEGS):
                for a, b in intervals(source[:alive, leg]):
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
                    "marker": bar_marker(row, fgopacity=0.6, size=6, solidity=0.2),
                    "hovertemplate": "%{y}: from %{base:.3f} s for %{x:.3f} s<extra></extra>",
                }
            )
        layout = layout_of("time (s)", "", 330, first_window(e))
        order = [f"{leg} {word}" for leg in LEGS for word in words]
        layout["yaxis"] |= {**rows_axis(order), "showgrid": False}
        layout["hovermode"] = "closest"
        layout["barmode"] = "overlay"
        layout["shapes"] = [*(rule(border, y=3 * leg - 0.5, width=1) for leg in range(1, 4)), *segment_lines(e)]
        shares.append(100 * float(np.mean(log.stance[0, :alive] == log.wanted[0, :alive])) if alive else 0.0)
        plots.append(Plot(short(key) if key is not ONLY else "", data, layout))
    return Figure(
        "gait",
        f"Gait: the legs are in the state that the motion wants {arrow(shares, 1)} % of the time",
        f"Three bars a leg. A foot counts as loaded above {100 * e.config.gait.release_threshold:g} % of the weight"
        f" ({threshold:.0f} N), below which the state machine takes it for free.",
        plots,
        len(plots),
        rows,
    )


def reward(e: RerunEpisodes) -> Figure:
    """The reward and its five terms over time."""
    plots = []
    weights = reward_weights()
    for i, name in enumerate(("reward", *REWARD_TERMS)):
        data: list[dict[str, Any]] = []
        means = []
        for rollout, key in series(e):
            log = log_of(rollout)
            values = log.reward[0] if i == 0 else log.terms[0, :, i - 1]
            data.insert(0, curve(times(log), values, key))
            means.append(float(rollout.reward[0] if i == 0 else rollout.terms[0, i - 1]))
        label = "Reward" if i == 0 else f"{name.replace('_', ' ').capitalize()}, weight {weights[i - 1]:g}"
        lowest = min(v for d in data for v in d["y"] if v is not None)
        layout = layout_of(
            "time (s)",
            "reward (0 to 1)" if i == 0 else "term (0 to 1)",
            210,
            whole_episode(e),
            yrange=(max(-0.02, lowest - 0.06 * (1 - lowest) - 0.01), 1.012),
        )
        layout["shapes"] = segment_lines(e)
        plots.append(Plot(label, data, layout, f"mean {arrow(means, 3)}"))
    falls = [
        f"{short(key).lower()} falls after {rollout.steps[0] / log_of(rollout).rate_hz:.2f} s"
        for rollout, key in series(e)
        if rollout.fell[0]
    ]
    lowest_term = int(np.argmin(series(e)[-1][0].terms[0] * weights - weights))
    seen = ", ".join(falls) or f"most is left to gain in the {list(REWARD_TERMS.values())[lowest_term].label} term"
    return Figure(
        "reward",
        f"Reward over time: {seen}",
        "The reward is the weighted sum of its terms, each 1 where the robot does exactly what the demonstration does;"
        " after a fall it is 0. The vertical scales differ.",
        plots,
        3,
        keys(e),
    )
