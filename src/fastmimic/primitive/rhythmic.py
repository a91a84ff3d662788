"""The rhythmic dynamic movement primitive (Ijspeert et al. 2013), for several dimensions at once.

With τ = T/2π and the phase φ̇ = 1/τ,

    τ ż = α (β (g − y) − z) + a f(φ),   τ ẏ = z,
    f(φ) = Σ ψᵢ wᵢ / Σ ψᵢ,              ψᵢ = exp(h (cos(φ − cᵢ) − 1)),   β = α/4.

Written over the phase this is a linear filter with a periodic input, y″ + α y′ + αβ y = αβ g + a f(φ), so
that its limit cycle is y = g + a s(φ) with a fixed shape s: harmonic k of s is harmonic k of f times
1 / (αβ − k² + iαk). Nothing has to be integrated. `DmpIntegrator` holds the differential form.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np
from numpy.typing import NDArray

from fastmimic.errors import MotionError

Array = NDArray[np.float64]

N_BASIS: Final = 100
ALPHA: Final = 25.0
"""As in Ijspeert et al. 2013; critically damped with β = α/4."""
RIDGE: Final = 1e-8
"""Weight of the regularisation: enough to keep w/αβ of the motion's size, too little to cost accuracy."""


@dataclass(frozen=True, eq=False)
class RhythmicDmp:
    """Rhythmic DMPs of `d` dimensions that share a phase.

    Attributes:
        weights: (d, n_basis) weights w of the forcing term: the style, fixed once fitted.
        goal: (d,) baseline g: the mean over the cycle of the fitted motion.
        period_s: T of the fitted motion, s.
        alpha: stiffness α of the filter, per radian of phase.
    """

    weights: Array
    goal: Array
    period_s: float
    alpha: float = ALPHA

    @classmethod
    def fit(
        cls,
        samples: Array,
        period_s: float,
        n_basis: int = N_BASIS,
        ridge: float = RIDGE,
        alpha: float = ALPHA,
    ) -> "RhythmicDmp":
        """Fits one cycle by regularised least squares on the limit cycle itself.

        The weights minimise mean (y − g − s)² + ridge · mean (w/αβ)². The usual regression on
        f = y″ + αy′ + αβ(y − g) needs second derivatives of the samples, which corners at touch-down spoil;
        since s is linear in w, the error that matters can be minimised directly. g is the mean of the samples
        and the mean of w is zero, so that the mean of s is zero and (g, a) are not redundant with w.

        Args:
            samples: (t, d) one cycle, evenly spaced in [0, T).
            period_s: T, s.
            n_basis: basis functions per dimension.
            ridge: weight of the regularisation, without unit.
            alpha: stiffness α.

        Raises:
            MotionError: fewer than 4 samples, or a value that is not finite.
        """
        y = np.asarray(samples, dtype=np.float64)
        if y.ndim != 2 or len(y) < 4:
            raise MotionError(f"a rhythmic DMP needs one cycle of at least 4 samples, found shape {y.shape}")
        if not np.all(np.isfinite(y)):
            raise MotionError(f"sample {int(np.argwhere(~np.isfinite(y))[0][0])} of the cycle is not finite")
        goal = y.mean(axis=0)
        unit = cls(np.eye(n_basis), np.zeros(n_basis), period_s, alpha)
        response = unit.shape(2 * np.pi * np.arange(len(y)) / len(y))  # (t, n_basis)
        gain = alpha**2 / 4
        normal = response.T @ response / len(y) + ridge / (n_basis * gain**2) * np.eye(n_basis)
        weights = np.linalg.solve(normal, response.T @ (y - goal) / len(y)).T
        return cls(weights - weights.mean(axis=1, keepdims=True), goal, float(period_s), alpha)

    @property
    def n_dims(self) -> int:
        return self.weights.shape[0]

    @property
    def n_basis(self) -> int:
        return self.weights.shape[1]

    @property
    def width(self) -> float:
        """h of the basis functions: each is as wide (1/√h) as the distance to the next (2π/n)."""
        return (self.n_basis / (2 * np.pi)) ** 2

    def forcing(self, phase: Array | float) -> Array:
        """f(φ) at phases (...) → (..., d)."""
        return _basis(np.asarray(phase, dtype=np.float64), self.n_basis, self.width) @ self.weights.T

    def shape(self, phase: Array | float) -> Array:
        """s(φ), the limit cycle's deviation from g at a = 1, at phases (...) → (..., d)."""
        return self._series(phase, self._harmonics)

    def shape_rate(self, phase: Array | float) -> Array:
        """ds/dφ at phases (...) → (..., d)."""
        k = np.arange(len(self._harmonics))
        return self._series(phase, 1j * k[:, None] * self._harmonics)

    def position(
        self, phase: Array | float, goal: Array | None = None, amplitude: Array | float = 1.0
    ) -> Array:
        """Limit cycle y = g + a s(φ) at phases (...) → (..., d); `goal` and `amplitude` (d,) modulate it."""
        return (self.goal if goal is None else goal) + amplitude * self.shape(phase)

    def velocity(
        self, phase: Array | float, amplitude: Array | float = 1.0, period_s: float | None = None
    ) -> Array:
        """ẏ = a s′(φ)/τ of the limit cycle at phases (...) → (..., d), per second."""
        tau = (self.period_s if period_s is None else period_s) / (2 * np.pi)
        return amplitude * self.shape_rate(phase) / tau

    @cached_property
    def _harmonics(self) -> NDArray[np.complex128]:
        """Complex amplitudes (k, d) of s for k = 0, 1, …; those left out are below rounding."""
        n = self.n_basis
        phase = 2 * np.pi * np.arange(8 * n) / (8 * n)
        forcing = np.fft.rfft(self.forcing(phase), axis=0)[: 2 * n] / (8 * n)
        k = np.arange(2 * n)
        filtered = forcing / (self.alpha**2 / 4 - k**2 + 1j * self.alpha * k)[:, None]
        filtered[1:] *= 2.0  # k and −k together
        return filtered

    def _series(self, phase: Array | float, harmonics: NDArray[np.complex128]) -> Array:
        angle = np.asarray(phase, dtype=np.float64)[..., None] * np.arange(len(harmonics))
        return np.cos(angle) @ harmonics.real - np.sin(angle) @ harmonics.imag


def _basis(phase: Array, n_basis: int, width: float) -> Array:
    """Normalised basis functions ψᵢ/Σψ at phases (...) → (..., n_basis)."""
    centres = 2 * np.pi * np.arange(n_basis) / n_basis
    psi = np.exp(width * (np.cos(phase[..., None] - centres) - 1))
    return psi / psi.sum(axis=-1, keepdims=True)
