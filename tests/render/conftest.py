"""Robots in motion, and whether they can be drawn here."""

from collections.abc import Callable

import numpy as np
import pytest
from video_files import RATE_HZ

from fastmimic.render.offscreen import NoRendererError, Offscreen
from fastmimic.render.tracks import Track
from fastmimic.render.video_scene import build_video_scene
from fastmimic.robot import Robot


@pytest.fixture(scope="session")
def opengl(a1: Robot) -> None:
    """Skips where nothing can be drawn: a machine without any OpenGL."""
    video_scene = build_video_scene(a1, ghost=False, size=(16, 16), floor=np.zeros((2, 2)))
    try:
        Offscreen(video_scene.model).close()
    except NoRendererError as error:
        pytest.skip(str(error))


@pytest.fixture
def walk(a1: Robot) -> Callable[..., Track]:
    """A robot that glides along x at 1 m/s, its knees swinging; `offset_m` moves it aside."""

    def make(seconds: float = 0.4, offset_m: float = 0.0, ghost: np.ndarray | None = None, **text: str) -> Track:
        t = np.arange(round(seconds * RATE_HZ)) / RATE_HZ
        root = np.stack([t, np.full_like(t, offset_m), np.full_like(t, a1.home_height)], axis=1)
        quat = np.tile([1.0, 0.0, 0.0, 0.0], (len(t), 1))
        joints = a1.home_joint_pos + 0.2 * np.sin(10 * t)[:, None]
        return Track(np.hstack([root, quat, joints]), ghost=ghost, **text)

    return make
