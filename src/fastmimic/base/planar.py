"""Planar rigid motions, SE(2): the exponential and logarithm of a constant twist."""

import numpy as np

from fastmimic.base.arrays import Array


def planar_exp(twist: Array, share: Array) -> tuple[Array, Array]:
    """Displacement (..., 2) and rotation (...), rad, after `share` (...) of the twist (vx, vy, ω)."""
    angle = share * twist[2]
    a, b = _coefficients(angle)
    x, y = share * twist[0], share * twist[1]
    return np.stack([a * x - b * y, b * x + a * y], axis=-1), angle


def planar_log(displacement: Array) -> Array:
    """The twist (vx, vy, ω) with the exponential (dx, dy, dyaw) at share 1; |dyaw| < 2π."""
    x, y, angle = displacement
    a, b = _coefficients(angle)
    square = a * a + b * b
    return np.array([(a * x + b * y) / square, (-b * x + a * y) / square, angle])


def _coefficients(angle: Array) -> tuple[Array, Array]:
    """sin θ/θ and (1 − cos θ)/θ, without dividing by θ."""
    return np.sinc(angle / np.pi), angle / 2 * np.sinc(angle / (2 * np.pi)) ** 2
