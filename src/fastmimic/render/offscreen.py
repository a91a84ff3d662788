"""The frames of a video: MuJoCo scenes drawn into memory, with or without a display, and text on them, by Pillow.

MuJoCo's own `Renderer` fixes the OpenGL backend when `mujoco` is first imported, too early to choose one for a machine
without a display. Here the context is made directly.
"""

import importlib
import logging
import os
import sys
import warnings
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any, Final

import matplotlib
import mujoco
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from fastmimic.render.video_scene import GHOST_RGBA

_Rgb = tuple[float, float, float]  # 0 to 1
_Text = tuple[str, ImageFont.FreeTypeFont, tuple[int, int, int, int]]  # with its colour
_LOG = logging.getLogger(__name__)
_OFF: Final = ("disable", "disabled", "off", "false", "0")
_NAMED: Final = ("egl", "osmesa", "glfw", "cgl")
BLANK: Final = (0.93, 0.95, 0.97)  # colour of an empty cell: that of the haze
_PLATE: Final = (24, 28, 34, 190)
_WHITE: Final = (255, 255, 255, 255)
_SOFT: Final = (208, 216, 224, 255)


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

    def __init__(self, model: mujoco.MjModel) -> None:
        self.width = int(model.vis.global_.offwidth)
        self.height = int(model.vis.global_.offheight)
        self._gl, self._context = _open(model, self.width, self.height)

    def draw(self, scenes: Sequence[mujoco.MjvScene], columns: int) -> NDArray[np.uint8]:
        """The scenes in a grid of so many columns, row by row: (height, width, 3), first row on top."""
        self._gl.make_current()
        for i, (left, top, right, bottom) in enumerate(grid_cells(len(scenes), self.width, self.height, columns)):
            rect = mujoco.MjrRect(left, self.height - bottom, right - left, bottom - top)
            if i < len(scenes):
                mujoco.mjr_render(rect, scenes[i], self._context)
            else:
                mujoco.mjr_rectangle(rect, *BLANK, 1.0)
        picture = np.empty((self.height, self.width, 3), dtype=np.uint8)
        mujoco.mjr_readPixels(picture, None, mujoco.MjrRect(0, 0, self.width, self.height), self._context)
        return picture[::-1]

    def close(self) -> None:
        self._context.free()
        self._gl.free()


def grid_cells(count: int, width: int, height: int, columns: int) -> list[tuple[int, int, int, int]]:
    """Left, top, right, bottom of the cells of a grid of `width` x `height` pixels for `count` pictures, row by row, in
    pixels from the top left; the last row is completed by empty cells."""
    rows = -(-count // columns)
    x = np.linspace(0, width, columns + 1).round().astype(int).tolist()
    y = np.linspace(0, height, rows + 1).round().astype(int).tolist()
    return [(x[j], y[i], x[j + 1], y[i + 1]) for i in range(rows) for j in range(columns)]


def _open(model: mujoco.MjModel, width: int, height: int) -> tuple[Any, Any]:
    """The first backend that works, and MuJoCo's context on it."""
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


class Overlay:
    """Text that stays the same for the whole video, blended onto each frame, and a clock. Each of the `panels`, in so
    many `columns`, has a title and a caption. `ghost` says whether there is a translucent robot to be named, `clock`
    what stands after the time, such as "slow motion 1 : 4"; None for no clock."""

    def __init__(
        self, size: tuple[int, int], panels: Sequence[tuple[str, str]], columns: int, *, ghost: bool, clock: str | None
    ) -> None:
        (width, height), self._clock = size, clock
        cells = grid_cells(len(panels), width, height, columns)
        self._unit = _unit(width, height, cells[0][3])
        margin = round(18 * self._unit)
        self._plates: list[tuple[Image.Image, int, int]] = []  # with top and left
        for (title, caption), (left, top, right, _) in zip(panels, cells, strict=False):
            plate = _text_plate(title, caption, self._unit, right - left - 2 * margin)
            if plate is not None:
                self._plates.append((plate, top + margin, left + margin))
        if ghost:
            font = _font(round(18 * self._unit))
            plate = _plate([("demonstration", font, _WHITE)], round(8 * self._unit), self._unit, GHOST_RGBA[:3])
            self._plates.append((plate, height - plate.height - margin, width - plate.width - margin))
        half = max(1, round(1.5 * self._unit))  # of the bars between panels
        self._bars: list[Any] = [np.s_[:, at - half : at + half] for at in {left for left, *_ in cells} - {0}]
        self._bars += [np.s_[at - half : at + half] for at in {top for _, top, *_ in cells} - {0}]
        self._clock_at = (margin, height - margin)

    def draw(self, frame: NDArray[np.uint8], time_s: float) -> None:
        """Draws onto `frame` (height, width, 3) in place."""
        for bar in self._bars:
            frame[bar] = 255
        for plate, top, left in self._plates:
            _blend(frame, plate, top, left)
        if self._clock is not None:
            clock = _clock_plate(f"{time_s:.1f} s   {self._clock}".rstrip(), self._unit)
            _blend(frame, clock, self._clock_at[1] - clock.height, self._clock_at[0])


def _unit(width: int, height: int, cell_height: int) -> float:
    """The letters' size relative to a picture of 1280 × 720: legible in small ones, smaller in low panels."""
    return min(max(float(np.sqrt(width * height)) / 960, 0.6), max(cell_height / 330, 0.45))


def _blend(frame: NDArray[np.uint8], plate: Image.Image, top: int, left: int) -> None:
    """Draws a small RGBA picture onto a frame (height, width, 3) in place, cut off at its edges."""
    place = frame[top : top + plate.height, left : left + plate.width]
    under = Image.fromarray(place)
    under.paste(plate, mask=plate)
    place[...] = np.asarray(under)


@lru_cache(maxsize=16)
def _font(size: int, bold: bool = False) -> ImageFont.FreeTypeFont:
    """DejaVu Sans from matplotlib: the same on every machine."""
    name = "DejaVuSans-Bold.ttf" if bold else "DejaVuSans.ttf"
    return ImageFont.truetype(Path(matplotlib.get_data_path(), "fonts", "ttf", name), size)


def _fit(text: str, size: int, bold: bool, width: int) -> ImageFont.FreeTypeFont:
    """The font in the largest size up to `size` in which `text` is at most `width` pixels wide."""
    while size > 8 and _font(size, bold).getlength(text) > width:
        size -= 1
    return _font(size, bold)


def _text_plate(title: str, caption: str, unit: float, width: int) -> Image.Image | None:
    pad = round(12 * unit)
    lines = [
        (text, _fit(text, round(size * unit), bold, width - 2 * pad), color)
        for text, size, bold, color in ((title, 25, True, _WHITE), (caption, 19, False, _SOFT))
        if text
    ]
    return _plate(lines, pad, unit) if lines else None


@lru_cache(maxsize=4)
def _clock_plate(text: str, unit: float) -> Image.Image:
    return _plate([(text, _font(round(18 * unit)), _WHITE)], round(8 * unit), unit)


def _plate(lines: Sequence[_Text], pad: int, unit: float, sample: _Rgb | None = None) -> Image.Image:
    """A dark rounded plate with lines of text, and at their left a sample of a colour."""
    gap, side = round(5 * unit), round(16 * unit)
    left = 0 if sample is None else side + pad
    heights = [sum(font.getmetrics()) for _, font, _ in lines]
    width = left + 2 * pad + max(int(np.ceil(font.getlength(text))) for text, font, _ in lines)
    plate = Image.new("RGBA", (width, sum(heights) + gap * (len(lines) - 1) + 2 * pad), (0, 0, 0, 0))
    draw = ImageDraw.Draw(plate)
    draw.rounded_rectangle((0, 0, plate.width - 1, plate.height - 1), radius=round(8 * unit), fill=_PLATE)
    if sample is not None:
        fill, top = (*(round(255 * c) for c in sample), 255), (plate.height - side) // 2
        draw.rounded_rectangle((pad, top, pad + side, top + side), radius=round(3 * unit), fill=fill)
    y = pad
    for (text, font, color), height in zip(lines, heights, strict=True):
        draw.text((left + pad, y), text, font=font, fill=color)
        y += height + gap
    return plate
