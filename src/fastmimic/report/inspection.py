"""The picture of a motion: gait diagram, trunk, and joints against their limits."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from fastmimic.base.arrays import Array
from fastmimic.base.conventions import JOINTS_PER_LEG, LEGS
from fastmimic.base.rotations import matrix_from_quat
from fastmimic.motion.motion import Motion
from fastmimic.render.figure_style import AFTER, BEFORE, INK, LEG_LINES, LIMIT, MUTED, new_figure, tidy
from fastmimic.robot import Robot


def motion_figure(motion: Motion, robot: Robot, title: str | None = None) -> Figure:
    """A motion's gait, trunk and joints with the robot's limits, over its samples (one cycle if it is periodic).

    The default title has the motion's name with its period, speed and yaw a cycle.
    """
    figure = new_figure(15.0, 7.6, title if title is not None else _heading(motion, robot))
    grid = figure.subplots(3, 3, sharex=True)
    time = np.arange(motion.n_samples, dtype=np.float64) / motion.rate_hz
    _draw_gait(grid[0, 0], time, motion.dt, motion.contact)
    _draw_height(grid[1, 0], time, motion.root_pos_w)
    _draw_tilt(grid[2, 0], time, motion.root_quat_wxyz)
    lower, upper, speed = (
        np.asarray(a).reshape(4, 3) for a in (robot.joint_lower, robot.joint_upper, robot.joint_speed_limit)
    )
    angles, rates = (a.reshape(-1, 4, 3) for a in (motion.joint_pos, motion.joint_vel))
    for joint, name in enumerate(JOINTS_PER_LEG):
        _draw_joint(grid[joint, 1], time, angles[:, :, joint], lower[0, joint], upper[0, joint])
        tidy(grid[joint, 1], f"{name} angle", ylabel="rad")
        _draw_joint(grid[joint, 2], time, rates[:, :, joint], -speed[0, joint], speed[0, joint])
        share = 100 * np.max(np.abs(rates[:, :, joint]) / speed[:, joint])
        tidy(grid[joint, 2], f"{name} speed: peak is {share:.0f} % of the limit", ylabel="rad/s")
    for axes in grid[2]:
        axes.set_xlabel("time (s)", fontsize=9, color=MUTED)
        axes.set_xlim(0, motion.period_s)
    handles, labels = grid[0, 1].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=5, fontsize=9, frameon=False)
    return figure


def _heading(motion: Motion, robot: Robot) -> str:
    text = f"{motion.name} on {robot.name}: {motion.period_s:.2f} s at {motion.rate_hz:g} Hz"
    if motion.cycle is None:
        return f"{text}, not periodic"
    dx, dy, dyaw = motion.cycle / motion.period_s
    return f"{text}, {dx:+.2f} m/s forward, {dy:+.2f} m/s left, yaw {dyaw:+.2f} rad/s"


def _draw_gait(axes: Axes, time: Array, dt: float, contact: NDArray[np.bool_]) -> None:
    """One row per leg, FR at the top: a bar while the foot is in stance."""
    rows = range(len(LEGS))[::-1]
    for leg, row in enumerate(rows):
        edges = np.diff(np.concatenate([[0], contact[:, leg].astype(np.int8), [0]]))
        starts, ends = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)
        bars = [(time[a], (b - a) * dt) for a, b in zip(starts, ends, strict=True)]
        axes.broken_barh(bars, (row - 0.36, 0.72), facecolor=LEG_LINES[leg].color, edgecolor=INK, linewidth=0.6)
    duty = contact.mean(axis=0)
    axes.set_ylim(-0.6, len(LEGS) - 0.4)
    tidy(axes, "gait: a bar is stance; the number is the duty factor")
    axes.set_yticks(list(rows), [f"{leg}  {d:.2f}" for leg, d in zip(LEGS, duty, strict=True)])
    axes.grid(False, axis="y")


def _draw_height(axes: Axes, time: Array, root_pos_w: Array) -> None:
    axes.plot(time, root_pos_w[:, 2], **AFTER.kwargs())
    tidy(axes, "base height above the ground", ylabel="m")
    _widen(axes, 0.04)


def _draw_tilt(axes: Axes, time: Array, root_quat_wxyz: Array) -> None:
    R = matrix_from_quat(root_quat_wxyz)
    pitch = -np.arcsin(np.clip(R[:, 2, 0], -1, 1))
    roll = np.arctan2(R[:, 2, 1], R[:, 2, 2])
    axes.plot(time, np.degrees(pitch), **AFTER.kwargs(), label="pitch")
    axes.plot(time, np.degrees(roll), **BEFORE.kwargs(), label="roll")
    tidy(axes, "base pitch (solid, nose down positive) and roll (dotted)", ylabel="degrees")
    _widen(axes, 4.0)


def _widen(axes: Axes, least: float) -> None:
    """Widens the axis to at least this span of values."""
    low, high = axes.get_ylim()
    half = max(high - low, least) / 2
    axes.set_ylim((low + high) / 2 - half, (low + high) / 2 + half)


def _draw_joint(axes: Axes, time: Array, values: Array, lower: float, upper: float) -> None:
    """The four legs' `values` (t, 4) with the limits, which stay in view."""
    for leg, name in enumerate(LEGS):
        axes.plot(time, values[:, leg], **LEG_LINES[leg].kwargs(), label=name)
    for limit, label in ((lower, "limit"), (upper, None)):
        axes.axhline(limit, color=LIMIT, linestyle="dashdot", linewidth=1.2, label=label)
    span = max(upper, values.max()) - min(lower, values.min())
    axes.set_ylim(min(lower, values.min()) - 0.05 * span, max(upper, values.max()) + 0.05 * span)
