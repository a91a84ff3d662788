"""What a user looks at: figures and videos, and the folder of a run that holds them."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from fastmimic.report.figures import convergence_figure, tracking_figure
    from fastmimic.report.inspection import motion_figure
    from fastmimic.report.playback import AnimalTrack, Track
    from fastmimic.report.style import save
    from fastmimic.report.video import VideoInfo, render_video

__all__ = [
    "AnimalTrack",
    "Track",
    "VideoInfo",
    "convergence_figure",
    "motion_figure",
    "render_video",
    "save",
    "tracking_figure",
]

_WHERE = {
    "AnimalTrack": "playback",
    "Track": "playback",
    "VideoInfo": "video",
    "convergence_figure": "figures",
    "motion_figure": "inspection",
    "render_video": "video",
    "save": "style",
    "tracking_figure": "figures",
}


def __getattr__(name: str) -> Any:
    """Imports what is asked for: a run without pictures need not wait for matplotlib."""
    if name not in _WHERE:
        raise AttributeError(f"module 'fastmimic.report' has no attribute '{name}'")
    return getattr(import_module(f"fastmimic.report.{_WHERE[name]}"), name)
