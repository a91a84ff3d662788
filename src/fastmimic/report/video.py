"""Videos of robots in motion, one or two side by side, each with its demonstration as a ghost."""

import logging
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from fastmimic.errors import ConfigError
from fastmimic.report.encoding import VideoFile
from fastmimic.report.offscreen import NoRendererError, Offscreen
from fastmimic.report.overlay import Overlay
from fastmimic.report.playback import Track, resample
from fastmimic.report.scene import Stage, build_stage, ghost_rgba
from fastmimic.rotations import yaw_from_quat

if TYPE_CHECKING:
    import mujoco

    from fastmimic.report.view import View
    from fastmimic.robot import Robot

_LOG = logging.getLogger(__name__)

Array = NDArray[np.float64]

_CAMERA_AZIMUTH_DEG: Final = 122.0
"""From the robot's first heading: seen from its front right, so that it moves across the picture."""
_CAMERA_SMOOTHING_S: Final = 0.35
_LOOK_AT_HEIGHT: Final = 0.62
"""Of the base's height: leaves room above for the words and below for the shadow."""


@dataclass(frozen=True)
class VideoInfo:
    """What was written: number of frames, and how long they play, s."""

    frames: int
    seconds: float


@dataclass(frozen=True, eq=False)
class _Panel:
    """A view with what it shows in each of n frames: poses (n, 19) and points (n, 3) to look at."""

    view: "View"
    robot: Array
    ghost: Array | None
    look_at: Array

    def scene(self, frame: int) -> "mujoco.MjvScene":
        ghost = None if self.ghost is None else self.ghost[frame]
        self.view.update(self.robot[frame], ghost, self.look_at[frame])
        return self.view.scene


def render_video(
    robot: "Robot",
    tracks: Sequence[Track],
    path: str | Path,
    *,
    rate_hz: float,
    fps: float = 30.0,
    size: tuple[int, int] = (1280, 720),
    progress: Callable[[int, int], None] | None = None,
    slow_motion: float = 1.0,
    supersampling: float = 1.0,
) -> VideoInfo | None:
    """Writes an H.264 video of one or more tracks, side by side.

    Args:
        robot: the robot that all tracks show.
        tracks: one for each panel; a shorter one holds its last pose.
        path: the `.mp4` to write; replaced only once the new video is whole.
        rate_hz: samples a second of the tracks.
        fps: frames a second of the video.
        size: width and height, pixels, even.
        progress: called with (frames done, frames in all) after each frame.
        slow_motion: how many times slower than reality the video plays.
        supersampling: draw larger by this factor and scale down: 1 is quick, 2 has smooth edges.

    Returns:
        What was written; None, with a warning in the log, if this machine has no OpenGL to draw with.

    Raises:
        ConfigError: no track, a size that H.264 does not take, or a number that is not positive.
        OutputError: `path` cannot be written.
    """
    if not tracks:
        raise ConfigError("a video needs at least one track")
    numbers = {"rate_hz": rate_hz, "fps": fps, "slow_motion": slow_motion, "supersampling": supersampling}
    for name, value in numbers.items():
        if not (np.isfinite(value) and value > 0):
            raise ConfigError(f"{name} must be positive, found {value:g}")
    drawn_size = (round(size[0] * supersampling), round(size[1] * supersampling))
    video = VideoFile(path, drawn_size, size, fps)
    times = _frame_times(max(len(t.root_pos_w) for t in tracks), rate_hz, fps * slow_motion)
    poses = [resample(track, rate_hz, times) for track in tracks]
    ghosts = [resample(t.ghost, rate_hz, times) if t.ghost is not None else None for t in tracks]
    stage = _stage(robot, poses, ghosts, drawn_size)
    overlay = _overlay(tracks, drawn_size, slow_motion)
    try:
        screen = Offscreen(stage.model)
    except NoRendererError as error:
        _LOG.warning("%s was not written: %s; set MUJOCO_GL to a backend that works", path, error)
        return None
    with screen, video:
        panels = _panels(stage, robot, poses, ghosts, times, drawn_size)
        _film(panels, times, screen, overlay, video, progress)
    return VideoInfo(len(times), len(times) / fps)


def _film(
    panels: list[_Panel],
    times: Array,
    screen: Offscreen,
    overlay: Overlay,
    video: VideoFile,
    progress: Callable[[int, int], None] | None,
) -> None:
    """Draws the panels frame by frame, while a second thread labels and writes the frame before."""

    def finish(frame: NDArray[np.uint8], time_s: float) -> None:
        overlay.draw(frame, time_s)
        video.write(frame)

    with ThreadPoolExecutor(max_workers=1) as writer:
        written: Future[None] | None = None
        for i, time_s in enumerate(times):
            frame = screen.draw([panel.scene(i) for panel in panels])
            if written is not None:
                written.result()
            written = writer.submit(finish, frame, float(time_s))
            if progress is not None:
                progress(i + 1, len(times))
        if written is not None:
            written.result()


def _frame_times(samples: int, rate_hz: float, frames_per_s: float) -> Array:
    """Times in the motion at which frames are taken, s."""
    count = max(1, round(samples / rate_hz * frames_per_s))
    return np.arange(count) / frames_per_s


def _stage(robot: "Robot", poses: list[Array], ghosts: list[Array | None], size: tuple[int, int]) -> Stage:
    paths = np.concatenate([p[:, :2] for p in (*poses, *ghosts) if p is not None])
    return build_stage(
        robot,
        ghost=any(g is not None for g in ghosts),
        width=size[0],
        height=size[1],
        floor=np.array([paths.min(axis=0), paths.max(axis=0)]),
    )


def _overlay(tracks: Sequence[Track], size: tuple[int, int], slow_motion: float) -> Overlay:
    ghosts = [t.ghost for t in tracks if t.ghost is not None]
    legend = (ghost_rgba()[:3], ghosts[0].title or "demonstration") if ghosts else None
    note = f"slow motion 1 : {slow_motion:g}" if slow_motion != 1 else ""
    return Overlay(*size, [(t.title, t.caption) for t in tracks], legend, note)


def _panels(
    stage: Stage,
    robot: "Robot",
    poses: list[Array],
    ghosts: list[Array | None],
    times: Array,
    size: tuple[int, int],
) -> list[_Panel]:
    """All panels look from the same side and distance, each following its own robot."""
    from fastmimic.report.view import View

    span = np.ptp(robot.hip_pos_b[:, 0]) + robot.leg_length
    aspect = size[0] / len(poses) / size[1]
    half_tan = np.tan(np.radians(stage.model.vis.global_.fovy) / 2)
    distance = float(max(0.62 * span / half_tan, 0.74 * span / (half_tan * aspect)))
    azimuth = np.degrees(float(yaw_from_quat(poses[0][0, 3:7]))) + _CAMERA_AZIMUTH_DEG
    dt = times[1] - times[0] if len(times) > 1 else 1.0
    panels = []
    for pose, ghost in zip(poses, ghosts, strict=True):
        look_at = _low_pass(pose[:, :3], _CAMERA_SMOOTHING_S / dt)
        look_at[:, 2] = _LOOK_AT_HEIGHT * np.median(pose[:, 2])
        panels.append(_Panel(View(stage, azimuth, distance), pose, ghost, look_at))
    return panels


def _low_pass(path: Array, width: float) -> Array:
    """Gaussian smoothing of (n, 3) without lag, `width` in samples; the ends go on in a straight line."""
    reach = max(1, int(3 * width))
    kernel = np.exp(-0.5 * (np.arange(-reach, reach + 1) / max(width, 1e-9)) ** 2)
    kernel /= kernel.sum()
    n = len(path)
    index = np.arange(-reach, n + reach)
    inside = np.clip(index, 0, n - 1)
    mirror = np.clip(2 * inside - index, 0, n - 1)
    extended = 2 * path[inside] - path[mirror]
    return np.stack([np.convolve(column, kernel, mode="valid") for column in extended.T], axis=1)
