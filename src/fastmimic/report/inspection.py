"""The pictures of a motion and of a take: gait, trunk, joints against their limits; segments, feet, speed, heading."""

from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from fastmimic.base.arrays import Array, stretches
from fastmimic.base.conventions import JOINTS_PER_LEG, LEGS
from fastmimic.base.rotations import roll_pitch_from_quat
from fastmimic.clips.clip import Clip
from fastmimic.clips.segment import DISCRETE, STAND, TURN, Segment, SegmentConfig, take_of
from fastmimic.episode.feasibility import SAMPLE_S, use_of_limits
from fastmimic.motion.motion import Motion
from fastmimic.render import figure_style as style
from fastmimic.render.figure_style import AFTER, BEFORE, INK, LEG_LINES, LIMIT, MUTED, STANCE
from fastmimic.robot import Robot
from fastmimic.simulation.mujoco_sim import GROUND_FRICTION

_GAIT_COLORS: Final = {
    "walk": "#56b4e9",
    "trot": "#0072b2",
    "pace": "#009e73",
    "canter": "#e69f00",
    "gallop": "#d55e00",
    "bound": "#cc79a7",
    TURN: "#f0e442",
    STAND: STANCE,
    DISCRETE: "#ffffff",
}

_AT_LIMIT: Final = 0.9
_ANIMAL: Final[dict[str, Any]] = {"color": MUTED, "linewidth": 1.0, "alpha": 0.55}


def motion_figure(motion: Motion, robot: Robot) -> Figure:
    """A motion's gait, trunk and joints with the robot's limits, over its samples (one cycle if it is periodic), and
    its use of the limits. Behind an executable motion is the animal's."""
    figure = style.new_figure(15.0, 9.8, _heading(motion, robot))
    angles_at, speeds_at = (tuple(f"{what} {joint}" for joint in JOINTS_PER_LEG) for what in ("angle", "speed"))
    left = ("gait", "height", "tilt")
    rows: list[Any] = [list(row) for row in zip(left, angles_at, speeds_at, strict=True)]
    panels: dict[str, Axes] = figure.subplot_mosaic([*rows, ["use", "use", "use"]], sharex=True)
    animal = motion.target.animal
    time = np.arange(motion.n_samples, dtype=np.float64) / motion.rate_hz
    _draw_gait(panels["gait"], time, motion.dt, motion.contact)
    if animal is not None:
        panels["height"].plot(time, animal.root_pos_w[:, 2], **_ANIMAL, label="the animal's")
    panels["height"].plot(time, motion.root_pos_w[:, 2], **AFTER._asdict())
    style.tidy(
        panels["height"],
        "base height above the ground" + ("" if animal is None else " (grey: the animal's)"),
        ylabel="m",
    )
    _widen(panels["height"], 0.04)
    _draw_tilt(panels["tilt"], time, motion.root_quat_wxyz)
    lower, upper, speed = (
        np.asarray(a).reshape(4, 3) for a in (robot.joint_lower, robot.joint_upper, robot.joint_speed_limit)
    )
    angles, rates = (a.reshape(-1, 4, 3) for a in (motion.joint_pos, motion.joint_vel))
    for joint, name in enumerate(JOINTS_PER_LEG):
        if animal is not None:
            for axes, values in (
                (panels[angles_at[joint]], animal.joint_pos),
                (panels[speeds_at[joint]], animal.joint_vel),
            ):
                axes.plot(time, values[:, joint::3], **_ANIMAL)
        _draw_joint(panels[angles_at[joint]], time, angles[:, :, joint], lower[0, joint], upper[0, joint])
        style.tidy(panels[angles_at[joint]], f"{name} angle", ylabel="rad")
        _draw_joint(panels[speeds_at[joint]], time, rates[:, :, joint], -speed[0, joint], speed[0, joint])
        share = 100 * np.max(np.abs(rates[:, :, joint]) / speed[:, joint])
        style.tidy(panels[speeds_at[joint]], f"{name} speed: peak is {share:.0f} % of the limit", ylabel="rad/s")
    panels["gait"].set_xlim(0, motion.period_s)
    _draw_use(panels["use"], motion, robot)
    panels["use"].set_xlabel("time (s)", fontsize=9, color=MUTED)
    style.legend_below(figure, panels[angles_at[0]])
    return figure


def _draw_use(axes: Axes, motion: Motion, robot: Robot) -> None:
    """The share of each limit that is used, and bands where one is reached."""
    sample = np.arange(0, motion.n_samples, max(1, round(SAMPLE_S * motion.rate_hz)))
    time, found = sample / motion.rate_hz, use_of_limits(robot, motion, sample)
    shares = {
        "torque": found.torque,
        "torque at speed": found.torque_at_speed,
        "joint speed": found.joint_speed,
        f"friction of {GROUND_FRICTION:g}": found.friction / GROUND_FRICTION,
    }
    for (name, share), line in zip(shares.items(), LEG_LINES, strict=True):
        axes.plot(time, share, **line._asdict(), label=name)
        for first, end in stretches(share > _AT_LIMIT):
            axes.axvspan(time[first], time[end - 1] + SAMPLE_S, color=line.color, alpha=0.12, linewidth=0)
    axes.axhline(1.0, color=LIMIT, linestyle="dashdot", linewidth=1.2)
    axes.set_ylim(0.0, max(1.1, 1.05 * max(float(np.nanmax(share, initial=0.0)) for share in shares.values())))
    style.tidy(axes, f"share of each limit, of the joint nearest to it; a band: more than {_AT_LIMIT:.0%}")
    axes.legend(loc="upper right", ncols=4, fontsize=8, frameon=False)


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
        bars = [(time[a], (b - a) * dt) for a, b in stretches(contact[:, leg])]
        axes.broken_barh(bars, (row - 0.36, 0.72), facecolor=LEG_LINES[leg].color, edgecolor=INK, linewidth=0.6)
    duty = contact.mean(axis=0)
    axes.set_ylim(-0.6, len(LEGS) - 0.4)
    style.tidy(axes, "gait: a bar is stance; the number is the duty factor")
    axes.set_yticks(list(rows), [f"{leg}  {d:.2f}" for leg, d in zip(LEGS, duty, strict=True)])
    axes.grid(False, axis="y")


def _draw_tilt(axes: Axes, time: Array, root_quat_wxyz: Array) -> None:
    roll, pitch = roll_pitch_from_quat(root_quat_wxyz)
    axes.plot(time, np.degrees(pitch), **AFTER._asdict(), label="pitch")
    axes.plot(time, np.degrees(roll), **BEFORE._asdict(), label="roll")
    style.tidy(axes, "base pitch (solid, nose down positive) and roll (dotted)", ylabel="degrees")
    _widen(axes, 4.0)


def _widen(axes: Axes, least: float) -> None:
    """Widens the axis to at least this span of values."""
    low, high = axes.get_ylim()
    half = max(high - low, least) / 2
    axes.set_ylim((low + high) / 2 - half, (low + high) / 2 + half)


def _draw_joint(axes: Axes, time: Array, values: Array, lower: float, upper: float) -> None:
    """The four legs' `values` (t, 4) with the limits, which stay in view."""
    for leg, name in enumerate(LEGS):
        axes.plot(time, values[:, leg], **LEG_LINES[leg]._asdict(), label=name)
    for limit, label in ((lower, "limit"), (upper, None)):
        axes.axhline(limit, color=LIMIT, linestyle="dashdot", linewidth=1.2, label=label)
    span = max(upper, values.max()) - min(lower, values.min())
    axes.set_ylim(min(lower, values.min()) - 0.05 * span, max(upper, values.max()) + 0.05 * span)


def segments_figure(clip: Clip, segments: list[Segment], title: str) -> Figure:
    """A take over time: segments by name (of `find_segments`), the toes' fore-aft paths, the trunk's speed, heading."""
    seconds = clip.n_frames / clip.rate_hz
    figure = style.new_figure(float(np.clip(0.45 * seconds, 10.0, 40.0)), 6.4, f"{title}: {_summary(segments)}")
    bars, feet, speed, heading = figure.subplots(4, 1, sharex=True, height_ratios=(1.1, 2, 1, 1))
    _draw_bars(bars, segments, clip.rate_hz)
    time = np.arange(clip.n_frames) / clip.rate_hz
    take = take_of(clip, SegmentConfig())
    for leg, name in enumerate(LEGS):
        feet.plot(time, take.toes[:, leg, 0], **LEG_LINES[leg]._asdict(), label=name)
    feet.legend(loc="lower right", bbox_to_anchor=(1, 1), ncols=4, fontsize=8, frameon=False)
    fifth = max(1, round(0.2 * clip.rate_hz))  # of a second
    smooth = uniform_filter1d(take.trunk, fifth, axis=0, mode="nearest")
    pace = np.linalg.norm(np.gradient(smooth, axis=0), axis=1) * clip.rate_hz
    speed.plot(time, pace, color=INK, linewidth=1.2)
    heading.plot(time, np.degrees(take.heading - take.heading[0]), color=INK, linewidth=1.2)
    style.tidy(feet, "Toes ahead of their hips: what is compared with itself", ylabel="m")
    style.tidy(speed, "Speed of the trunk, in the animal's size", ylabel="m/s")
    style.tidy(heading, "Heading, from the first", "time (s)", "deg")
    for axes in (feet, speed, heading):
        for segment in segments:
            axes.axvline(segment.start / clip.rate_hz, color=MUTED, linewidth=0.5, alpha=0.6)
    bars.set_xlim(0, seconds)
    return figure


def _draw_bars(axes: Axes, segments: list[Segment], rate_hz: float) -> None:
    for segment in segments:
        start, length = segment.start / rate_hz, (segment.end - segment.start) / rate_hz
        hatch, color = "////" if segment.gait == DISCRETE else None, (_GAIT_COLORS[segment.gait], 0.6)
        axes.barh(0, length, 1, start, color=color, edgecolor=INK, linewidth=0.6, hatch=hatch)
        words = segment.gait if segment.period_frames is None else f"{segment.gait}\n{segment.period_frames:g}"
        plate = {"facecolor": "white", "edgecolor": "none", "alpha": 0.7, "pad": 1} if hatch else None
        angle = 90 if length < 1.6 else 0
        axes.text(start + length / 2, 0, words, ha="center", va="center", fontsize=7, rotation=angle, bbox=plate)
    style.tidy(axes, "Segments: gait, and the period of a cycle in frames; hatched: does not repeat")
    axes.set_yticks([])
    axes.set_ylim(-0.5, 0.5)


def _summary(segments: list[Segment]) -> str:
    repeating = sum(s.end - s.start for s in segments if s.period_frames is not None)
    total = max((s.end for s in segments), default=1)
    return f"{100 * repeating / total:.0f} % repeats, in {sum(s.period_frames is not None for s in segments)} segments"
