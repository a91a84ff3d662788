"""The figures and the video of a run: convergence of the optimiser, tracking of the feet."""

import time
from collections.abc import Callable

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.ticker import FormatStrFormatter, LogLocator, MaxNLocator, NullLocator
from numpy.typing import NDArray

from fastmimic.base.arrays import Array, stretches
from fastmimic.base.conventions import LEGS
from fastmimic.episode.rollout import Rollout
from fastmimic.experiments.measurement import foot_courses
from fastmimic.imitation.imitate import Imitation
from fastmimic.imitation.methods import method_named
from fastmimic.optimize.cma_es import History
from fastmimic.render import figure_style as style
from fastmimic.render.figure_style import AFTER, BEFORE, DEMONSTRATION, INK, MUTED, STANCE
from fastmimic.render.tracks import Track, rollout_track
from fastmimic.report.html_run import shown_window
from fastmimic.runs.work_folder import CONVERGENCE, TRACKING, VIDEO, RunFolder


def convergence_figure(history: History, title: str = "Optimisation") -> Figure:
    """Reward and step size of the optimiser by iteration: best so far, the candidates' mean, deviation as a band.
    With other robots in each iteration, the best so far would be the easiest ones'; each iteration's best is drawn."""
    h = history
    k = np.arange(1.0, len(h.best) + 1)
    figure = style.new_figure(8.0, 5.6, title, below=0.5)
    reward, step = figure.subplots(2, 1, sharex=True, height_ratios=(3, 1))
    _draw_reward(reward, k, h)
    step.semilogy(k, h.sigma, color=INK, linewidth=1.4, marker=_marker(k), markersize=4)
    style.tidy(step, "Step size of the search: it shrinks as the optimiser settles", "iteration", "σ (–)")
    _label_step_sizes(step, h.sigma)
    step.xaxis.set_major_locator(MaxNLocator(integer=True))
    return figure


def _draw_reward(axes: Axes, k: Array, h: History) -> None:
    marker, mean, std, baseline = _marker(k), h.mean, h.std, h.baseline
    best = h.best if h.randomized else np.fmax.accumulate(np.maximum(h.best, h.start))
    label = "candidates, ± 1 std"
    axes.fill_between(k, mean - std, mean + std, color=BEFORE.color, alpha=0.18, linewidth=0, label=label)
    axes.plot(k, mean, **BEFORE._asdict(), marker=marker, markersize=4, label="candidates, mean")
    label = "best of the iteration" if h.randomized else "best so far"
    axes.plot(k, best, **AFTER._asdict(), marker=marker, markersize=4, label=label)
    axes.axhline(baseline, color=DEMONSTRATION.color, linestyle=DEMONSTRATION.linestyle, linewidth=1.4)
    said = f"not optimised{', first robots' if h.randomized else ''} {baseline:.3f}"
    where = {"xycoords": ("axes fraction", "data"), "ha": "right", "color": DEMONSTRATION.color}
    style.write_at(axes, said, (1, baseline), (-2, 3), 8.5, **where)
    title = f"Objective of the search, other robots in each of {len(best)} iterations"
    if not h.randomized:
        title = f"Objective of the search: {baseline:.3f} → {best[-1]:.3f} after {len(best)} iterations"
    style.tidy(axes, title, ylabel="reward − penalty for lost clearance")
    axes.legend(loc="lower right", bbox_to_anchor=(1, 0.04), fontsize=8.5, frameon=True, framealpha=0.9)
    drawn = np.concatenate([best, mean, mean - std, mean + std, [baseline]])
    drawn = drawn[np.isfinite(drawn)]
    margin = 0.06 * max(np.ptp(drawn), 0.02)
    axes.set_ylim(drawn.min() - margin, drawn.max() + margin)


def _label_step_sizes(axes: Axes, sigma: Array) -> None:
    """Ticks for a low logarithmic axis: 1, 2 and 5 of each decade, or whole decades."""
    shown = sigma[np.isfinite(sigma) & (sigma > 0)]
    if not shown.size:
        return
    low, high = shown.min() / 1.6, shown.max() * 1.6  # 2.5 from end to end: one of these is always in it
    axes.set_ylim(low, high)
    subs = (1.0, 2.0, 5.0) if high / low < 40 else (1.0,)
    axes.yaxis.set_major_locator(LogLocator(subs=subs, numticks=5))
    axes.yaxis.set_major_formatter(FormatStrFormatter("%g"))
    axes.yaxis.set_minor_locator(NullLocator())


def _marker(k: Array) -> str:
    """A dot for a single point, where no line would show."""
    return "o" if len(k) < 3 else ""


def tracking_figure(
    time: Array,
    wanted: Array,
    before: Array,
    after: Array,
    stance: NDArray[np.bool_],
    title: str = "Foot tracking",
    *,
    window_s: tuple[float, float] | None = None,
) -> Figure:
    """Height and fore-aft position of the four feet, wanted and realised, (t, 4, 3) foot centres in the body frame, m.
    `wanted` is what the robot is scored against at `time` (t,), s; `before` and `after` are realised with the motion as
    retargeted and optimised, NaN after a fall. `stance` (t, 4), the demonstration's, is shaded. `window_s` are the
    times to draw, such as two cycles; the errors in the titles are over all samples."""
    start, end = window_s if window_s is not None else (time[0], time[-1])
    figure = style.new_figure(14.0, 6.2, title, below=0.85)
    grid = figure.subplots(2, 4, sharex=True)
    for row, axis in enumerate((2, 0)):
        drawn = [wanted[:, :, axis], before[:, :, axis], after[:, :, axis]]
        for leg, name in enumerate(LEGS):
            axes = grid[row, leg]
            shade(axes, time, stance[:, leg])
            styles = zip(drawn, (DEMONSTRATION, BEFORE, AFTER), ("demonstration", "before", "after"), strict=True)
            for feet, line, label in styles:
                axes.plot(time, feet[:, leg], **line._asdict(), label=label)
            errors = [rmse(feet[:, leg], drawn[0][:, leg]) for feet in drawn[1:]]
            before_mm, after_mm = (f"{1000 * e:.1f}" if np.isfinite(e) else "–" for e in errors)
            style.tidy(axes, f"{name} {'xyz'[axis]}: RMSE {before_mm} → {after_mm} mm")
            axes.set_xlim(start, end if end > start else start + 1.0)
        _same_span(grid[row], drawn, (time >= start) & (time <= end))
        grid[row, 0].set_ylabel(f"foot {'xyz'[axis]}, body frame (m)", fontsize=9, color=MUTED)
    for axes in grid[1]:
        axes.set_xlabel("time (s)", fontsize=9, color=MUTED)
    style.legend_below(figure, grid[0, 0], [Patch(color=STANCE, label="stance in the demonstration")])
    return figure


def _same_span(row: NDArray[np.object_], drawn: list[Array], shown: NDArray[np.bool_]) -> None:
    """Gives the four panels one scale, each centred on its own leg."""
    values = np.concatenate([feet[shown] for feet in drawn])
    low, high = np.nanmin(values, axis=0), np.nanmax(values, axis=0)
    half = 0.54 * max(float(np.max(high - low)), 0.01)
    for axes, centre in zip(row, (low + high) / 2, strict=True):
        axes.set_ylim(centre - half, centre + half)


def rmse(values: Array, reference: Array) -> float:
    """Root mean square difference over the samples where both are finite; NaN if there are none."""
    error = values - reference
    error = error[np.isfinite(error)]
    return float(np.sqrt(np.mean(error**2))) if error.size else float("nan")


def shade(axes: Axes, time_s: Array, stance: NDArray[np.bool_]) -> None:
    """Shades the times at which `stance` (t,) holds; each sample lasts until the next."""
    dt = time_s[1] - time_s[0] if len(time_s) > 1 else 0.0
    ends = np.append(time_s, time_s[-1] + dt)
    for start, end in stretches(stance):
        axes.axvspan(ends[start], ends[end], color=STANCE, linewidth=0, zorder=0)


def draw_run(result: Imitation, folder: RunFolder) -> None:
    """Writes the figures of a run; raises `OutputError`."""
    title = f"{result.motion.name} on {result.robot.name}"
    h = result.history
    if h is not None and len(h.best):
        style.save(convergence_figure(h, title), folder.path / CONVERGENCE)
    style.save(_tracked(result, title), folder.path / TRACKING)


def write_video(
    result: Imitation,
    folder: RunFolder,
    progress: Callable[[int, int], None] | None = None,
    quality: str = "preview",
) -> bool:
    """Adds the video, and its time to the metrics; False if nothing can draw. Arguments, errors as `render_video`."""
    from fastmimic.render.video import render_video

    began = time.perf_counter()
    info = render_video(
        result.robot,
        _tracks(result),
        folder.path / VIDEO,
        rate_hz=result.before.course.rate_hz,
        progress=progress,
        quality=quality,
    )
    if info is not None:
        folder.write_metrics(result.metrics(), time.perf_counter() - began)
    return info is not None


def _tracks(result: Imitation) -> list[Track]:
    """The episodes before and, if something was optimised, after."""

    def track(rollout: Rollout, title: str, method: str) -> Track:
        loaded = result.config.release_force(result.robot)
        return rollout_track(rollout, loaded, title, note=f"{result.motion.name} · {method_named(method).label}")

    if result.history is not None:  # before it, there was only the method's controller
        return [
            track(result.before, "before: as retargeted", method_named(result.method).unoptimised.name),
            track(result.after, "after: optimised", result.method),
        ]
    as_it_is = "as retargeted" if result.motion.demonstration is None else "as its motions were optimised"
    return [track(result.before, as_it_is, result.method)]


def _tracked(result: Imitation, title: str) -> Figure:
    log = result.after.course
    time_s = np.arange(1, log.wanted.shape[1] + 1) / log.rate_hz
    wanted, after = foot_courses(result.after, result.robot)
    _, before = foot_courses(result.before, result.robot)
    window_s = shown_window(result.demonstration, (result.before, result.after))
    return tracking_figure(time_s, wanted, before, after, log.wanted[0], title, window_s=window_s)
