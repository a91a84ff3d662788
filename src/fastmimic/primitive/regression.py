"""What the fits of both primitives share: checked samples, and least squares with sums in a fixed order. BLAS and
LAPACK choose the order by the number of threads, which would change the last bits of a fit, the results of a seed, and
the match between a run and its checkpoint."""

import numpy as np
from numpy.typing import NDArray

from fastmimic.base.arrays import Array
from fastmimic.base.errors import ConfigError, MotionError
from fastmimic.base.jit import kernel

LEAST_SAMPLES = 4


def checked_samples(samples: NDArray[np.float64], what: str, **settings: float) -> NDArray[np.float64]:
    """A copy of the samples (t, d); `what` names them in messages. Raises `MotionError` for fewer than 4 samples or a
    value that is not finite, and `ConfigError` for a setting that is not positive."""
    for name, value in settings.items():
        if not (np.isfinite(value) and value > 0):
            raise ConfigError(f"{name} must be positive, found {value}")
    y = np.array(samples, dtype=np.float64)
    if y.ndim != 2 or len(y) < LEAST_SAMPLES:
        raise MotionError(f"a DMP of {what} needs at least {LEAST_SAMPLES} samples, found shape {y.shape}")
    if not np.all(np.isfinite(y)):
        raise MotionError(f"sample {int(np.argwhere(~np.isfinite(y))[0][0])} of {what} is not finite")
    return y


def least_squares(response: Array, wanted: Array, ridge: float, gain: float) -> Array:
    """Weights (n, d) of n functions with `response` (t, n) nearest to `wanted` (t, d); `gain` is that of the spring."""
    t, n = response.shape
    normal = product(response.T, response) / t + ridge / (n * gain**2) * np.eye(n)
    return solve_positive_definite(normal, product(response.T, wanted) / t)


def product(a: Array, b: Array) -> Array:
    """a @ b for (..., k) and (k, m)."""
    rows = np.ascontiguousarray(a, dtype=np.float64).reshape(-1, a.shape[-1])
    out = np.zeros((len(rows), b.shape[1]))
    _product(rows, np.ascontiguousarray(b, dtype=np.float64), out)
    return out.reshape(*a.shape[:-1], b.shape[1])


def solve_positive_definite(a: Array, b: Array) -> Array:
    """Solves a x = b for a symmetric positive definite a (n, n) and b (n, m) by Cholesky's method."""
    factor, x = np.array(a, dtype=np.float64, order="C"), np.array(b, dtype=np.float64, order="C")
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
    """Overwrites the lower triangle of `a` with its factor, and `x` with the solution."""
    n, m = x.shape
    for i in range(n):
        for j in range(i + 1):
            total = a[i, j]
            for k in range(j):
                total -= a[i, k] * a[j, k]
            a[i, j] = np.sqrt(total) if i == j else total / a[j, j]
    for i in range(n):
        for j in range(m):
            total = x[i, j]
            for k in range(i):
                total -= a[i, k] * x[k, j]
            x[i, j] = total / a[i, i]
    for i in range(n - 1, -1, -1):
        for j in range(m):
            total = x[i, j]
            for k in range(i + 1, n):
                total -= a[k, i] * x[k, j]
            x[i, j] = total / a[i, i]
