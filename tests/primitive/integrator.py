"""The differential form of the rhythmic DMP, integrated step by step."""

from typing import Final

import numpy as np

from fastmimic.base.arrays import Array
from fastmimic.primitive.rhythmic import ALPHA, RhythmicDmp, basis

# Gauss–Legendre nodes and weights on [0, 1]
_NODES: Final = 0.5 + np.array([-np.sqrt(0.15), 0.0, np.sqrt(0.15)])
_NODE_WEIGHTS: Final = np.array([5.0, 8.0, 5.0]) / 18.0


class DmpIntegrator:
    """Integrates τż = α(β(g − y) − z) + a f(φ), τẏ = z, φ̇ = 1/τ step by step.

    `goal` (d,), `amplitude` (d,) and `period_s` may be changed between steps. The position stays continuous
    at any change; the velocity stays continuous at changes of goal and amplitude, and scales with 1/τ when
    the period jumps (the state is z = τẏ), so ramp the period if that matters.

    The linear part is advanced exactly and the forcing by quadrature, so that no step is too long for it.
    """

    def __init__(self, dmp: RhythmicDmp, phase: float = 0.0, position: Array | None = None) -> None:
        """Starts on the limit cycle at `phase` (rad), or at rest at `position` (d,)."""
        self.dmp = dmp
        self.goal = np.array(dmp.goal, dtype=np.float64)
        self.amplitude = np.ones(len(dmp.goal))
        self.period_s = dmp.period_s
        self.phase = float(phase)
        self._longest = np.pi / dmp.n_basis  # half the distance of two basis functions
        if position is None:
            self.position = dmp.position(self.phase)
            self._z = shape_rate(dmp, self.phase)
        else:
            self.position = np.array(position, dtype=np.float64)
            self._z = np.zeros(len(dmp.goal))

    @property
    def velocity(self) -> Array:
        """ẏ (d,), per second."""
        return self._z * (2 * np.pi / self.period_s)

    def step(self, dt: float) -> Array:
        """Advances by `dt` seconds and returns the position (d,)."""
        total = 2 * np.pi * dt / self.period_s
        parts = max(1, int(np.ceil(total / self._longest)))
        for _ in range(parts):
            self._advance(total / parts)
        return self.position

    def _advance(self, delta: float) -> None:
        c = ALPHA / 2  # double pole at −c, since β = α/4
        decay = np.exp(-c * delta)
        offset = self.position - self.goal
        y = decay * ((1 + c * delta) * offset + delta * self._z)
        z = decay * (-(c**2) * delta * offset + (1 - c * delta) * self._z)
        left = delta * (1 - _NODES)  # phase from each node to the end of the step
        response = (delta * _NODE_WEIGHTS * np.exp(-c * left))[:, None] * forcing(self.dmp, self.phase + delta * _NODES)
        self.position = self.goal + y + self.amplitude * (left @ response)
        self._z = z + self.amplitude * ((1 - c * left) @ response)
        self.phase = (self.phase + delta) % (2 * np.pi)


def forcing(dmp: RhythmicDmp, phase: Array) -> Array:
    """f(φ) at phases (t,) → (t, d)."""
    return basis(phase, dmp.n_basis) @ dmp.weights.T


def shape_rate(dmp: RhythmicDmp, phase: Array | float) -> Array:
    """ds/dφ at phases (...) → (..., d), by the Fourier series of samples of s."""
    n = 1024
    harmonics = np.fft.rfft(dmp.shape(2 * np.pi * np.arange(n) / n), axis=0) / n
    k = np.arange(len(harmonics))
    return np.asarray(2.0 * (np.exp(1j * np.multiply.outer(phase, k)) @ (1j * k[:, None] * harmonics)).real)


def velocity(dmp: RhythmicDmp, phase: float, amplitude: float = 1.0, period_s: float | None = None) -> Array:
    """ẏ = a s′(φ)/τ of the limit cycle (d,), per second."""
    tau = (dmp.period_s if period_s is None else period_s) / (2 * np.pi)
    return amplitude * shape_rate(dmp, phase) / tau
