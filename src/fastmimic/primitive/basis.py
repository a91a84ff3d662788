"""Placement of a DMP's basis functions over the cycle."""

from typing import Final

import numpy as np

from fastmimic.base.arrays import Array

_FLOOR: Final = 0.2  # share of the basis functions that is spread evenly
_SAMPLES_PER_FUNCTION: Final = 4  # least number of samples between two functions


def place_basis(samples: Array, n_basis: int) -> Array:
    """Centres c (d, n_basis) of the basis functions for one cycle (t, d) of samples, rad, ascending.

    A cycle of one stride gets evenly spaced functions, as in the paper. In a loop of several strides and pauses (a
    swing of 0.2 s in 6 s would get three of 100), their density grows with the square root of the curvature, which
    equalises the error of a second-order approximation (de Boor 1973).
    """
    t = len(samples)
    densest = max(1.0, t / (_SAMPLES_PER_FUNCTION * n_basis))
    if densest == 1.0:
        return np.tile(2 * np.pi * np.arange(n_basis) / n_basis, (samples.shape[1], 1))
    return np.stack([_equidistributed(_density(y, n_basis, densest), n_basis) for y in samples.T])


def basis_widths(centres: Array) -> Array:
    """Widths h (d, n): 1/√h is the distance to the neighbours."""
    following = np.roll(centres, -1, axis=-1)
    following[..., -1] += 2 * np.pi
    gap = following - centres
    return (0.5 * (gap + np.roll(gap, 1, axis=-1))) ** -2.0


def normalised_basis(phase: Array, centres: Array, widths: Array) -> Array:
    """ψᵢ/Σψ with ψᵢ = exp(h (cos(φ − cᵢ) − 1)) at phases (...) → (..., *centres.shape)."""
    angle = phase[(..., *(None,) * centres.ndim)] - centres
    psi = np.exp(widths * (np.cos(angle) - 1))
    return psi / psi.sum(axis=-1, keepdims=True)


def _density(y: Array, n_basis: int, densest: float) -> Array:
    """Density (t,) of the functions over the cycle, mean 1, at most `densest`."""
    t = len(y)
    k = np.arange(t // 2 + 1)
    smoothing = np.exp(-0.5 * (k * 0.25 * (2 * np.pi / n_basis)) ** 2)  # a quarter of the even distance

    def smooth(values: Array) -> Array:
        return np.fft.irfft(np.fft.rfft(values) * smoothing, t)

    spectrum = np.fft.rfft(y - y.mean())
    curvature = smooth(np.abs(np.fft.irfft(-(k**2) * spectrum * smoothing, t)))
    density = np.sqrt(np.maximum(curvature, 0.0))
    if density.mean() < 1e-12:
        return np.ones(t)
    density = smooth(_FLOOR + (1 - _FLOOR) * density / density.mean())
    excess = float(np.max(density)) - 1
    return 1 + (density - 1) * min(1.0, (densest - 1) / excess) if excess > 1e-9 else np.ones(t)


def _equidistributed(density: Array, n_basis: int) -> Array:
    """Phases (n,) with the same integral of `density` (t,) between neighbours."""
    t = len(density)
    step = 0.5 * (density + np.roll(density, -1))
    cumulative = np.concatenate([[0.0], np.cumsum(step)])
    return np.interp(np.arange(n_basis) / n_basis * cumulative[-1], cumulative, 2 * np.pi * np.arange(t + 1) / t)
