"""Which OpenGL backend is tried, and what is said when none works."""

import sys

import numpy as np
import pytest

from fastmimic.render.offscreen import NoRendererError, Offscreen, backends
from fastmimic.render.video_scene import build_video_scene
from fastmimic.robot import Robot


@pytest.fixture(autouse=True)
def bare_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "MUJOCO_GL"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(sys, "platform", "linux")


def test_a_machine_without_a_display_takes_egl() -> None:
    assert backends()[0] == "egl"


def test_a_display_is_used_and_egl_kept_in_reserve(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("DISPLAY", ":0")
    assert backends()[:2] == ("glfw", "egl")


def test_the_user_decides(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MUJOCO_GL", "OSMesa")
    assert backends() == ("osmesa",)
    monkeypatch.setenv("MUJOCO_GL", "off")
    assert backends() == ()


def test_a_backend_that_fails_is_named(a1: Robot, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MUJOCO_GL", "cgl")  # needs macOS; elsewhere its module cannot be imported
    monkeypatch.setitem(sys.modules, "mujoco.cgl", None)
    video_scene = build_video_scene(a1, ghost=False, size=(16, 16), floor=np.zeros((2, 2)))
    with pytest.raises(NoRendererError, match="no OpenGL here \\(cgl: "):
        Offscreen(video_scene.model)
