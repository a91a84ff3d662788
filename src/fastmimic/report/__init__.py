"""What a user looks at: figures and videos."""

from fastmimic.report.figures import convergence_figure, tracking_figure
from fastmimic.report.motion_figure import motion_figure
from fastmimic.report.style import save
from fastmimic.report.video import Track, VideoInfo, render_video

__all__ = [
    "Track",
    "VideoInfo",
    "convergence_figure",
    "motion_figure",
    "render_video",
    "save",
    "tracking_figure",
]
