"""The constant-twist planar motion that carries a cyclic motion from one cycle to the next."""

from dataclasses import dataclass

import numpy as np

from fastmimic.base.arrays import Array
from fastmimic.base.rotations import rotate_planar


@dataclass(frozen=True, eq=False)
class PlanarTwist:
    """X(φ) = X₀ · exp(φ/2π · log(dx, dy, dyaw)): the planar motion of a cycle, spread evenly over its phase.

    What a cyclic motion does relative to X(φ), expressed in X(φ), is periodic whatever the turn; relative to
    a straight drift it would jump at the wrap.

    A cycle near whole turns (|dyaw| > 3π/2) has a twist about a remote centre, or none. Then the whole turns
    are left out of the frame's rotation and counted as `whole_turns`; they belong to yaw alone.

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
        """From the pose (x, y, yaw) at phase 0 and the displacement (dx, dy, dyaw) in that pose's frame."""
        cycle = np.asarray(cycle, dtype=np.float64)
        turns = 2 * np.pi * np.round(cycle[2] / (2 * np.pi)) if abs(cycle[2]) > 1.5 * np.pi else 0.0
        angle = float(cycle[2] - turns)
        return cls(np.array(origin, dtype=np.float64), planar_log(cycle[:2], angle), angle, float(turns))

    def pose(self, phase: Array) -> tuple[Array, Array]:
        """World position (..., 2) and heading (...), not wrapped, of X at phases (...)."""
        share = np.asarray(phase, dtype=np.float64) / (2 * np.pi)
        local = planar_exp(share[..., None] * self.translation, share * self.rotation)
        return self.origin[:2] + rotate_planar(self.origin[2], local), self.origin[2] + share * self.rotation


def planar_exp(translation: Array, angle: Array) -> Array:
    """Displacement (..., 2) of the SE(2) exponential of a twist (translation (..., 2), angle (...))."""
    a, b = _v_matrix(np.asarray(angle, dtype=np.float64))
    x, y = translation[..., 0], translation[..., 1]
    return np.stack([a * x - b * y, b * x + a * y], axis=-1)


def planar_log(displacement: Array, angle: float) -> Array:
    """Translational part (2,) of the SE(2) logarithm of (displacement (2,), angle); smooth at angle 0."""
    a, b = _v_matrix(np.float64(angle))
    x, y = displacement
    return np.array([a * x + b * y, -b * x + a * y]) / (a * a + b * b)


def _v_matrix(angle: Array | np.float64) -> tuple[Array, Array]:
    """sin θ/θ and (1 − cos θ)/θ, without dividing by θ."""
    return np.sinc(angle / np.pi), angle / 2 * np.sinc(angle / (2 * np.pi)) ** 2
