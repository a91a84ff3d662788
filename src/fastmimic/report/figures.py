"""The two figures of an imitation: convergence of the optimiser, and tracking of the feet."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.ticker import FormatStrFormatter, LogLocator, MaxNLocator, NullLocator
from numpy.typing import ArrayLike, NDArray

from fastmimic.base.arrays import Array
from fastmimic.base.conventions import LEGS
from fastmimic.render.figure_style import AFTER, BEFORE, DEMONSTRATION, INK, MUTED, STANCE, new_figure, save, tidy

__all__ = ["convergence_figure", "save", "tracking_figure"]


def convergence_figure(
    iteration: ArrayLike,
    best: ArrayLike,
    mean: ArrayLike,
    std: ArrayLike,
    sigma: ArrayLike,
    baseline: float,
    title: str = "Optimisation",
    *,
    randomized: bool = False,
) -> Figure:
    """Reward and step size of the optimiser by iteration, (k,) each.

    Args:
        iteration: their numbers.
        best: objective of each iteration's best candidate, or of the search's start where better; the best so far is
            drawn.
        mean, std: mean reward of the candidates, and its standard deviation, drawn as a band.
        sigma: CMA-ES's step size, relative to the parameters' scaled ranges.
        baseline: mean per-step reward of the unoptimised motion, in [0, 1].
        randomized: whether each iteration scores on other robots: then the best so far would be that of the easiest
            robots, and each iteration's best is drawn.
    """
    k, best, mean, std, sigma = (
        np.atleast_1d(np.asarray(a, dtype=np.float64)) for a in (iteration, best, mean, std, sigma)
    )
    figure = new_figure(8.0, 5.6, title)
    reward, step = figure.subplots(2, 1, sharex=True, height_ratios=(3, 1))
    shown = best if randomized else np.fmax.accumulate(best)
    _draw_reward(reward, k, shown, mean, std, baseline, randomized)
    step.semilogy(k, sigma, color=INK, linewidth=1.4, marker=_marker(k), markersize=4)
    tidy(step, "Step size of the search: it shrinks as the optimiser settles", "iteration", "σ (–)")
    _label_step_sizes(step, sigma)
    step.xaxis.set_major_locator(MaxNLocator(integer=True))
    return figure


def _draw_reward(axes: Axes, k: Array, best: Array, mean: Array, std: Array, baseline: float, randomized: bool) -> None:
    marker = _marker(k)
    axes.fill_between(
        k, mean - std, mean + std, color=BEFORE.color, alpha=0.18, linewidth=0, label="candidates, ± 1 std"
    )
    axes.plot(k, mean, **BEFORE.kwargs(), marker=marker, markersize=4, label="candidates, mean")
    axes.plot(
        k,
        best,
        **AFTER.kwargs(),
        marker=marker,
        markersize=4,
        label="best of the iteration" if randomized else "best so far",
    )
    axes.axhline(baseline, color=DEMONSTRATION.color, linestyle=DEMONSTRATION.linestyle, linewidth=1.4)
    axes.annotate(
        f"not optimised, first robots {baseline:.3f}" if randomized else f"not optimised {baseline:.3f}",
        (1, baseline),
        xycoords=("axes fraction", "data"),
        xytext=(-2, 3),
        textcoords="offset points",
        ha="right",
        fontsize=8.5,
        color=DEMONSTRATION.color,
    )
    title = f"Objective of the search, other robots in each of {len(best)} iterations"
    tidy(axes, title if randomized else _reward_title(best, baseline), ylabel="reward − penalty for lost clearance")
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


def _reward_title(best: Array, baseline: float) -> str:
    final = best[-1]
    return f"Objective of the search: {baseline:.3f} → {final:.3f} after {len(best)} iterations"


def _marker(k: Array) -> str:
    """A dot for a single point, where no line would show."""
    return "o" if len(k) < 3 else ""


def tracking_figure(
    time_s: ArrayLike,
    demonstration: ArrayLike,
    before: ArrayLike,
    after: ArrayLike,
    contact: ArrayLike,
    title: str = "Foot tracking",
    *,
    window_s: tuple[float, float] | None = None,
) -> Figure:
    """Height and fore-aft position of the four feet: wanted and realised.

    Args:
        time_s: (t,) s.
        demonstration: (t, 4, 3) foot centres in the body frame that the robot is scored against, m.
        before: (t, 4, 3) realised feet with the motion as retargeted, body frame, m; NaN after a fall.
        after: (t, 4, 3) realised feet with the optimised motion, in the same way.
        contact: (t, 4) bool, the demonstration's stance, drawn as shading.
        window_s: the times to draw, such as two cycles; the errors in the titles are over all samples.
    """
    time = np.asarray(time_s, dtype=np.float64)
    wanted, *realised = (np.asarray(a, dtype=np.float64) for a in (demonstration, before, after))
    stance = np.asarray(contact, dtype=bool)
    start, end = window_s if window_s is not None else (time[0], time[-1])
    figure = new_figure(14.0, 6.2, title)
    grid = figure.subplots(2, 4, sharex=True)
    for row, axis in enumerate((2, 0)):
        drawn = [wanted[:, :, axis], *(feet[:, :, axis] for feet in realised)]
        for leg, name in enumerate(LEGS):
            axes = grid[row, leg]
            shade(axes, time, stance[:, leg])
            styles = zip(drawn, (DEMONSTRATION, BEFORE, AFTER), ("demonstration", "before", "after"), strict=True)
            for feet, line, label in styles:
                axes.plot(time, feet[:, leg], **line.kwargs(), label=label)
            errors = [rmse(feet[:, leg], drawn[0][:, leg]) for feet in drawn[1:]]
            tidy(axes, _tracking_title(name, "xyz"[axis], errors))
            axes.set_xlim(start, end if end > start else start + 1.0)
        _same_span(grid[row], drawn, (time >= start) & (time <= end))
    _name_axes(grid)
    _legend(figure, grid[0, 0])
    return figure


def _same_span(row: NDArray[np.object_], drawn: list[Array], shown: NDArray[np.bool_]) -> None:
    """Gives the four panels one scale, each centred on its own leg."""
    values = np.concatenate([feet[shown] for feet in drawn])
    low, high = np.nanmin(values, axis=0), np.nanmax(values, axis=0)
    half = 0.54 * max(float(np.max(high - low)), 0.01)
    for axes, centre in zip(row, (low + high) / 2, strict=True):
        axes.set_ylim(centre - half, centre + half)


def _name_axes(grid: NDArray[np.object_]) -> None:
    grid[0, 0].set_ylabel("foot z, body frame (m)", fontsize=9, color=MUTED)
    grid[1, 0].set_ylabel("foot x, body frame (m)", fontsize=9, color=MUTED)
    for axes in grid[1]:
        axes.set_xlabel("time (s)", fontsize=9, color=MUTED)


def _tracking_title(leg: str, axis: str, errors: list[float]) -> str:
    before, after = (f"{1000 * e:.1f}" if np.isfinite(e) else "–" for e in errors)
    return f"{leg} {axis}: RMSE {before} → {after} mm"


def rmse(values: Array, reference: Array) -> float:
    """Root mean square difference over the samples where both are finite; NaN if there are none."""
    error = values - reference
    error = error[np.isfinite(error)]
    return float(np.sqrt(np.mean(error**2))) if error.size else float("nan")


def shade(axes: Axes, time_s: Array, stance: NDArray[np.bool_]) -> None:
    """Shades the times at which `stance` (t,) holds; each sample lasts until the next."""
    edges = np.diff(np.concatenate([[0], stance.astype(np.int8), [0]]))
    dt = time_s[1] - time_s[0] if len(time_s) > 1 else 0.0
    ends = np.append(time_s, time_s[-1] + dt)
    for start, end in zip(np.flatnonzero(edges == 1), np.flatnonzero(edges == -1), strict=True):
        axes.axvspan(ends[start], ends[end], color=STANCE, linewidth=0, zorder=0)


def _legend(figure: Figure, axes: Axes) -> None:
    handles, labels = axes.get_legend_handles_labels()
    figure.legend(
        [*handles, Patch(color=STANCE)],
        [*labels, "stance in the demonstration"],
        loc="outside lower center",
        ncols=4,
        fontsize=9,
        frameon=False,
    )
