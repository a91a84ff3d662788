"""The plots of an episode: feet, gait, reward, and the load on the motors."""

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from fastmimic.base.arrays import Array, Flags, stretches
from fastmimic.base.conventions import GRAVITY, GROUND_FRICTION, JOINTS_PER_LEG, LEGS
from fastmimic.episode.metrics import swing_clearance
from fastmimic.episode.reward import REWARD_TERMS, reward_weights
from fastmimic.episode.rollout import Log
from fastmimic.experiments.measurement import foot_courses
from fastmimic.report import html_page as draw
from fastmimic.report.html_page import BEFORE, DEMONSTRATION, LIMIT, ONLY, STANCE, Figure, Key, Plot, arrow, numbers
from fastmimic.robot.state import commanded_torque

if TYPE_CHECKING:
    from fastmimic.report.html_run import RerunEpisodes

LOADED: Final = 0.05  # share of the robot's weight above which friction is plotted


def feet(e: "RerunEpisodes") -> list[Figure]:
    """Height and fore-aft position of the four feet, two figures."""
    time, shown = e.times, _shown(e)
    drawn = _paths(e)
    figures = []
    for axis, name, what in ((2, "foot-z", "Foot height"), (0, "foot-x", "Fore-aft position of the feet")):
        values = np.concatenate([path[shown] for path, _ in drawn])[:, :, axis]
        low, high = np.nanmin(values, axis=0), np.nanmax(values, axis=0)
        half = 0.56 * max(float(np.max(high - low)), 0.01)
        plots = []
        for leg, label in enumerate(LEGS):
            errors = [1e3 * float(rollout.foot_rmse[0, leg, axis]) for rollout, *_ in e.series]
            centre = float(low[leg] + high[leg]) / 2
            plot = draw.time_plot(
                label,
                f"{'xyz'[axis]}, body frame (m)",
                time,
                [(path[:, leg, axis], key) for path, key in drawn],
                e.first_window,
                (centre - half, centre + half),
                shapes=[*draw.shades(time, e.log.wanted[0, :, leg]), *e.segment_lines],
                note=f"RMS error {arrow(errors, 1)} mm",
            )
            plots.append(plot)
        rms = [1e3 * float(np.sqrt(np.mean(rollout.foot_rmse[0, :, axis] ** 2))) for rollout, *_ in e.series]
        title = f"{what}: RMS error {arrow(rms, 1)} mm over the four feet"
        figures.append(Figure(name, title, plots, 4, (DEMONSTRATION, *e.keys, STANCE)))
    return figures


def _paths(e: "RerunEpisodes") -> list[tuple[Array, Key]]:
    """Realised paths of the feet and the demonstration's, (t, 4, 3) m, the first on top."""
    realised = [(foot_courses(rollout, e.robot)[1], key) for rollout, _, key in e.series]
    return [*realised, (e.log.demonstration["foot_pos"][0], DEMONSTRATION)]


def _shown(e: "RerunEpisodes") -> Flags:
    start, end = e.first_window
    return (e.times >= start) & (e.times <= end)


def paths(e: "RerunEpisodes") -> Figure:
    """The feet from the side: fore-aft position against height."""
    shown, drawn = _shown(e), _paths(e)
    lifted = swing_clearance(e.motion.target, e.robot.foot_radius)
    plots = []
    shares: list[list[float]] = []
    for leg, label in enumerate(LEGS):
        hover = "x %{x:.3f} m, z %{y:.3f} m"
        data = [
            draw.line(numbers(path[shown, leg, 0]), path[shown, leg, 2], key, width=1.7, hovertemplate=hover)
            for path, key in reversed(drawn)
        ]
        layout = draw.layout_of("x, body frame (m)", "z, body frame (m)", 230, hovermode="closest")
        share = [100 * float(rollout.clearance[0, leg] / lifted[leg]) for rollout, *_ in e.series]
        shares.append(share)
        plots.append(Plot(label, data, layout, f"lifted {arrow(share, 0)} %"))
    least = [float(np.nanmin(s)) if np.isfinite(s).any() else float("nan") for s in np.array(shares).T]
    title = f"Feet from the side: every foot is lifted at least {arrow(least, 0)} % as high as in the demonstration"
    told = {"course": "From the first posture to the last" if e.done_once else "One loop a cycle"}
    return Figure("paths", title, plots, 4, (DEMONSTRATION, *e.keys), told=told)


def gait(e: "RerunEpisodes") -> Figure:
    """Each leg's contact schedule, gait planner state, and measured load."""
    threshold = e.config.release_force(e.robot)
    rows = {
        "wanted": Key("wanted by the motion", "var(--demo)", pattern=""),
        "state": Key("state machine: stance", "var(--after)", pattern="/"),
        "loaded": Key("foot loaded", "var(--before)", pattern="."),
    }
    border = Key("", "var(--line)")
    shares: list[float] = []
    plots = []
    for rollout, log, key in e.series:
        alive = int(rollout.steps[0])
        loaded = log.observation["foot_force"][0, :, :, 2] > threshold
        data = []
        for source, (word, row) in zip((log.wanted[0], log.stance[0], loaded), rows.items(), strict=True):
            found = [(leg, *span) for leg in range(4) for span in stretches(source[:alive, leg])]
            data.append(
                {
                    "type": "bar",
                    "orientation": "h",
                    "name": row.label,
                    "y": [f"{LEGS[leg]} {word}" for leg, *_ in found],
                    "base": numbers([a / log.rate_hz for _, a, _ in found]),
                    "x": numbers([(b - a) / log.rate_hz for _, a, b in found]),
                    "width": 0.72,
                    "marker": draw.bar_marker(row, fgopacity=0.6, size=6, solidity=0.2),
                    "hovertemplate": "%{y}: from %{base:.3f} s for %{x:.3f} s<extra></extra>",
                }
            )
        borders = [draw.rule(border, y=3 * leg - 0.5, width=1) for leg in range(1, 4)]
        layout = draw.layout_of("time (s)", "", 330, e.first_window, hovermode="closest", barmode="overlay")
        layout["shapes"] = [*borders, *e.segment_lines]
        layout["yaxis"] |= {**draw.rows_axis([f"{leg} {word}" for leg in LEGS for word in rows]), "showgrid": False}
        shares.append(100 * float(np.mean(log.stance[0, :alive] == log.wanted[0, :alive])) if alive else 0.0)
        plots.append(Plot("" if key is ONLY else _short(key), data, layout))
    title = f"Gait: the legs are in the state that the motion wants {arrow(shares, 1)} % of the time"
    told = {"share": 100 * e.config.gait.release_threshold, "force": threshold}
    return Figure("gait", title, plots, len(plots), tuple(rows.values()), told=told)


def reward(e: "RerunEpisodes") -> Figure:
    """The reward and its five terms over time."""
    plots = []
    weights = reward_weights()
    for i, name in enumerate(("reward", *REWARD_TERMS)):
        found = [(log.reward[0] if i == 0 else log.terms[0, :, i - 1], key) for _, log, key in e.series]
        means = [float(rollout.reward[0] if i == 0 else rollout.terms[0, i - 1]) for rollout, *_ in e.series]
        plot = draw.time_plot(
            "Reward" if i == 0 else f"{name.replace('_', ' ').capitalize()}, weight {weights[i - 1]:g}",
            "reward (0 to 1)" if i == 0 else "term (0 to 1)",
            e.times,
            found,
            e.whole_episode,
            height=210,
            shapes=e.segment_lines,
            note=f"mean {arrow(means, 3)}",
        )
        lowest = min(v for curve in plot.data for v in curve["y"] if v is not None)
        plot.layout["yaxis"]["range"] = numbers((max(-0.02, lowest - 0.06 * (1 - lowest) - 0.01), 1.012))
        plots.append(plot)
    falls = [
        f"{_short(key).lower()} falls after {rollout.steps[0] / log.rate_hz:.2f} s"
        for rollout, log, key in e.series
        if rollout.fell[0]
    ]
    lowest_term = int(np.argmin(e.series[-1][0].terms[0] * weights - weights))
    seen = ", ".join(falls) or f"most is left to gain in the {list(REWARD_TERMS.values())[lowest_term].label} term"
    return Figure("reward", f"Reward over time: {seen}", plots, 3, e.keys)


def _short(key: Key) -> str:
    return "The robot" if key is ONLY else key.label.split(":")[0].capitalize()


def limits(e: "RerunEpisodes") -> list[Figure]:
    """Joint torque and joint speed against the motors' limits, two figures."""
    torques, speeds = [], []
    for rollout, log, key in e.series:
        alive = rollout.steps[0]
        torque, speed = motor_torque(log, e.robot.torque_limit), log.observation["joint_vel"][0].copy()
        torque[alive:] = speed[alive:] = np.nan
        torques.append((torque, key))
        speeds.append((speed, key))
    place, robot = (e.whole_episode, e.segment_lines), e.robot
    return [
        against_limit("torque", "Motor torque", "N·m", e.times, torques, robot.torque_limit, *place),
        against_limit("speed", "Joint speed", "rad/s", e.times, speeds, robot.joint_speed_limit, *place),
    ]


def against_limit(
    name: str,
    title: str,
    unit: str,
    time: Array,
    found: Sequence[tuple[Array, Key]],
    limit: Array,
    span: tuple[float, float],
    shapes: Sequence[dict[str, Any]] = (),
    about: str = "",
) -> Figure:
    """The greatest value of the four legs, joint by joint, against the motors' `limit` (12,). `found` are the values
    (t, 12) of each series at `time` (t,), s, and its style; `span` are the times shown, s."""
    plots, used = [], [0.0] * len(found)
    for j, joint in enumerate(JOINTS_PER_LEG):
        most = float(np.min(np.reshape(limit, (4, 3))[:, j]))
        largest = [(np.abs(values).reshape(-1, 4, 3)[:, :, j].max(axis=1), key) for values, key in found]
        peaks = [draw.greatest(values) for values, _ in largest]
        used = [float(np.fmax(before, peak / most)) for before, peak in zip(used, peaks, strict=True)]
        plot = draw.time_plot(
            joint.capitalize(),
            f"greatest of four ({unit})",
            time,
            largest,
            span,
            (0, 1.08 * max(most, *peaks)),
            shapes=[draw.rule(LIMIT, y=most), *shapes],
            note=f"peak {arrow(peaks, 1)}, limit {most:g} {unit}",
            peak=True,
        )
        plots.append(plot)
    beyond = ", beyond it" if max(used) > 1.0 else ""
    title += f": at most {arrow([100 * u for u in used], 0)} % of the limit{beyond}"
    return Figure(name, title, plots, 3, (*(key for _, key in found), LIMIT), about)


def friction(e: "RerunEpisodes") -> Figure:
    """Tangential over normal force of each loaded foot."""
    loaded = LOADED * e.robot.mass * GRAVITY
    assumed, ground = e.config.stance.friction, GROUND_FRICTION
    mu = Key(f"μ that the controller assumes, {assumed:g}", "var(--limit)", "dashdot")
    real = Key(f"μ of the simulated ground, {ground:g}", "var(--muted)", "dot")
    plots, top = [], []
    for leg, label in enumerate(LEGS):
        found, typical = [], []
        for rollout, log, key in e.series:
            force = log.observation["foot_force"][0, :, leg]
            use = np.full(len(force), np.nan)
            on = force[:, 2] > loaded
            on[rollout.steps[0] :] = False
            use[on] = np.hypot(force[on, 0], force[on, 1]) / force[on, 2]
            found.append((use, key))
            typical.append(float(np.nanpercentile(use, 95)) if on.any() else float("nan"))
        top.append(typical)
        plot = draw.time_plot(
            label,
            "tangential / normal force",
            e.times,
            found,
            e.first_window,
            (0, 1.15 * max(assumed, ground)),
            shapes=[draw.rule(mu, y=assumed), draw.rule(real, y=ground), *e.segment_lines],
            note=f"95 % below {arrow(typical, 2)}",
            peak=True,
        )
        plots.append(plot)
    worst = [draw.greatest(np.array(column)) for column in zip(*top, strict=True)]
    title = f"Friction use: {arrow(worst, 2)} at most for 95 % of the time on any foot; the ground has μ {ground:g}"
    return Figure("friction", title, plots, 4, (*e.keys, mu, real), told={"share": 100 * LOADED, "force": loaded})


def solve_times(e: "RerunEpisodes") -> list[Figure]:
    """Duration of planning ahead; none without any."""
    data, legend, medians, worst = [], [], [], []
    for _, log, key in e.series:
        at = np.flatnonzero(log.solve_time[0] > 0)
        if not len(at):
            return []
        ms = 1e3 * log.solve_time[0, at]
        symbol, size = ("circle-open", 7.5) if key is BEFORE else ("diamond", 5.0)
        legend.append(replace(key, symbol=symbol))
        data.append(draw.points(numbers((at + 1) / log.rate_hz), numbers(ms), legend[-1], "%{y}: %{x:.4g}", size=size))
        medians.append(float(np.median(ms)))
        worst.append(float(np.percentile(ms, 99)))
    layout = draw.layout_of("time (s)", "solve time (ms)", 260, e.whole_episode)
    layout["yaxis"]["type"] = "log"
    title = f"Planning ahead takes {arrow(medians, 2)} ms in the median, 99 % stay below {arrow(worst, 2)} ms"
    told = {"rate": e.config.horizon.solve_rate_hz}
    return [Figure("solve-times", title, [Plot("", data, layout)], 1, legend, told=told)]


def motor_torque(log: Log, limit: Array) -> Array:
    """Torque of the motors, limited to (12,) N·m, at the start of each control step of the first episode: (t, 12), N·m;
    NaN in the first step, where the state is not logged."""
    command, seen = log.command[0], log.observation[0]
    torque = np.full(command["torque"].shape, np.nan)
    torque[1:] = commanded_torque(command[1:], seen["joint_pos"][:-1], seen["joint_vel"][:-1])
    return np.asarray(np.clip(torque, -limit, limit))
