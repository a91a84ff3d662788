"""The figures of what a robot did: gait, reward, load on motors and feet; of a deployment also its timing."""

from collections.abc import Mapping, Sequence
from itertools import product
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from fastmimic.base.arrays import Array, Flags, stretches
from fastmimic.base.conventions import GRAVITY, GROUND_FRICTION, LEGS
from fastmimic.control.config import ControllerConfig
from fastmimic.deploy.log import DeploymentLog
from fastmimic.deploy.state_machine import DeploymentPhase
from fastmimic.episode.reward import REWARD_TERMS, reward_weights
from fastmimic.episode.rollout import Log, Rollout
from fastmimic.render import figure_style as style
from fastmimic.render.figure_style import AFTER, BEFORE, DEMONSTRATION, LIMIT, Line
from fastmimic.robot import Robot
from fastmimic.robot.state import commanded_torque

_LOADED: Final = 0.05  # share of the robot's weight above which friction is drawn
_TYPICAL: Final = 95  # percentile of friction that is written above it

Curve = tuple[Array, Line, str]  # values (t,), how they are drawn, and their name


def episode_figure(
    robot: Robot,
    config: ControllerConfig,
    rollouts: Mapping[str, Rollout],
    window_s: tuple[float, float],
    title: str,
    borders_s: Sequence[float] = (),
) -> Figure:
    """The gait of the last of the logged `rollouts` by name, at the times `window_s`, s; and over the whole episodes,
    until a fall, their rewards, the reward's terms, and how much of torque, joint speed and friction they use. Lines
    are drawn at `borders_s`, s, between the segments of a stitched motion. Means count steps after a fall as 0."""
    figure = style.new_figure(14.0, 11.0, title, below=0.7)
    terms = list(REWARD_TERMS)
    rows: list[Any] = [["reward", *terms[:2]], terms[2:], ["torque", "joint speed", "friction"]]
    panels: dict[str, Axes] = figure.subplot_mosaic([["gait"] * 3, *rows])
    last = list(rollouts.values())[-1]
    _draw_gait(panels["gait"], robot, config, last, window_s)
    time = np.arange(1, last.course.wanted.shape[1] + 1) / last.course.rate_hz
    curves: dict[str, list[Curve]] = {name: [] for row in rows for name in row}
    for (name, rollout), line in zip(rollouts.items(), (BEFORE, AFTER)[-len(rollouts) :], strict=True):
        for key, values in _curves(robot, rollout).items():
            values[rollout.steps[0] :] = np.nan
            curves[key].append((values, line, name))
    _draw(
        panels["reward"], time, curves["reward"], f"reward: mean {_arrow([r.reward[0] for r in rollouts.values()], 3)}"
    )
    for i, (key, weight) in enumerate(zip(terms, reward_weights(), strict=True)):
        means = _arrow([rollout.terms[0, i] for rollout in rollouts.values()], 3)
        _draw(panels[key], time, curves[key], f"{key.replace('_', ' ')}, weight {weight:g}: mean {means}")
    for key in ("torque", "joint speed"):
        most = _each(curves[key], np.nanmax, 2)
        _draw(panels[key], time, curves[key], f"{key}, share of the limit: at most {most}", limit=1.0)
    usual = _each(curves["friction"], lambda values: np.nanpercentile(values, _TYPICAL), 2)
    said = f"friction used: {_TYPICAL} % below {usual}, ground {GROUND_FRICTION:g}"
    _draw(panels["friction"], time, curves["friction"], said, limit=GROUND_FRICTION)
    for name in rows[-1]:
        panels[name].set_xlabel("time (s)", fontsize=9, color=style.MUTED)
    for axes, border in product(panels.values(), borders_s):
        axes.axvline(border, color=style.MUTED, linestyle="dashed", linewidth=0.8)
    handles = panels["gait"].get_legend_handles_labels()[0]
    style.legend_below(figure, panels["torque"], handles)
    return figure


def _curves(robot: Robot, rollout: Rollout) -> dict[str, Array]:
    """(t,) of each panel: the reward and its terms; the greatest share of the joints' limits; tangential over normal
    force of the loaded foot that needs most friction, NaN without any."""
    log = rollout.course
    torque = np.abs(motor_torque(log, robot.torque_limit)) / robot.torque_limit
    speed = np.abs(log.observation["joint_vel"][0]) / robot.joint_speed_limit
    force = log.observation["foot_force"][0]
    loaded = force[..., 2] > _LOADED * robot.mass * GRAVITY
    ratio = np.hypot(force[..., 0], force[..., 1]) / np.where(loaded, force[..., 2], np.inf)
    friction = np.where(loaded.any(axis=1), ratio.max(axis=1), np.nan)
    uses = {"torque": torque.max(axis=1), "joint speed": speed.max(axis=1), "friction": friction}
    return {"reward": log.reward[0].copy(), **dict(zip(REWARD_TERMS, log.terms[0].T.copy(), strict=True)), **uses}


def motor_torque(log: Log, limit: Array) -> Array:
    """Torque of the motors, limited to (12,) N·m, at the start of each control step of the first episode: (t, 12), N·m;
    NaN in the first step, where the state is not logged."""
    command, seen = log.command[0], log.observation[0]
    torque = np.full(command["torque"].shape, np.nan)
    torque[1:] = commanded_torque(command[1:], seen["joint_pos"][:-1], seen["joint_vel"][:-1])
    return np.asarray(np.clip(torque, -limit, limit))


def _each(curves: Sequence[Curve], figure: Any, digits: int) -> str:
    """A figure of each curve, the earlier first."""
    return _arrow([figure(values) if np.isfinite(values).any() else np.nan for values, *_ in curves], digits)


def _arrow(found: Sequence[float], digits: int) -> str:
    return " → ".join(f"{value:.{digits}f}" if np.isfinite(value) else "–" for value in found)


def _draw(axes: Axes, time: Array, curves: Sequence[Curve], title: str, limit: float | None = None) -> None:
    for values, line, name in curves:
        axes.plot(time, values, **line._asdict() | {"linewidth": 1.0}, label=name)
    if limit is not None:
        axes.axhline(limit, color=LIMIT, linestyle="dashdot", linewidth=1.2, label="limit")
        axes.set_ylim(bottom=0.0)
    axes.set_xlim(0.0, time[-1])
    style.tidy(axes, title)


def _draw_gait(
    axes: Axes, robot: Robot, config: ControllerConfig, rollout: Rollout, window_s: tuple[float, float]
) -> None:
    """Three bars a leg: what the contact schedule wants, the gait planner's stance, and the measured load."""
    log, alive = rollout.course, int(rollout.steps[0])
    loaded: Flags = log.observation["foot_force"][0, :, :, 2] > config.release_force(robot)
    sources = {
        "stance wanted by the motion": (log.wanted[0], DEMONSTRATION.color),
        "stance of the gait planner": (log.stance[0], AFTER.color),
        "foot loaded": (loaded, BEFORE.color),
    }
    for i, (name, (source, color)) in enumerate(sources.items()):
        for leg in range(4):
            bars = [(a / log.rate_hz, (b - a) / log.rate_hz) for a, b in stretches(source[:alive, leg])]
            place = (-leg + 0.16 - 0.26 * i, 0.22)
            axes.broken_barh(bars, place, facecolor=color, label=None if leg else name)
    agree = 100 * float(np.mean(log.stance[0, :alive] == log.wanted[0, :alive])) if alive else 0.0
    style.tidy(axes, f"gait: the legs are in the state that the motion wants {agree:.1f} % of the time", grid="x")
    axes.set_yticks([0, -1, -2, -3], LEGS)
    axes.set_xlim(window_s)


def deployment_figure(log: DeploymentLog, title: str) -> Figure:
    """Height and tilt of the base, use of the motors' limits, error of the period and age of the state over time."""
    rows = log.rows
    time, reading = rows["time_s"], rows["reading"]
    following = rows["phase"] == DeploymentPhase.FOLLOW
    heights: list[Curve] = [(np.where(following, rows["estimate"]["root_pos"][:, 2], np.nan), AFTER, "estimate")]
    if log.truth is not None:
        heights.append((log.truth["root_pos"][:, 2], BEFORE, "truth"))
    q = reading["quat"]
    tilt = np.arccos(np.clip(1.0 - 2.0 * (q[:, 1] ** 2 + q[:, 2] ** 2), -1.0, 1.0))
    period = np.full(len(time), np.nan)
    period[1:] = 1e3 * np.abs(np.diff(time) - 1.0 / log.rate_hz)
    panels = {
        "height of the base, m": (heights, None),
        "tilt, rad: at most {} from the vertical": ([(tilt, AFTER, "")], None),
        "torque as measured, share of the limit: at most {}": (_share(reading["torque"], log.facts.torque_limit), 1),
        "joint speed, share of the limit: at most {}": (_share(reading["joint_vel"], log.facts.joint_speed_limit), 1),
        "error of the period, ms: at most {}": ([(period, AFTER, "")], None),
        "age of the state when it was used, ms: at most {}": ([(1e3 * rows["age_s"], AFTER, "")], None),
    }
    figure = style.new_figure(14.0, 8.0, title, below=0.7)
    grid = figure.subplots(3, 2, sharex=True)
    for axes, (said, (curves, limit)) in zip(grid.flat, panels.items(), strict=True):
        _draw(axes, time, curves, said.format(_each(curves, np.nanmax, 2)), limit)
        axes.set_xlim(time[0], max(time[-1], time[0] + 1e-3))
    for axes in grid[-1]:
        axes.set_ylim(0.0, max(0.1, axes.get_ylim()[1]))  # on a virtual clock there is only what rounding leaves
        axes.set_xlabel("time (s)", fontsize=9, color=style.MUTED)
    style.legend_below(figure, grid[0, 0])
    return figure


def _share(values: Array, limit: Sequence[float]) -> list[Curve]:
    return [(np.max(np.abs(values) / np.asarray(limit), axis=1), AFTER, "")]
