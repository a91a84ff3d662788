"""The segments of a stitched motion, and the blend weights of its parts."""

from dataclasses import dataclass

import numpy as np

from fastmimic.base.arrays import Array
from fastmimic.base.errors import MotionError
from fastmimic.motion.motion import Motion
from fastmimic.motion.provenance import StitchedSegment


@dataclass(frozen=True)
class Layout:
    """The segments of a stitched motion in order of time; `n` samples in all."""

    segments: tuple[StitchedSegment, ...]
    n: int

    @classmethod
    def of(cls, motion: Motion) -> "Layout":
        """The layout of a motion; `MotionError` if the motion is not stitched or does not fit."""
        layout = cls(motion.provenance.stitched.segments, motion.n_samples)
        parts, last = motion.target.parts, 0
        for s in layout.segments:
            if not 0 <= s.part < len(parts) or not s.first == last < s.last:
                raise MotionError(f"motion '{motion.name}': segment '{s.name}' does not fit its parts or length")
            last = s.last
        if last != motion.n_samples:
            raise MotionError(f"motion '{motion.name}': its segments do not cover all of it")
        return layout

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


def too_short(segment: StitchedSegment) -> MotionError:
    return MotionError(
        f"segment '{segment.name}' with {segment.cycles} cycles is too short for its transitions; give it more cycles"
    )


def _shares(steps: Array) -> Array:
    """Each segment's own step minus that of the next."""
    return steps - np.concatenate([steps[1:], np.zeros_like(steps[:1])])
