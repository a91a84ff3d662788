"""The discrete dynamic movement primitive (Ijspeert et al. 2013, section 2.1.1), for several dimensions at once.

With the canonical phase x, which decays from 1 over the duration T of the fitted motion,

    τ ż = α (β (g − y) − z) + a f(x),   τ ẏ = z,   T ẋ = −αₓ x,
    f(x) = x Σ ψᵢ wᵢ / Σ ψᵢ,            ψᵢ = exp(−hᵢ (x − cᵢ)²),   β = α/4,   αₓ = α/3.

The forcing vanishes with x, so y comes to rest at g for all g and a. It starts with the position and velocity of the
fitted motion. It differs from the original in two points:

- The amplitude a stands alone, as in the rhythmic primitive. The original factor g − y₀ is zero or noise for a foot
  that ends at its first height.
- τ is T or 1 s, whichever is less, instead of T. Ten seconds of an animal are many movements, and g and a would act
  only after the first of them.

The system is linear in g and a: y = rest + pull g + a s. Each term is integrated only once.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final, NamedTuple

import numpy as np

from fastmimic.base.arrays import Array
from fastmimic.base.errors import MotionError
from fastmimic.base.jit import kernel
from fastmimic.primitive.rhythmic import ALPHA, N_BASIS, RIDGE, Terms, checked_samples, product, solve_banded

MAX_S: Final = 600.0  # longest motion; a search runs all of it for each candidate
MAX_TAU_S: Final = 1.0
DECAY: Final = ALPHA / 3  # αₓ: x decays to 1/4000
_FUNCTIONS_PER_S: Final = 40.0  # least number; the knots of retargeted swings lie 25 ms apart
_ROWS_PER_FUNCTION: Final = 5  # samples of the fit for each function; more do not improve it
_CHUNK: Final = 256
_NEAR: Final = 24  # functions beyond which one is less than 1e-16 of the others
_SETTLED: Final = 35.0  # times 1/c, after which a response has decayed to 1e-14
_STEPS_PER_FUNCTION: Final = 2  # least number of integration steps
_NODES: Final = 0.5 + np.array([-np.sqrt(0.15), 0.0, np.sqrt(0.15)])
_NODE_WEIGHTS: Final = np.array([5.0, 8.0, 5.0]) / 18.0  # Gauss–Legendre on [0, 1]


@dataclass(frozen=True, eq=False)
class DiscreteDmp:
    """Discrete DMPs of `d` dimensions that share a phase.

    Attributes:
        weights: (d, n_basis) weights w of the forcing term.
        start, start_rate: (d,) y₀, and ẏ₀ T, the change of y in the whole duration at its starting velocity.
        goal: (d,) end of the fitted motion.
        duration_s: T, from the first sample to the last, s.
    """

    weights: Array
    start: Array
    start_rate: Array
    goal: Array
    duration_s: float

    @classmethod
    def fit(cls, samples: Array, duration_s: float, n_basis: int | None = None) -> "DiscreteDmp":
        """Fits a movement by regularised least squares on y itself, which is linear in w.

        The usual regression on f needs second derivatives, which corners at touch-down spoil. Start, starting velocity
        and goal are taken from the samples.

        Args:
            samples: (t, d) from start to end, evenly spaced, at least 4 and at most `MAX_S` long.
            duration_s: T, from the first to the last of them, s.
            n_basis: basis functions per dimension, None for 100; a long motion gets more, one each 25 ms.

        Raises `MotionError` for too few, too long or non-finite samples, and `ConfigError` for a bad setting.
        """
        n_basis = N_BASIS if n_basis is None else n_basis
        y = checked_samples(samples, "the motion", duration_s=duration_s, n_basis=n_basis)
        if duration_s > MAX_S:
            said = f"a motion that does not repeat lasts {MAX_S:g} s at most, found {duration_s:.1f} s"
            raise MotionError(f"{said}; choose a part (--frames)")
        n = max(n_basis, int(np.ceil(_FUNCTIONS_PER_S * duration_s)))
        start_rate = (len(y) - 1) * (-1.5 * y[0] + 2.0 * y[1] - 0.5 * y[2])
        found = cls(np.zeros((y.shape[1], n)), y[0], start_rate, y[-1], float(duration_s))
        rest, pull = found._unforced(len(y))
        left = y - rest - pull * y[-1]
        every = max(1, len(y) // (_ROWS_PER_FUNCTION * n))
        rows = np.unique(np.append(np.arange(0, len(y), every), len(y) - 1))
        band, right = _normal_equations(found, left, rows)
        gain = found.pole**2 + (0.5 * n) ** 2  # forcing grows with the square of a motion's frequency
        band[:, -1] += RIDGE * len(rows) / (n * gain**2)
        forces = solve_banded(band, right)
        return replace(found, weights=(forces / found.centres[:, None]).T / (duration_s / found.tau_s) ** 2)

    @property
    def n_basis(self) -> int:
        return self.weights.shape[1]

    @property
    def tau_s(self) -> float:
        return min(self.duration_s, MAX_TAU_S)

    @property
    def pole(self) -> float:
        """c of the spring's double pole at −c (since β = α/4), per duration."""
        return ALPHA / 2 * max(1.0, self.duration_s / MAX_TAU_S)

    @cached_property
    def centres(self) -> Array:
        """Centres c (n_basis,) of the basis functions, in x, evenly spaced in time."""
        return np.exp(-DECAY * np.arange(self.n_basis) / max(self.n_basis - 1, 1))

    @cached_property
    def widths(self) -> Array:
        """Widths h (n_basis,) of the basis functions: 1/√(2h) is the distance to the next one."""
        if self.n_basis == 1:
            return np.ones(1)
        gap = self.centres[:-1] - self.centres[1:]
        return 0.5 * np.append(gap, gap[-1]) ** -2.0

    def course(self, n_samples: int) -> Terms:
        """The terms at `n_samples` (at least 2) evenly spaced times; `pull` is 0 at the start, about 1 at the end."""
        rest, pull = self._unforced(n_samples)
        weights = self.weights.T * (self.duration_s / self.tau_s) ** 2  # time is in units of T here
        return Terms(rest, pull, _course(self, weights, n_samples))

    def _unforced(self, n_samples: int) -> tuple[Array, Array]:
        """`rest` (t, d) and `pull` (t, 1) of the critically damped spring."""
        c, s = self.pole, np.linspace(0.0, 1.0, n_samples)[:, None]
        fading = np.exp(-c * s)
        return fading * ((1 + c * s) * self.start + s * self.start_rate), 1 - fading * (1 + c * s)

    def position(self, n_samples: int, goal: Array | None = None, amplitude: Array | float = 1.0) -> Array:
        """y (t, d) at `n_samples` times from start to end; `goal` and `amplitude` (d,) modulate it."""
        rest, pull, shape = self.course(n_samples)
        return rest + pull * (self.goal if goal is None else goal) + amplitude * shape


def _basis(x: Array, centres: Array, widths: Array) -> Array:
    """ψᵢ/Σψ at phases (...) → (..., n) of functions with centres and widths (n,); beyond the last one, that alone."""
    exponent = -widths * (x[..., None] - centres) ** 2
    psi = np.exp(exponent - exponent.max(axis=-1, keepdims=True))
    return psi / psi.sum(axis=-1, keepdims=True)


class _Window(NamedTuple):
    """Steps `first` to `last` of an integration, exclusive: the functions that act in them and `lasting` before them,
    whose responses have not decayed yet."""

    first: int
    last: int
    acting: slice
    lasting: slice


def _windows(dmp: DiscreteDmp, n_samples: int) -> tuple[list[_Window], int]:
    """Windows of the integration, so that its cost is linear in the duration, and its steps for each sample."""
    n = dmp.n_basis
    finer = max(1, int(np.ceil(_STEPS_PER_FUNCTION * n / (n_samples - 1))))
    steps = finer * (n_samples - 1)
    lasting = int(np.ceil(_SETTLED / dmp.pole * (n - 1)))
    found = []
    for first in range(0, steps, _CHUNK):
        last = min(first + _CHUNK, steps)
        low = max(0, (first * (n - 1)) // steps - _NEAR)
        high = min(n, -(-last * (n - 1) // steps) + _NEAR + 1)
        found.append(_Window(first, last, slice(low, high), slice(max(0, low - lasting), high)))
    return found, finer


def _acting(dmp: DiscreteDmp, window: _Window, steps: int) -> tuple[Array, Array]:
    """Phases (k, 3) at the quadrature's nodes of the window's k steps, and the normalised functions that act there."""
    x = np.exp(-DECAY * (np.arange(window.first, window.last)[:, None] + _NODES) / steps)
    return x, _basis(x, dmp.centres[window.acting], dmp.widths[window.acting])


def _course(dmp: DiscreteDmp, weights: Array, n_samples: int) -> Array:
    """Response (t, d) from rest to the forcing of weights (n, d): the spring's is exact, the forcing's a quadrature."""
    windows, finer = _windows(dmp, n_samples)
    steps = windows[-1].last
    out, rate = np.zeros((steps + 1, weights.shape[1])), np.zeros(weights.shape[1])
    for window in windows:
        x, basis = _acting(dmp, window, steps)
        forcing = x[..., None] * product(basis, weights[window.acting])
        part = out[window.first : window.last + 1]
        _advance(forcing, 1.0 / steps, dmp.pole, rate, part)
    return out[::finer]


def _normal_equations(dmp: DiscreteDmp, wanted: Array, rows: Array) -> tuple[Array, Array]:
    """Band (n, w) and right side (n, d) of the normal equations: what the functions, each with weight 1/c, respond at
    samples `rows`, as near as possible to `wanted` (t, d). Distant functions do not overlap."""
    windows, finer = _windows(dmp, len(wanted))
    steps, n = windows[-1].last, dmp.n_basis
    band, right = np.zeros((n, max(w.lasting.stop - w.lasting.start for w in windows))), np.zeros((n, wanted.shape[1]))
    at, rate = np.zeros(n), np.zeros(n)
    for window in windows:
        x, basis = _acting(dmp, window, steps)
        low, acting, lasting = window.lasting.start, window.acting, window.lasting
        forcing = np.zeros((*x.shape, lasting.stop - low))
        forcing[..., acting.start - low :] = x[..., None] * basis / dmp.centres[acting]
        response, moving = np.zeros((len(x) + 1, lasting.stop - low)), rate[lasting]
        response[0] = at[lasting]
        _advance(forcing, 1.0 / steps, dmp.pole, moving, response)
        at[lasting], rate[lasting] = response[-1], moving
        here = rows[(finer * rows > window.first) & (finer * rows <= window.last)]
        _add_products(response[finer * here - window.first], wanted[here], low, band, right)
    return band, right


@kernel
def _add_products(response: Array, wanted: Array, low: int, band: Array, right: Array) -> None:
    """Adds Aᵀ A to a band and Aᵀ b to a right side, for A (r, m) with columns from `low` on and b (r, d)."""
    diagonal = band.shape[1] - 1
    for r in range(response.shape[0]):
        for i in range(response.shape[1]):
            value = response[r, i]
            for j in range(i + 1):
                band[low + i, diagonal + j - i] += value * response[r, j]
            for d in range(wanted.shape[1]):
                right[low + i, d] += value * wanted[r, d]


@kernel
def _advance(forcing: Array, delta: float, c: float, rate: Array, out: Array) -> None:
    """Rows 1 … k of `out` (k + 1, d) from row 0, with `rate` (d,) = τ ẏ, under forcing (k, 3, d)."""
    decay = np.exp(-c * delta)
    for i in range(forcing.shape[0]):
        for j in range(forcing.shape[2]):
            y, z = out[i, j], rate[j]
            following = decay * ((1 + c * delta) * y + delta * z)
            moving = decay * (-(c**2) * delta * y + (1 - c * delta) * z)
            for q in range(forcing.shape[1]):
                left = delta * (1 - _NODES[q])
                push = delta * _NODE_WEIGHTS[q] * np.exp(-c * left) * forcing[i, q, j]
                following += left * push
                moving += (1 - c * left) * push
            out[i + 1, j] = following
            rate[j] = moving
