"""Drawing MuJoCo scenes into memory, with or without a display.

MuJoCo's own `Renderer` fixes the OpenGL backend when `mujoco` is first imported, too early to choose one for a machine
without a display. Here the context is made directly.
"""

import importlib
import logging
import os
import sys
import warnings
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    import mujoco

_LOG = logging.getLogger(__name__)
_OFF: Final = ("disable", "disabled", "off", "false", "0")
_NAMED: Final = ("egl", "osmesa", "glfw", "cgl")
BLANK: Final = (0.93, 0.95, 0.97)  # colour of an empty cell: that of the haze


class NoRendererError(Exception):
    """OpenGL cannot draw here. Callers continue without pictures and say so."""


def backends() -> tuple[str, ...]:
    """The OpenGL backends to try, in order: `MUJOCO_GL`, or without a display EGL, then OSMesa."""
    wanted = os.environ.get("MUJOCO_GL", "").strip().lower()
    if wanted in _OFF:
        return ()
    if wanted in _NAMED:
        return (wanted,)
    if sys.platform == "darwin":
        return ("cgl", "glfw")
    if not sys.platform.startswith("linux"):
        return ("glfw",)
    if os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"):
        return ("glfw", "egl", "osmesa")
    return ("egl", "osmesa")


def in_any_thread() -> bool:
    """Whether a context may be used in any thread: not those of a window system."""
    return all(backend in ("egl", "osmesa") for backend in backends())


class Offscreen:
    """An OpenGL context with a framebuffer of the model's size; raises `NoRendererError` with the backends tried."""

    def __init__(self, model: "mujoco.MjModel") -> None:
        self.width = int(model.vis.global_.offwidth)
        self.height = int(model.vis.global_.offheight)
        self._gl, self._context = _open(model, self.width, self.height)

    def draw(self, scenes: "Sequence[mujoco.MjvScene]", columns: int | None = None) -> NDArray[np.uint8]:
        """The scenes in a grid, row by row: (height, width, 3), first row on top; one row if `columns` is None."""
        import mujoco

        self._gl.make_current()
        cells = grid_cells(len(scenes), self.width, self.height, columns)
        for i, (left, top, right, bottom) in enumerate(cells):
            rect = mujoco.MjrRect(left, self.height - bottom, right - left, bottom - top)
            if i < len(scenes):
                mujoco.mjr_render(rect, scenes[i], self._context)
            else:
                mujoco.mjr_rectangle(rect, *BLANK, 1.0)
        picture = np.empty((self.height, self.width, 3), dtype=np.uint8)
        whole = mujoco.MjrRect(0, 0, self.width, self.height)
        mujoco.mjr_readPixels(picture, None, whole, self._context)
        return picture[::-1]

    def close(self) -> None:
        self._context.free()
        self._gl.free()


def grid_cells(count: int, width: int, height: int, columns: int | None = None) -> list[tuple[int, int, int, int]]:
    """Left, top, right, bottom of the cells of a grid of `width` x `height` pixels for `count` pictures, row by row, in
    pixels from the top left; the last row is completed by empty cells. One row if `columns` is None."""
    columns = count if columns is None else columns
    rows = -(-count // columns)
    x = np.linspace(0, width, columns + 1).round().astype(int).tolist()
    y = np.linspace(0, height, rows + 1).round().astype(int).tolist()
    return [(x[j], y[i], x[j + 1], y[i + 1]) for i in range(rows) for j in range(columns)]


def _open(model: "mujoco.MjModel", width: int, height: int) -> tuple[Any, Any]:
    """The first backend that works, and MuJoCo's context on it."""
    import mujoco
    from OpenGL.error import Error as OpenGLError  # type: ignore[import-untyped]

    failures = []
    for backend in backends():
        gl = None
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # GLFW warns about a missing display; we try the next one
                gl = importlib.import_module(f"mujoco.{backend}").GLContext(width, height)
                gl.make_current()
                context = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_100.value)
            mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN.value, context)
        except (ImportError, OSError, RuntimeError, AttributeError, TypeError, ValueError, OpenGLError) as error:
            # libraries that are absent or half there show in as many ways
            failures.append(f"{backend}: {' '.join(str(error).split())[:120]}")
            continue
        _LOG.debug("OpenGL backend %s", backend)
        return gl, context
    tried = "; ".join(failures) if failures else f"MUJOCO_GL={os.environ.get('MUJOCO_GL')} switches it off"
    raise NoRendererError(f"no OpenGL here ({tried})")
