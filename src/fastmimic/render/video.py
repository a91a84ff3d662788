"""Videos of robots in motion, up to four in a grid, each with its demonstration as a ghost."""

import logging
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import partial
from itertools import cycle, islice
from pathlib import Path
from typing import Any, Final, TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from fastmimic.base.arrays import Array
from fastmimic.base.errors import ConfigError, check_positive
from fastmimic.base.machine import available_cores
from fastmimic.render.encoding import FPS, GIF_FPS, GIF_SIZE, PREVIEW, QUALITIES, Quality, encoded, encoder_arguments
from fastmimic.render.offscreen import NoRendererError, Offscreen, Overlay, in_any_thread
from fastmimic.render.tracks import Shown, Track
from fastmimic.render.video_scene import TILE_M, CameraView, VideoScene, build_video_scene
from fastmimic.robot import Robot

_LOG = logging.getLogger(__name__)
_CAMERA_AZIMUTH_DEG: Final = 122.0  # from the initial heading: the robot crosses the picture
_CAMERA_SMOOTHING_S: Final = 0.35
_LOOK_AT_HEIGHT: Final = 0.62  # share of the base's height; leaves room for text and shadow
MAX_PANELS: Final = 4
_MAX_PAINTERS: Final = 4

_Paint: TypeAlias = Callable[[int], Future[NDArray[np.uint8]]]  # starts drawing a frame (height, width, 3)


@dataclass(frozen=True)
class VideoInfo:
    """Number of frames written, and their duration, s."""

    frames: int
    seconds: float


def render_video(
    robot: Robot,
    tracks: Sequence[Track],
    path: str | Path,
    *,
    rate_hz: float,
    fps: float | None = None,
    size: tuple[int, int] | None = None,
    quality: Quality | str = PREVIEW,
    progress: Callable[[int, int], None] | None = None,
    slow_motion: float = 1.0,
    columns: int | None = None,
    marks: bool = True,
    clock: bool = True,
    window_s: tuple[float, float] | None = None,
    loop_m: float | None = None,
) -> VideoInfo | None:
    """Writes a video of up to four tracks: one alone, two side by side, three or four as 2 x 2.

    Args:
        robot, tracks: a robot, and what it does in each panel; a shorter track holds its last pose.
        path: the `.mp4` (H.264), `.webm` (VP9) or `.gif` to write; replaced only by a complete video.
        rate_hz: samples a second of the tracks.
        fps: frames a second of the video; if None 30, or a GIF's 20.
        size: width and height, pixels, even but for a GIF; if None the quality's, or a GIF's 640 x 360.
        quality: one of `fastmimic.render.encoding.QUALITIES`.
        progress: called with (frames done, frames in all) after each frame.
        slow_motion: how many times slower than reality the video plays.
        columns: of panels, if different from the above.
        marks: whether feet leave trails, and discs on the ground show loaded feet.
        clock: whether the time is shown.
        window_s: the part of the tracks shown, s; camera and trails also use the rest.
        loop_m: for a video played in a loop, the distance along the heading, m, to which the ground's tiles are fitted.

    Returns what was written; None, with a warning in the log, if this machine has no OpenGL to draw with. Raises
    `ConfigError` for no track or too many, a size that the format does not take, or a number that is not positive,
    `OutputError` if `path` cannot be written.
    """
    if not 1 <= len(tracks) <= MAX_PANELS:
        raise ConfigError(f"a video shows 1 to {MAX_PANELS} tracks, found {len(tracks)}")
    quality = QUALITIES[quality] if isinstance(quality, str) else quality
    gif = Path(path).suffix.lower() == ".gif"
    fps = fps if fps is not None else (GIF_FPS if gif else FPS)
    size = size if size is not None else (GIF_SIZE if gif else quality.size)
    columns = columns if columns is not None else min(len(tracks), 2)
    for name, value in (("rate_hz", rate_hz), ("fps", fps), ("slow_motion", slow_motion)):
        check_positive(value, name, shown=f"{value:g}")
    if not 1 <= columns <= len(tracks):
        raise ConfigError(f"{len(tracks)} panels cannot stand in {columns} columns")
    count = max(1, round(max(len(track.pose) for track in tracks) / rate_hz * (fps * slow_motion)))
    times = np.arange(count) / (fps * slow_motion)  # in the motion, s
    frames = _frames(times, window_s)
    arguments = encoder_arguments(path, size, fps, quality, len(frames))
    shown = [track.shown(robot, rate_hz, times, marks=marks) for track in tracks]
    video_scene = _build(robot, shown, size, quality, loop_m)
    ghost, slow = any(t.ghost is not None for t in tracks), f"slow motion 1 : {slow_motion:g}"
    note = None if not clock else slow if slow_motion != 1 else ""
    overlay = Overlay(size, [(t.title, t.caption) for t in tracks], columns, ghost=ghost, clock=note)

    try:
        with ExitStack() as stack:
            painters = []
            # without a graphics card each painter uses one core and sometimes waits
            number = min(_MAX_PAINTERS, available_cores() + 1, len(frames)) if in_any_thread() else 1
            for _ in range(number):
                panels = _panels(video_scene, robot, shown, times, columns)
                painters.append(stack.enter_context(_painter(video_scene, panels, columns)))
            write = stack.enter_context(encoded(path, arguments))
            for done, (i, frame) in enumerate(zip(frames, _painted(painters, frames), strict=True), start=1):
                overlay.draw(frame, float(times[i]))
                write(frame)
                if progress is not None:
                    progress(done, len(frames))
    except NoRendererError as error:
        _LOG.warning("%s was not written: %s; set MUJOCO_GL to a backend that works", path, error)
        return None
    return VideoInfo(len(frames), len(frames) / fps)


class _Here(Executor):
    """An executor that runs tasks at once in the submitting thread."""

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        future: Future[Any] = Future()
        future.set_result(fn(*args, **kwargs))
        return future


@contextmanager
def _painter(video_scene: VideoScene, panels: list[CameraView], columns: int) -> Iterator[_Paint]:
    """Draws frames in its own thread, to which its OpenGL context belongs; contexts of a window system stay in the
    caller's thread. Its panels are its own, since drawing poses them. Raises `NoRendererError`."""
    with ThreadPoolExecutor(max_workers=1) if in_any_thread() else _Here() as thread:
        screen = thread.submit(Offscreen, video_scene.model).result()

        def draw(frame: int) -> NDArray[np.uint8]:
            return screen.draw([panel.frame(frame) for panel in panels], columns)

        try:
            yield partial(thread.submit, draw)
        finally:
            thread.submit(screen.close).result()


def _painted(painters: list[_Paint], frames: range) -> Iterator[NDArray[np.uint8]]:
    """The frames in order; while one is used, the painters draw the next ones by turns."""
    turns = zip(cycle(painters), frames, strict=False)
    ahead = deque(paint(i) for paint, i in islice(turns, len(painters)))
    while ahead:
        frame = ahead.popleft().result()
        ahead.extend(paint(i) for paint, i in islice(turns, 1))
        yield frame


def _frames(times: Array, window_s: tuple[float, float] | None) -> range:
    """The frames, taken at `times`, in the window."""
    if window_s is None:
        return range(len(times))
    first, end = np.searchsorted(times, np.array(window_s) - 1e-9)
    if first >= end:
        raise ConfigError(f"nothing is between {window_s[0]:g} and {window_s[1]:g} s of tracks of {times[-1]:.2f} s")
    return range(int(first), int(end))


def _build(
    robot: Robot, shown: list[Shown], size: tuple[int, int], quality: Quality, loop_m: float | None
) -> VideoScene:
    paths = np.concatenate([path[:, :2] for s in shown for path in (s.root, s.ghost) if path is not None])
    tile = TILE_M
    if loop_m is not None and loop_m > 0:  # a whole number of the pattern's periods
        tile = loop_m / (2 * max(1, round(loop_m / (2 * TILE_M))))
    ghost, floor = any(s.ghost is not None for s in shown), np.array([paths.min(axis=0), paths.max(axis=0)])
    terrain = next((s.terrain for s in shown if s.terrain is not None), None)
    return build_video_scene(robot, ghost=ghost, size=size, floor=floor, quality=quality, tile=tile, terrain=terrain)


def _panels(video_scene: VideoScene, robot: Robot, shown: list[Shown], times: Array, columns: int) -> list[CameraView]:
    """Panels that all look from the same side and distance, each following its own robot."""
    span = np.ptp(robot.hip_pos_b[:, 0]) + robot.leg_length
    rows = -(-len(shown) // columns)
    picture = video_scene.model.vis.global_
    aspect = picture.offwidth / columns / (picture.offheight / rows)
    half_tan = np.tan(np.radians(picture.fovy) / 2)
    distance = float(max(0.62 * span / half_tan, 0.74 * span / (half_tan * aspect)))
    first = next((s for s in shown if s.robot is not None), shown[0])
    azimuth = np.degrees(first.yaw) + _CAMERA_AZIMUTH_DEG
    height = _LOOK_AT_HEIGHT * float(np.median(first.root[:, 2]))
    dt = times[1] - times[0] if len(times) > 1 else 1.0
    panels = []
    for each in shown:
        look_at = _low_pass(each.root, _CAMERA_SMOOTHING_S / dt)
        look_at[:, 2] = height if video_scene.terrain is None else look_at[:, 2] - 0.4 * robot.home_height
        panels.append(CameraView(video_scene, each, look_at, azimuth_deg=azimuth, distance=distance))
    return panels


def _low_pass(path: Array, width: float) -> Array:
    """Gaussian smoothing of (n, 3) without lag, `width` in samples; the ends continue in a straight line."""
    reach = max(1, int(3 * width))
    extended = np.pad(path, ((reach, reach), (0, 0)), mode="reflect", reflect_type="odd")
    return np.asarray(gaussian_filter1d(extended, width, axis=0, radius=reach)[reach:-reach])
