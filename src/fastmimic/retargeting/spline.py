"""Deviations of a trunk over time: uniform cubic B-splines over a motion, periodic or not."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from fastmimic.base.arrays import Array

_AT_REST: Final = 3  # coefficients of a cubic B-spline that fix position, velocity and acceleration at an end


class TrunkSpline:
    """Six coordinates (x, y, z, roll, pitch, yaw) as splines with common knots, `size` coefficients each."""

    def __init__(self, n: int, rate_hz: float, periodic: bool, hz: float) -> None:
        """`hz` is the highest frequency, with two knots a period, over the `n` samples of a motion."""
        duration = n / rate_hz
        self._pieces = max(4, round(2 * hz * duration))
        self._periodic = periodic
        self._knot_s = duration / self._pieces
        self._n = n
        self.size = self._pieces if periodic else self._pieces + 3

    def basis(self, sample: NDArray[np.int_]) -> tuple[NDArray[np.int_], Array]:
        """Indices (k, 4) of the coefficients at samples (k,); weights (3, k, 4) in value and two derivatives."""
        at = sample / self._n * self._pieces
        piece = np.minimum(at.astype(int), self._pieces - 1)
        u = at - piece
        value = np.stack([(1 - u) ** 3, 3 * u**3 - 6 * u**2 + 4, -3 * u**3 + 3 * u**2 + 3 * u + 1, u**3], axis=-1) / 6
        first = np.stack([-((1 - u) ** 2), 3 * u**2 - 4 * u, -3 * u**2 + 2 * u + 1, u**2], axis=-1) / 2
        second = np.stack([1 - u, 3 * u - 2, -3 * u + 1, u], axis=-1)
        index = piece[:, None] + np.arange(4)
        if self._periodic:
            index %= self.size
        return index, np.stack([value, first / self._knot_s, second / self._knot_s**2])

    def values(self, coefficients: Array) -> Array:
        """All samples (n, 6) of coefficients (size, 6)."""
        index, weight = self.basis(np.arange(self._n))
        return np.einsum("ka,kac->kc", weight[0], coefficients[index])


class InnerSpline(TrunkSpline):
    """Deviations that vanish, with velocity and acceleration, at both ends."""

    def __init__(self, n: int, rate_hz: float, hz: float) -> None:
        super().__init__(n, rate_hz, periodic=False, hz=hz)
        self._all = self.size
        self.size = max(1, self._all - 2 * _AT_REST)

    def basis(self, sample: NDArray[np.int_]) -> tuple[NDArray[np.int_], Array]:
        """As in `TrunkSpline`, without the coefficients at the ends."""
        index, weight = super().basis(sample)
        inside = (index >= _AT_REST) & (index < self._all - _AT_REST)
        return np.where(inside, index - _AT_REST, 0), weight * inside
