"""The constant-twist planar motion between the starts of two cycles."""

from dataclasses import dataclass

import numpy as np

from fastmimic.base.arrays import Array
from fastmimic.base.rotations import planar_exp, planar_log, rotate_planar


@dataclass(frozen=True, eq=False)
class PlanarTwist:
    """X(φ) = X₀ · exp(φ/2π · log(dx, dy, dyaw)): the planar motion of a cycle, spread evenly over its phase.

    A cyclic motion expressed in X(φ) is periodic for any turn; relative to a straight drift it would jump at the wrap.
    Near whole turns (|dyaw| > 3π/2) the twist is about a remote centre or does not exist. Whole turns are then left out
    of the frame's rotation and counted in `whole_turns`.

    Attributes:
        origin: (x, y, yaw) of X₀, world, m and rad.
        translation: (2,) translational part of the logarithm, moving frame, m a cycle.
        rotation: rotational part of the logarithm, rad a cycle.
        whole_turns: turns of the body about itself left out of `rotation`, rad a cycle.
    """

    origin: Array
    translation: Array
    rotation: float
    whole_turns: float = 0.0

    @classmethod
    def from_cycle(cls, origin: Array, cycle: Array) -> "PlanarTwist":
        """From the pose (x, y, yaw) at phase 0 and the displacement (dx, dy, dyaw) in its frame."""
        cycle = np.asarray(cycle, dtype=np.float64)
        turns = 2 * np.pi * np.round(cycle[2] / (2 * np.pi)) if abs(cycle[2]) > 1.5 * np.pi else 0.0
        angle = float(cycle[2] - turns)
        translation = planar_log(np.array([*cycle[:2], angle]))[:2]
        return cls(np.array(origin, dtype=np.float64), translation, angle, float(turns))

    def pose(self, phase: Array) -> tuple[Array, Array]:
        """World position (..., 2) and unwrapped heading (...) of X at phases (...)."""
        share = np.asarray(phase, dtype=np.float64) / (2 * np.pi)
        local, angle = planar_exp(np.array([*self.translation, self.rotation]), share)
        return self.origin[:2] + rotate_planar(self.origin[2], local), self.origin[2] + angle
