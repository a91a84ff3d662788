"""The figures of a run (convergence of the optimiser, tracking of the feet) and its video; those of a motion (gait,
trunk, joints against their limits) and of a take (segments, feet, speed, heading)."""

import time
from pathlib import Path
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from fastmimic.base.arrays import Array, Flags, stretches
from fastmimic.base.conventions import GROUND_FRICTION, JOINTS_PER_LEG, LEGS
from fastmimic.base.files import packaged
from fastmimic.base.rotations import roll_pitch_from_quat
from fastmimic.clips.clip import Clip
from fastmimic.clips.segment import DISCRETE, Segment, SegmentConfig, take_of
from fastmimic.episode.feasibility import SAMPLE_S
from fastmimic.episode.metrics import mean_of_known
from fastmimic.episode.rollout import Rollout
from fastmimic.experiments.measurement import foot_courses, shown_window
from fastmimic.imitation.imitate import Imitation
from fastmimic.imitation.methods import METHODS
from fastmimic.motion.limits import use_of_limits
from fastmimic.motion.motion import Motion
from fastmimic.optimize.cma_es import History
from fastmimic.render import figure_style as style
from fastmimic.render.figure_style import AFTER, BEFORE, DEMONSTRATION, INK, LEG_LINES, LIMIT, MUTED, STANCE
from fastmimic.render.tracks import AnimalTrack, Track, rollout_track
from fastmimic.render.video import render_video
from fastmimic.robot import Robot
from fastmimic.runs.work_folder import CONVERGENCE, TRACKING, VIDEO, RunFolder

_GAIT_COLORS: Final = packaged("fastmimic.report", "gait_colors.json", dict[str, str])
_AT_LIMIT: Final = 0.9
THREE_PANELS: Final = (1380, 460)
_ANIMAL: Final[dict[str, Any]] = {"color": MUTED, "linewidth": 1.0, "alpha": 0.55}


def convergence_figure(history: History, title: str = "Optimisation") -> Figure:
    """Reward and step size of the optimiser by iteration: best so far, the candidates' mean, deviation as a band."""
    h = history
    k = np.arange(1.0, len(h.best) + 1)
    figure = style.new_figure(8.0, 5.6, title, below=0.5)
    reward, step = figure.subplots(2, 1, sharex=True, height_ratios=(3, 1))
    _draw_reward(reward, k, h)
    step.plot(k, h.sigma, color=INK, linewidth=1.4, marker=_marker(k), markersize=4)
    style.tidy(step, "Step size of the search: it shrinks as the optimiser settles", "iteration", "σ (–)")
    step.set_ylim(bottom=0.0)
    step.yaxis.set_major_locator(MaxNLocator(3))
    step.xaxis.set_major_locator(MaxNLocator(integer=True))
    return figure


def _draw_reward(axes: Axes, k: Array, h: History) -> None:
    marker, mean, std, baseline = _marker(k), h.mean, h.std, h.baseline
    best = np.fmax.accumulate(np.maximum(h.best, h.start))
    label = "candidates, ± 1 std"
    axes.fill_between(k, mean - std, mean + std, color=BEFORE.color, alpha=0.18, linewidth=0, label=label)
    axes.plot(k, mean, **BEFORE._asdict(), marker=marker, markersize=4, label="candidates, mean")
    axes.plot(k, best, **AFTER._asdict(), marker=marker, markersize=4, label="best so far")
    axes.axhline(baseline, **DEMONSTRATION._asdict(), label=f"not optimised: {baseline:.3f}")
    title = f"Objective of the search: {baseline:.3f} → {best[-1]:.3f} after {len(best)} iterations"
    style.tidy(axes, title, ylabel="reward − penalty for lost clearance")
    axes.legend(loc="lower right", bbox_to_anchor=(1, 0.04), fontsize=8.5, frameon=True, framealpha=0.9)
    drawn = np.concatenate([best, mean, mean - std, mean + std, [baseline]])
    drawn = drawn[np.isfinite(drawn)]
    margin = 0.06 * max(np.ptp(drawn), 0.02)
    axes.set_ylim(drawn.min() - margin, drawn.max() + margin)


def _marker(k: Array) -> str:
    """A dot for a single point, where no line would show."""
    return "o" if len(k) < 3 else ""


def tracking_figure(
    time: Array,
    wanted: Array,
    before: Array | None,
    after: Array,
    stance: Flags,
    title: str = "Foot tracking",
    *,
    window_s: tuple[float, float] | None = None,
) -> Figure:
    """Height and fore-aft position of the four feet, wanted and realised, (t, 4, 3) foot centres in the body frame, m.
    `wanted` is what the robot is scored against at `time` (t,), s; `before` and `after` are realised with the motion as
    retargeted, None if that is all there is, and optimised, NaN after a fall. `stance` (t, 4), the demonstration's, is
    shaded. `window_s` are the times to draw, such as two cycles; the errors in the titles are over all samples."""
    start, end = window_s if window_s is not None else (time[0], time[-1])
    figure = style.new_figure(14.0, 6.2, title, below=0.85)
    grid = figure.subplots(2, 4, sharex=True)
    lines = [(wanted, DEMONSTRATION, "demonstration"), (after, AFTER, "robot" if before is None else "after")]
    if before is not None:
        lines.insert(1, (before, BEFORE, "before"))
    dt = time[1] - time[0] if len(time) > 1 else 0.0
    ends = np.append(time, time[-1] + dt)  # each sample lasts until the next
    for row, axis in enumerate((2, 0)):
        drawn = [feet[:, :, axis] for feet, _, _ in lines]
        for leg, name in enumerate(LEGS):
            axes = grid[row, leg]
            for first, last in stretches(stance[:, leg]):
                axes.axvspan(ends[first], ends[last], color=STANCE, linewidth=0, zorder=0)
            for feet, (_, line, label) in zip(drawn, lines, strict=True):
                axes.plot(time, feet[:, leg], **line._asdict(), label=label)
            errors = [np.sqrt(mean_of_known((feet[:, leg] - drawn[0][:, leg]) ** 2)) for feet in drawn[1:]]
            said = " → ".join(f"{1000 * e:.1f}" if np.isfinite(e) else "–" for e in errors)
            where = f"foot {'xyz'[axis]}, body frame (m)" if leg == 0 else ""
            style.tidy(axes, f"{name} {'xyz'[axis]}: RMSE {said} mm", "time (s)" if row else "", where)
            axes.set_xlim(start, end if end > start else start + 1.0)
        _same_span(grid[row], drawn, (time >= start) & (time <= end))
    style.legend_below(figure, grid[0, 0], [Patch(color=STANCE, label="stance in the demonstration")])
    return figure


def _same_span(row: NDArray[np.object_], drawn: list[Array], shown: Flags) -> None:
    """Gives the four panels one scale, each centred on its own leg."""
    values = np.concatenate([feet[shown] for feet in drawn])
    low, high = np.nanmin(values, axis=0), np.nanmax(values, axis=0)
    half = 0.54 * max(float(np.max(high - low)), 0.01)
    for axes, centre in zip(row, (low + high) / 2, strict=True):
        axes.set_ylim(centre - half, centre + half)


def run_figure(result: Imitation) -> Figure:
    """How the feet follow the demonstration, before and after, in some cycles."""
    log = result.after.course
    time_s = np.arange(1, log.wanted.shape[1] + 1) / log.rate_hz
    wanted, after = foot_courses(result.after, result.robot)
    before = None if result.after is result.before else foot_courses(result.before, result.robot)[1]
    window_s = shown_window(result.demonstration, (result.before, result.after))
    return tracking_figure(time_s, wanted, before, after, log.wanted[0], _title(result), window_s=window_s)


def _title(result: Imitation) -> str:
    return f"{result.motion.name} on {result.robot.name}"


def draw_run(result: Imitation, folder: RunFolder) -> None:
    """Writes the figures of a run; raises `OutputError`."""
    h = result.history
    if h is not None and len(h.best):
        style.save(convergence_figure(h, _title(result)), folder.path / CONVERGENCE)
    style.save(run_figure(result), folder.path / TRACKING)


def write_video(result: Imitation, folder: RunFolder, clip: Clip | None = None, **options: Any) -> None:
    """Adds the video, if anything can draw, and its time to the metrics. Arguments, errors as `render_run`."""
    began = time.perf_counter()
    if render_run(result, folder.path / VIDEO, clip, **options):
        folder.write_metrics(result.metrics(), time.perf_counter() - began)


def render_run(result: Imitation, path: Path, clip: Clip | None = None, **options: Any) -> bool:
    """Writes a video of the animal of `clip`, the robot with its motion as it is, and with the result; returns whether
    anything can draw. `options` and errors as `render_video`."""
    tracks = _tracks(result, clip)
    options |= {"size": None if len(tracks) < 3 else THREE_PANELS, "columns": len(tracks)}
    return render_video(result.robot, tracks, path, rate_hz=result.before.course.rate_hz, **options) is not None


def _tracks(result: Imitation, clip: Clip | None) -> list[Track]:
    """The animal, the robot without the method, and with it; what there is of them."""

    def track(rollout: Rollout, title: str, method: str) -> Track:
        loaded = result.config.release_force(result.robot)
        return rollout_track(rollout, loaded, title, note=f"{result.motion.name} · {METHODS[method].label}")

    robot, kinematic, seconds = result.robot, result.kinematic, result.duration_s
    tracks: list[Track] = []
    if clip is not None:
        tracks.append(AnimalTrack.of(clip, robot, result.motion, seconds, "the animal", result.motion.name))
    if kinematic is not None:
        method = METHODS[result.method]
        plain = "mbc" if method.learned or method.controller is not None else method.unoptimised.name
        tracks.append(track(kinematic, "without: the animal's motion as it is", plain))
    before = "not optimised" if result.motion.demonstration is None else "as its motions were optimised"
    searched = "fitted" if result.nothing_gained else "optimised"
    title = searched if result.history is not None else before
    return [*tracks, track(result.after, title if kinematic is None else f"with: executable, {title}", result.method)]


def motion_figure(motion: Motion, robot: Robot) -> Figure:
    """A motion's gait, trunk and joints with the robot's limits, over its samples (one cycle if it is periodic), and
    its use of the limits. Behind an executable motion is the animal's."""
    figure = style.new_figure(15.0, 11.0, f"{motion.name} on {robot.name}: {motion.about}", below=0.7)
    left = zip(("gait", "height", "tilt"), JOINTS_PER_LEG, strict=True)
    rows: list[Any] = [[name, f"{joint} angle", f"{joint} speed"] for name, joint in left]
    panels: dict[str, Axes] = figure.subplot_mosaic([*rows, ["use", "use", "use"]], sharex=True)
    animal = motion.target.animal
    time = np.arange(motion.n_samples, dtype=np.float64) / motion.rate_hz
    _draw_gait(panels["gait"], time, motion.dt, motion.contact)
    if animal is not None:
        panels["height"].plot(time, animal.root_pos_w[:, 2], **_ANIMAL, label="the animal's")
    panels["height"].plot(time, motion.root_pos_w[:, 2], **AFTER._asdict())
    title = "base height above the ground" + ("" if animal is None else " (grey: the animal's)")
    style.tidy(panels["height"], title, ylabel="m")
    _widen(panels["height"], 0.04)
    roll, pitch = np.degrees(roll_pitch_from_quat(motion.root_quat_wxyz))
    panels["tilt"].plot(time, pitch, **AFTER._asdict(), label="pitch")
    panels["tilt"].plot(time, roll, **BEFORE._asdict(), label="roll")
    style.tidy(panels["tilt"], "base pitch (solid, nose down positive) and roll (dotted)", ylabel="degrees")
    _widen(panels["tilt"], 4.0)
    speed = robot.joint_speed_limit
    peak = 100 * np.max(np.abs(motion.joint_vel) / speed, axis=0)
    for i, joint in enumerate(JOINTS_PER_LEG):
        angle, rate = panels[f"{joint} angle"], panels[f"{joint} speed"]
        if animal is not None:
            angle.plot(time, animal.joint_pos[:, i::3], **_ANIMAL)
            rate.plot(time, animal.joint_vel[:, i::3], **_ANIMAL)
        _draw_joint(angle, time, motion.joint_pos[:, i::3], robot.joint_lower[i], robot.joint_upper[i])
        _draw_joint(rate, time, motion.joint_vel[:, i::3], -speed[i], speed[i])
        style.tidy(angle, f"{joint} angle", ylabel="rad")
        style.tidy(rate, f"{joint} speed: peak is {peak[i::3].max():.0f} % of the limit", ylabel="rad/s")
    panels["gait"].set_xlim(0, motion.period_s)
    _draw_use(panels["use"], motion, robot)
    panels["use"].set_xlabel("time (s)", fontsize=9, color=MUTED)
    for name in rows[-1]:  # the panel below has another width
        panels[name].tick_params(labelbottom=True)
    style.legend_below(figure, panels[f"{JOINTS_PER_LEG[0]} angle"])
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
    for (name, share), line in zip(shares.items(), style.SERIES_LINES, strict=True):
        axes.plot(time, share, **line._asdict(), label=name)
        for first, end in stretches(share > _AT_LIMIT):
            axes.axvspan(time[first], time[end - 1] + SAMPLE_S, color=line.color, alpha=0.12, linewidth=0)
    axes.axhline(1.0, color=LIMIT, linestyle="dashdot", linewidth=1.2)
    axes.set_ylim(0.0, max(1.1, 1.05 * max(float(np.nanmax(share, initial=0.0)) for share in shares.values())))
    style.tidy(axes, f"share of each limit, of the joint nearest to it; a band: more than {_AT_LIMIT:.0%}")
    axes.legend(loc="lower right", bbox_to_anchor=(1, 1), ncols=4, fontsize=8, frameon=False)


def _draw_gait(axes: Axes, time: Array, dt: float, contact: Flags) -> None:
    """One row per leg, FR at the top: a bar while the foot is in stance."""
    rows = range(len(LEGS))[::-1]
    for leg, row in enumerate(rows):
        bars = [(time[a], (b - a) * dt) for a, b in stretches(contact[:, leg])]
        axes.broken_barh(bars, (row - 0.36, 0.72), facecolor=LEG_LINES[leg].color, edgecolor=INK, linewidth=0.6)
    duty = contact.mean(axis=0)
    axes.set_ylim(-0.6, len(LEGS) - 0.4)
    style.tidy(axes, "gait: a bar is stance; the number is the duty factor", grid="x")
    axes.set_yticks(list(rows), [f"{leg}  {d:.2f}" for leg, d in zip(LEGS, duty, strict=True)])


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
    repeating = [s.end - s.start for s in segments if s.period_frames is not None]
    percent = 100 * sum(repeating) / max((s.end for s in segments), default=1)
    title = f"{title}: {percent:.0f} % repeats, in {len(repeating)} segments"
    figure = style.new_figure(float(np.clip(0.45 * seconds, 10.0, 40.0)), 6.4, title)
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
