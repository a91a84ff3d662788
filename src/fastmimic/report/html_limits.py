"""The plots of torque, speed, friction and planning time."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Final

import numpy as np

from fastmimic.base.arrays import Array
from fastmimic.base.conventions import GRAVITY, JOINTS_PER_LEG, LEGS
from fastmimic.episode.rollout import Log
from fastmimic.report.html_plots import (
    BEFORE,
    LIMIT,
    Figure,
    Key,
    Plot,
    arrow,
    curve,
    first_window,
    greatest,
    keys,
    layout_of,
    log_of,
    numbers,
    points,
    rule,
    segment_lines,
    series,
    times,
    whole_episode,
)
from fastmimic.report.html_run import RerunEpisodes
from fastmimic.simulation.mujoco_sim import GROUND_FRICTION

LOADED: Final = 0.05  # share of the robot's weight above which friction is plotted


def limits(e: RerunEpisodes) -> list[Figure]:
    """Joint torque and joint speed against the motors' limits, two figures."""
    torques, speeds = [], []
    for rollout, key in series(e):
        log, alive = log_of(rollout), rollout.steps[0]
        torque, speed = motor_torque(log, e.robot.torque_limit), log.observation["joint_vel"][0].copy()
        torque[alive:] = speed[alive:] = np.nan
        torques.append((times(log), torque, key))
        speeds.append((times(log), speed, key))
    span, shapes = whole_episode(e), segment_lines(e)
    return [
        against_limit(
            ("torque", "Motor torque", "N·m"),
            torques,
            e.robot.torque_limit,
            span,
            "Torque of the motor law at the start of each control step, cut off at the limit.",
            shapes,
        ),
        against_limit(
            ("speed", "Joint speed", "rad/s"),
            speeds,
            e.robot.joint_speed_limit,
            span,
            "The simulation does not cut speeds off: above the limit a real motor would not follow.",
            shapes,
        ),
    ]


def against_limit(
    names: tuple[str, str, str],
    found: Sequence[tuple[Array, Array, Key]],
    limit: Array,
    span: tuple[float, float],
    hint: str = "",
    shapes: Sequence[dict[str, Any]] = (),
) -> Figure:
    """The greatest value of the four legs, joint by joint, against the motors' limits.

    Args:
        names: id and title of the figure, and unit of the values.
        found: of each series the times (t,), s, the values (t, 12), and its style.
        limit: (12,).
        span: times shown, s.
        hint: additional text.
        shapes: drawn in each plot.
    """
    name, title, unit = names
    plots, used = [], [0.0] * len(found)
    for j, joint in enumerate(JOINTS_PER_LEG):
        most = float(np.min(np.reshape(limit, (4, 3))[:, j]))
        data: list[dict[str, Any]] = []
        peaks = []
        for i, (time, values, key) in enumerate(found):
            largest = np.abs(values).reshape(-1, 4, 3)[:, :, j].max(axis=1)
            data.insert(0, curve(time, largest, key, peak=True))
            peaks.append(greatest(largest))
            used[i] = float(np.fmax(used[i], peaks[-1] / most))
        layout = layout_of("time (s)", f"greatest of four ({unit})", 230, span, (0, 1.08 * max(most, *peaks)))
        layout["shapes"] = [rule(LIMIT, y=most), *shapes]
        plots.append(Plot(joint.capitalize(), data, layout, f"peak {arrow(peaks, 1)}, limit {most:g} {unit}"))
    beyond = ", beyond it" if max(used) > 1.0 else ""
    return Figure(
        name,
        f"{title}: at most {arrow([100 * u for u in used], 0)} % of the limit{beyond}",
        f"The greatest absolute value among the four legs. {hint}".strip(),
        plots,
        3,
        (*(key for *_, key in found), LIMIT),
    )


def friction(e: RerunEpisodes) -> Figure:
    """Tangential over normal force of each loaded foot."""
    loaded = LOADED * e.robot.mass * GRAVITY
    assumed, ground = e.config.stance.friction, GROUND_FRICTION
    mu = Key(f"μ that the controller assumes, {assumed:g}", "var(--limit)", "dashdot")
    real = Key(f"μ of the simulated ground, {ground:g}", "var(--muted)", "dot")
    plots, top = [], []
    for leg, label in enumerate(LEGS):
        data: list[dict[str, Any]] = []
        typical = []
        for rollout, key in series(e):
            log = log_of(rollout)
            force = log.observation["foot_force"][0, :, leg]
            use = np.full(len(force), np.nan)
            on = force[:, 2] > loaded
            on[rollout.steps[0] :] = False
            use[on] = np.hypot(force[on, 0], force[on, 1]) / force[on, 2]
            data.insert(0, curve(times(log), use, key, peak=True))
            typical.append(float(np.nanpercentile(use, 95)) if on.any() else float("nan"))
        top.append(typical)
        highest = 1.15 * max(assumed, ground)
        layout = layout_of("time (s)", "tangential / normal force", 230, first_window(e), (0, highest))
        layout["shapes"] = [rule(mu, y=assumed), rule(real, y=ground), *segment_lines(e)]
        plots.append(Plot(label, data, layout, f"95 % below {arrow(typical, 2)}"))
    worst = [greatest(np.array(column)) for column in zip(*top, strict=True)]
    return Figure(
        "friction",
        f"Friction use: {arrow(worst, 2)} at most for 95 % of the time on any foot; the ground has μ {ground:g}",
        f"Only feet that carry more than {100 * LOADED:g} % of the weight ({loaded:.0f} N); gaps are swings. Where a"
        " curve reaches the ground's μ the foot slides.",
        plots,
        4,
        (*keys(e), mu, real),
    )


def solve_times(e: RerunEpisodes) -> Figure | None:
    """Duration of planning ahead; None without any."""
    data, legend, medians, worst = [], [], [], []
    for rollout, key in series(e):
        log = log_of(rollout)
        at = np.flatnonzero(log.solve_time[0] > 0)
        if not len(at):
            return None
        ms = 1e3 * log.solve_time[0, at]
        symbol, size = ("circle-open", 7.5) if key is BEFORE else ("diamond", 5.0)
        legend.append(replace(key, symbol=symbol))
        data.append(points(numbers((at + 1) / log.rate_hz), numbers(ms), legend[-1], "%{y}: %{x:.4g}", size=size))
        medians.append(float(np.median(ms)))
        worst.append(float(np.percentile(ms, 99)))
    layout = layout_of("time (s)", "solve time (ms)", 260, whole_episode(e))
    layout["yaxis"]["type"] = "log"
    return Figure(
        "solve-times",
        f"Planning ahead takes {arrow(medians, 2)} ms in the median, 99 % stay below {arrow(worst, 2)} ms",
        f"One point a plan, {e.config.horizon.solve_rate_hz:g} a second, measured while this page was made, on the"
        " machine that made it.",
        [Plot("", data, layout)],
        1,
        legend,
    )


def motor_torque(log: Log, limit: Array) -> Array:
    """Torque of the motors, limited to (12,) N·m, at the start of each control step of the first episode: (t, 12), N·m;
    NaN in the first step, where the state is not logged."""
    command, seen = log.command[0], log.observation[0]
    torque = np.full(command["torque"].shape, np.nan)
    torque[1:] = (
        command["torque"][1:]
        + command["stiffness"][1:] * (command["joint_pos"][1:] - seen["joint_pos"][:-1])
        + command["damping"][1:] * (command["joint_vel"][1:] - seen["joint_vel"][:-1])
    )
    return np.asarray(np.clip(torque, -limit, limit))
