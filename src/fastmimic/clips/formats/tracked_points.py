"""`Tracks`, what a file of tracked points or joints holds, in its own names, axes and unit; formats of such files."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib import import_module
from typing import Any, Final

import numpy as np

from fastmimic.base.arrays import Array
from fastmimic.base.errors import ClipError
from fastmimic.clips.clip import Clip, Skeleton
from fastmimic.clips.formats.format import Content, Format
from fastmimic.clips.formats.points import choose, clip_of

_RADIUS: Final = 0.02  # m, of drawn bones
_UNEVEN: Final = 0.25  # share of a frame's duration: times may be rounded to milliseconds


@dataclass(frozen=True, eq=False)
class Tracks:
    """Tracked points or joints; None for what the file does not say."""

    names: Sequence[str]
    positions: Array  # (t, k, 3); NaN where a point is missing
    rate_hz: float | None = None
    times: tuple[str, Array] | None = None  # name and values (t,), s, of a column of times, in place of the rate
    confidence: Array | None = None  # (t, k), 0 to 1
    unit_m: float | None = None  # the file's unit in metres
    is_level: bool = True  # whether an axis is vertical; not so in a camera's axes
    notes: tuple[str, ...] = ()  # what was assumed
    parents: Sequence[int] = ()  # of the joints of a skeleton, -1 for a root; empty for points

    def clip(self, *, fps: float | None, **options: Any) -> Clip:
        """The clip; `fps` and the options `up`, `point_map` and `frames` as in `ReadOptions`. Raises `ClipError`: no
        frame rate, unknown points, or what `clip_of` refuses."""
        rate = self._rate() if fps is None else float(fps)
        chosen, assumed = choose(self.names, options.pop("point_map"))
        bones = tuple((parent, joint) for joint, parent in enumerate(self.parents) if parent >= 0)
        skeleton = Skeleton(len(self.names), bones, (_RADIUS,) * len(bones)) if bones else None
        options |= {"confidence": self.confidence, "unit_m": self.unit_m, "is_level": self.is_level}
        return clip_of(self.positions, chosen, rate, assumed=[*self.notes, *assumed], skeleton=skeleton, **options)

    def _rate(self) -> float:
        if self.times is not None:
            column, times = self.times
            since = times - times[0]
            step = float(since[-1]) / (len(since) - 1)
            off = np.abs(since - step * np.arange(len(since)))
            if not step > 0 or off.max() > _UNEVEN * step:
                raise ClipError(f"the column '{column}' does not rise by equal steps; give the frame rate (--fps)")
            return 1.0 / step
        if self.rate_hz is None:
            raise ClipError("the file does not say how many frames a second it has; give the frame rate (--fps)")
        return self.rate_hz


def tracks_format(
    name: str,
    about: str,
    suffixes: tuple[str, ...],
    detect: Callable[[Content], bool],
    read: Callable[[Any], Tracks],
    *,
    binary: bool = False,
) -> Format:
    """The format of a file whose text (or bytes) `read` reads, with the options of all tracks. Whatever a library says
    of damaged bytes becomes a `ClipError`."""

    def parse(content: str | bytes, **options: Any) -> Clip:
        if not binary:
            return read(content).clip(**options)
        try:
            tracks = read(content)
        except ClipError:
            raise
        except Exception as error:  # noqa: BLE001 - libraries raise a dozen kinds
            raise ClipError(f"a damaged file, or none of {about}: {str(error)[:200] or type(error).__name__}") from None
        return tracks.clip(**options)

    return Format(name, about, suffixes, detect, parse, ("fps", "up", "point_map", "frames"), binary)


def most_complete(individuals: Sequence[str], positions: Array) -> tuple[int, tuple[str, ...]]:
    """Of several animals' `positions` (n, t, k, 3), the one with the most points, and a sentence if there are more."""
    best = int(np.argmax(np.isfinite(positions).sum(axis=(1, 2, 3))))
    if len(individuals) == 1:
        return best, ()
    return best, (f"of {len(individuals)} animals, {individuals[best]} is read: it has the most points",)


def library(module: str) -> Any:
    """A library of the extra `formats`; raises `ClipError` if it is not installed."""
    try:
        return import_module(module)
    except ImportError:
        raise ClipError(f"such files need {module}, which is not installed: pip install 'fastmimic[formats]'") from None
