"""Derivatives of sampled signals."""

import numpy as np

from fastmimic.base.arrays import Array


def differentiate(padded: Array, dt: float) -> Array:
    """Fourth-order central differences (t, ...) of `padded` (t + 4, ...), which has two extra samples at each end."""
    return (padded[:-4] - 8 * padded[1:-3] + 8 * padded[3:-1] - padded[4:]) / (12 * dt)


def pad_open(values: Array) -> Array:
    """Two more samples at each end of (t, ...), extrapolated quadratically."""

    def beyond(a: Array, b: Array, c: Array) -> Array:
        return 3 * a - 3 * b + c

    front1 = beyond(values[0], values[1], values[2])
    front2 = beyond(front1, values[0], values[1])
    back1 = beyond(values[-1], values[-2], values[-3])
    back2 = beyond(back1, values[-1], values[-2])
    return np.concatenate([[front2, front1], values, [back1, back2]])


def pad_periodic(values: Array) -> Array:
    """Two more samples at each end of one period (t, ...)."""
    return np.concatenate([values[-2:], values, values[:2]])
