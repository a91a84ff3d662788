"""The picture of a take: its segments, with feet, speed and heading."""

from typing import TYPE_CHECKING, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from fastmimic.base.conventions import LEGS
from fastmimic.clips.clip import Clip
from fastmimic.clips.segment import DISCRETE, STAND, TURN
from fastmimic.render.figure_style import INK, LEG_LINES, MUTED, STANCE, new_figure, tidy

if TYPE_CHECKING:
    from fastmimic.clips.segment import Segment

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


def segments_figure(clip: Clip, segments: "list[Segment]", title: str) -> Figure:
    """A take over time: segments by name (of `fastmimic.clips.segment.find_segments`), the toes' fore-aft paths, and
    the trunk's speed and heading."""
    seconds = clip.n_frames / clip.rate_hz
    figure = new_figure(float(np.clip(0.45 * seconds, 10.0, 40.0)), 6.4, f"{title}: {_summary(segments)}")
    bars, feet, speed, heading = figure.subplots(4, 1, sharex=True, height_ratios=(1.1, 2, 1, 1))
    _draw_bars(bars, segments, clip.rate_hz)
    time = np.arange(clip.n_frames) / clip.rate_hz
    ahead = (clip.point("neck") - clip.point("pelvis"))[:, :2]
    yaw = np.unwrap(np.arctan2(ahead[:, 1], ahead[:, 0]))
    relative = (clip.toes_w - clip.hips_w)[..., :2]
    fore_aft = np.cos(yaw)[:, None] * relative[..., 0] + np.sin(yaw)[:, None] * relative[..., 1]
    for leg, name in enumerate(LEGS):
        feet.plot(time, fore_aft[:, leg], **LEG_LINES[leg].kwargs(), label=name)
    feet.legend(loc="lower right", bbox_to_anchor=(1, 1), ncols=4, fontsize=8, frameon=False)
    trunk = (clip.point("neck") + clip.point("pelvis"))[:, :2] / 2
    speed.plot(time, _smooth_speed(trunk, clip.rate_hz), color=INK, linewidth=1.2)
    heading.plot(time, np.degrees(yaw - yaw[0]), color=INK, linewidth=1.2)
    tidy(feet, "Toes ahead of their hips: what is compared with itself", ylabel="m")
    tidy(speed, "Speed of the trunk, in the animal's size", ylabel="m/s")
    tidy(heading, "Heading, from the first", "time (s)", "deg")
    for axes in (feet, speed, heading):
        for segment in segments:
            axes.axvline(segment.start / clip.rate_hz, color=MUTED, linewidth=0.5, alpha=0.6)
    bars.set_xlim(0, seconds)
    return figure


def _draw_bars(axes: Axes, segments: "list[Segment]", rate_hz: float) -> None:
    for segment in segments:
        start, length = segment.start / rate_hz, (segment.end - segment.start) / rate_hz
        hatch = "////" if segment.gait == DISCRETE else None
        axes.barh(
            0,
            length,
            left=start,
            color=(_GAIT_COLORS[segment.gait], 0.6),
            edgecolor=INK,
            linewidth=0.6,
            height=1,
            hatch=hatch,
        )
        words = segment.gait if segment.period_frames is None else f"{segment.gait}\n{segment.period_frames:g}"
        upright = length < 1.6
        axes.text(
            start + length / 2,
            0,
            words,
            ha="center",
            va="center",
            fontsize=7,
            rotation=90 if upright else 0,
            bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.7, "pad": 1} if hatch else None,
        )
    tidy(axes, "Segments: gait, and the period of a cycle in frames; hatched: does not repeat")
    axes.set_yticks([])
    axes.set_ylim(-0.5, 0.5)


def _smooth_speed(trunk: np.ndarray, rate_hz: float) -> np.ndarray:
    """Speed of a path (t, 2), m/s, over a fifth of a second."""
    from scipy.ndimage import uniform_filter1d

    path = uniform_filter1d(trunk, max(1, round(0.2 * rate_hz)), axis=0, mode="nearest")
    return np.asarray(np.linalg.norm(np.gradient(path, axis=0), axis=1) * rate_hz)


def _summary(segments: "list[Segment]") -> str:
    repeating = sum(s.end - s.start for s in segments if s.period_frames is not None)
    total = max((s.end for s in segments), default=1)
    return f"{100 * repeating / total:.0f} % repeats, in {sum(s.period_frames is not None for s in segments)} segments"
