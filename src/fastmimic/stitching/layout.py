"""The segments of a stitched motion, as kept in its `meta`, and the blend weights of its parts."""

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fastmimic.base.arrays import Array
from fastmimic.base.errors import MotionError
from fastmimic.motion.motion import Motion


@dataclass(frozen=True)
class Span:
    """Samples [start, end) of a blend; for a foot, of a stance, or of a swing if `stands` is False."""

    start: int
    end: int
    stands: bool = True

    def smooth_step(self, sample: NDArray[np.int_]) -> Array:
        """Blend weight (k,) at samples (k,): from 0 to 1 by a polynomial with continuous second derivative."""
        u = np.clip((sample - self.start) / max(self.end - self.start, 1), 0.0, 1.0)
        return np.asarray(u**3 * (10 - 15 * u + 6 * u**2))


@dataclass(frozen=True)
class StitchedSegment:
    """One segment of a stitched motion.

    Attributes:
        name, part, cycles: of its motion: name, index into the whole's `parts`, and requested number of cycles.
        first, last: samples, last exclusive; neighbours meet in the middle of their transition.
        shift: sample t of the whole is sample (t − shift) mod n of the part.
        trunk: blend of the trunk into this segment; None for the first.
        feet: (4) stances or swings in which each leg switches to it; None for the first.
        rebuilt: samples of the transition, which belong to no part.
    """

    name: str
    part: int
    cycles: int
    first: int
    last: int
    shift: int
    trunk: Span | None = None
    feet: tuple[Span, Span, Span, Span] | None = None
    rebuilt: Span | None = None


@dataclass(frozen=True)
class Layout:
    """The segments of a stitched motion in order of time; `n` samples in all."""

    segments: tuple[StitchedSegment, ...]
    n: int

    @classmethod
    def of(cls, motion: Motion) -> "Layout":
        """The layout in a motion's `meta`; `MotionError` if the motion is not stitched or does not fit."""
        found = motion.meta.get("stitch")
        if found is None:
            raise MotionError(f"motion '{motion.name}' is not a stitched one")
        try:
            layout = cls(tuple(_segment(s) for s in found["segments"]), motion.n_samples)
        except (KeyError, TypeError, ValueError) as error:
            raise MotionError(f"motion '{motion.name}': its segments in 'meta' are not readable ({error!r})") from None
        parts, last = motion.target.parts, 0
        for s in layout.segments:
            if not 0 <= s.part < len(parts) or not s.first == last < s.last:
                raise MotionError(f"motion '{motion.name}': segment '{s.name}' does not fit its parts or length")
            last = s.last
        if last != motion.n_samples:
            raise MotionError(f"motion '{motion.name}': its segments do not cover all of it")
        return layout

    def as_meta(self) -> list[dict[str, Any]]:
        """JSON types for `of`."""
        return [asdict(s) for s in self.segments]

    def trunk_weights(self) -> Array:
        """Share (s, n) of each segment in the trunk's motion; the sum is 1."""
        steps = [np.ones(self.n)]
        steps += [s.trunk.smooth_step(np.arange(self.n)) for s in self.segments if s.trunk is not None]
        return _shares(np.stack(steps))

    def foot_weights(self) -> Array:
        """Share (s, n, 4) of each segment in each foot's motion; the sum is 1."""
        t, feet = np.arange(self.n), [s.feet for s in self.segments if s.feet is not None]
        steps = [np.ones((self.n, 4)), *(np.stack([leg.smooth_step(t) for leg in legs], axis=-1) for legs in feet)]
        return _shares(np.stack(steps))


def _shares(steps: Array) -> Array:
    """Each segment's own step minus that of the next."""
    return steps - np.concatenate([steps[1:], np.zeros_like(steps[:1])])


def _segment(found: dict[str, Any]) -> StitchedSegment:
    def span(value: dict[str, Any] | None) -> Span | None:
        return None if value is None else Span(int(value["start"]), int(value["end"]))

    feet = found["feet"]
    legs = None if feet is None else tuple(Span(int(f["start"]), int(f["end"]), bool(f["stands"])) for f in feet)
    if legs is not None and len(legs) != 4:
        raise ValueError("'feet' has not four entries")
    return StitchedSegment(
        name=str(found["name"]),
        part=int(found["part"]),
        cycles=int(found["cycles"]),
        first=int(found["first"]),
        last=int(found["last"]),
        shift=int(found["shift"]),
        trunk=span(found["trunk"]),
        feet=None if legs is None else (legs[0], legs[1], legs[2], legs[3]),
        rebuilt=span(found["rebuilt"]),
    )
