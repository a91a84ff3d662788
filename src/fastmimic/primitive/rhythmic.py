"""The rhythmic dynamic movement primitive (Ijspeert et al. 2013), for several dimensions at once.

With τ = T/2π and the phase φ̇ = 1/τ,

    τ ż = α (β (g − y) − z) + a f(φ),   τ ẏ = z,
    f(φ) = Σ ψᵢ wᵢ / Σ ψᵢ,              ψᵢ = exp(h (cos(φ − cᵢ) − 1)),   β = α/4,

with the centres cᵢ evenly spaced, and 1/√h their distance.

Over the phase this is a linear filter with a periodic input, y″ + α y′ + αβ y = αβ g + a f(φ). Its limit cycle is y = g
+ a s(φ) with a fixed shape s: harmonic k of s is harmonic k of f times 1 / (αβ − k² + iαk). Nothing is integrated.

Both primitives are fitted with sums in a fixed order. BLAS and LAPACK choose it by the number of threads, which would
change the last bits of a fit, the results of a seed, and the match between a run and its checkpoint.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fastmimic.base.arrays import Array
from fastmimic.base.errors import MotionError, check_positive
from fastmimic.base.jit import kernel

LEAST_SAMPLES: Final = 4
N_BASIS: Final = 100
_FUNCTIONS_PER_S: Final = 50  # of a long cycle
ALPHA: Final = 25.0  # stiffness α, per radian of phase, as in Ijspeert et al. 2013; critically damped with β = α/4
RIDGE: Final = 1e-8  # weight of the regularisation: keeps w/αβ at the motion's size without loss of accuracy


class Terms(NamedTuple):
    """A primitive at t samples: y = rest + pull g + a shape. `rest` (t or 1, d) is the response to the start and its
    velocity, relative to 0; `pull` (t or 1, 1) that to the baseline or goal; `shape` (t, d) to the forcing at a = 1."""

    rest: Array
    pull: Array
    shape: Array


@dataclass(frozen=True, eq=False)
class RhythmicDmp:
    """Rhythmic DMPs of `d` dimensions that share a phase.

    Attributes:
        weights: (d, n_basis) weights w of the forcing term.
        goal: (d,) baseline g, the mean of the fitted motion.
        period_s: T of the fitted motion, s.
    """

    weights: Array
    goal: Array
    period_s: float

    @classmethod
    def fit(cls, samples: Array, period_s: float, n_basis: int | None = None) -> "RhythmicDmp":
        """Fits one cycle by regularised least squares on the limit cycle itself.

        The weights minimise mean (y − g − s)² + `RIDGE` · mean (w/αβ)², since s is linear in w. The usual regression on
        f = y″ + αy′ + αβ(y − g) needs second derivatives, which corners at touch-down spoil. g is the mean of the
        samples, and the mean of f is made zero, so that (g, a) are not redundant with w.

        Args:
            samples: (t, d) one cycle, evenly spaced in [0, T), at least 4.
            period_s: T, s.
            n_basis: basis functions per dimension; None for 100, and of a long cycle one each 20 ms.

        Raises `MotionError` for too few or non-finite samples and `ConfigError` for a setting that is not positive.
        """
        y = checked_samples(samples, "the cycle", period_s=period_s, n_basis=N_BASIS if n_basis is None else n_basis)
        n_basis = max(N_BASIS, int(np.ceil(_FUNCTIONS_PER_S * period_s))) if n_basis is None else n_basis
        goal = y.mean(axis=0)
        return cls(_fitted_weights(n_basis, y - goal), goal, float(period_s))

    @property
    def n_basis(self) -> int:
        return self.weights.shape[1]

    def shape(self, phase: Array | float) -> Array:
        """s(φ), the limit cycle's deviation from g at a = 1, at phases (...) → (..., d)."""
        harmonics = self._harmonics
        angle = np.asarray(phase, dtype=np.float64)[..., None] * np.arange(len(harmonics))
        weights = np.where(np.arange(len(harmonics)) > 0, 2.0, 1.0)  # of the real series: k and −k together
        even = product(weights * np.cos(angle), harmonics.real)
        return even - product(weights * np.sin(angle), harmonics.imag)

    def course(self, n_samples: int) -> Terms:
        """The terms at `n_samples` evenly spaced phases of a cycle."""
        shape = self.shape(2 * np.pi * np.arange(n_samples) / n_samples)
        return Terms(np.zeros((1, len(self.goal))), np.ones((1, 1)), shape)

    def position(self, phase: Array | float, goal: Array | None = None, amplitude: Array | float = 1.0) -> Array:
        """Limit cycle y = g + a s(φ) at phases (...) → (..., d); `goal` and `amplitude` (d,) modulate it."""
        return (self.goal if goal is None else goal) + amplitude * self.shape(phase)

    @cached_property
    def _harmonics(self) -> NDArray[np.complex128]:
        """Complex amplitudes (k, d) of s for k = 0, 1, …, down to rounding error."""
        return _filtered(product(_fine_basis(self.n_basis), self.weights.T))


def basis(phase: Array, n: int) -> Array:
    """ψᵢ/Σψ at phases (...) → (..., n) of `n` functions."""
    centres = 2 * np.pi * np.arange(n) / n
    psi = np.exp((n / (2 * np.pi)) ** 2 * (np.cos(np.asarray(phase)[..., None] - centres) - 1))
    return np.asarray(psi / psi.sum(axis=-1, keepdims=True))


def _fine_basis(n: int) -> Array:
    """The functions (m, n) at m even phases: their spectrum vanishes before m/2."""
    m = 64 * int(np.ceil(n / 16))  # a good length for the FFT
    return basis(2 * np.pi * np.arange(m) / m, n)


def _filtered(forcing: Array) -> NDArray[np.complex128]:
    """Harmonics (k, d) of the limit cycles of forcings (m, d), sampled over the cycle."""
    harmonics = np.fft.rfft(forcing, axis=0)[: len(forcing) // 2] / len(forcing)
    k = np.arange(len(harmonics))[:, None]
    return harmonics / (ALPHA**2 / 4 - k**2 + 1j * ALPHA * k)


def _fitted_weights(n: int, deviation: Array) -> Array:
    """Weights (d, n) with limit cycles closest to `deviation` (t, d), the samples minus their mean."""
    t = len(deviation)
    fine = _fine_basis(n)
    harmonics = _filtered(fine)
    finer = 2 * len(harmonics) // t + 1  # a grid that holds all harmonics and every sample
    response = np.fft.irfft(harmonics, t * finer, axis=0)[::finer] * (t * finer)  # (t, n)
    normal = product(response.T, response) / t + RIDGE / (n * (ALPHA**2 / 4) ** 2) * np.eye(n)
    weights = solve_banded(in_band(normal), product(response.T, deviation) / t).T
    # the basis sums to one, so this only removes the mean of f
    return weights - product(weights, fine.mean(axis=0)[:, None])


def checked_samples(samples: NDArray[np.float64], what: str, **settings: float) -> NDArray[np.float64]:
    """A copy of the samples (t, d); `what` names them in messages. Raises `MotionError` for fewer than 4 samples or a
    value that is not finite, and `ConfigError` for a setting that is not positive."""
    for name, value in settings.items():
        check_positive(value, name)
    y = np.array(samples, dtype=np.float64)
    if y.ndim != 2 or len(y) < LEAST_SAMPLES:
        raise MotionError(f"a DMP of {what} needs at least {LEAST_SAMPLES} samples, found shape {y.shape}")
    if not np.all(np.isfinite(y)):
        raise MotionError(f"sample {int(np.argwhere(~np.isfinite(y))[0][0])} of {what} is not finite")
    return y


def product(a: Array, b: Array) -> Array:
    """a @ b for (..., k) and (k, m)."""
    rows = np.ascontiguousarray(a, dtype=np.float64).reshape(-1, a.shape[-1])
    out = np.zeros((len(rows), b.shape[1]))
    _product(rows, np.ascontiguousarray(b, dtype=np.float64), out)
    return out.reshape(*a.shape[:-1], b.shape[1])


def in_band(a: Array) -> Array:
    """The lower triangle of a (n, n) in a band of n diagonals, as `solve_banded` takes it."""
    return np.array([np.roll(row, -1 - i) for i, row in enumerate(np.tril(a))])


def solve_banded(band: Array, b: Array) -> Array:
    """Solves a x = b by Cholesky's method for b (n, m) and a symmetric positive definite a. Row i of `band` (n, w) is
    a[i, i − w + 1 : i + 1]; what is farther from the main diagonal is zero."""
    factor, x = np.array(band, dtype=np.float64, order="C"), np.array(b, dtype=np.float64, order="C")
    _solve(factor, x)
    return x


@kernel
def _product(a: Array, b: Array, out: Array) -> None:
    for i in range(a.shape[0]):
        for k in range(a.shape[1]):
            value = a[i, k]
            for j in range(b.shape[1]):
                out[i, j] += value * b[k, j]


@kernel
def _solve(a: Array, x: Array) -> None:
    """Overwrites the band `a` (n, w) of a matrix with its factor's, and `x` with the solution."""
    n, m = x.shape
    w = a.shape[1] - 1  # the column of the main diagonal
    for i in range(n):
        for j in range(max(0, i - w), i + 1):
            total = a[i, j - i + w]
            for k in range(max(0, i - w), j):
                total -= a[i, k - i + w] * a[j, k - j + w]
            a[i, j - i + w] = np.sqrt(total) if i == j else total / a[j, w]
    for i in range(n):
        for j in range(m):
            total = x[i, j]
            for k in range(max(0, i - w), i):
                total -= a[i, k - i + w] * x[k, j]
            x[i, j] = total / a[i, w]
    for i in range(n - 1, -1, -1):
        for j in range(m):
            total = x[i, j]
            for k in range(i + 1, min(n, i + w + 1)):
                total -= a[k, i - k + w] * x[k, j]
            x[i, j] = total / a[i, w]
