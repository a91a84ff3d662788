"""Vector algebra of the kernels: 3-vectors and 3 × 3 matrices in arrays, without allocation."""

from typing import Any, Final

import numpy as np

from fastmimic.base.arrays import Array
from fastmimic.base.jit import inlined

SINGULAR: Final = 1e-4  # squared size of the motions of a matrix below which its inverse fades


@inlined
def quat_to_matrix(q: Array, out: Array) -> None:
    """Rotation matrix of the unit quaternion (w, x, y, z)."""
    w, x, y, z = q[0], q[1], q[2], q[3]
    out[0, 0], out[0, 1], out[0, 2] = 1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)
    out[1, 0], out[1, 1], out[1, 2] = 2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)
    out[2, 0], out[2, 1], out[2, 2] = 2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)


@inlined
def quat_turned(q: Any, v: Any) -> tuple[float, float, float]:
    """A vector (3,) turned by the unit quaternion (w, x, y, z): v + 2 w (u × v) + 2 u × (u × v). Arrays or tuples."""
    w, x, y, z, a, b, c = q[0], q[1], q[2], q[3], v[0], v[1], v[2]
    s, t, u = 2.0 * (y * c - z * b), 2.0 * (z * a - x * c), 2.0 * (x * b - y * a)
    return a + w * s + y * u - z * t, b + w * t + z * s - x * u, c + w * u + x * t - y * s


@inlined
def quat_about_z(yaw: float, q: Any) -> tuple[float, float, float, float]:
    """A quaternion (w, x, y, z) turned by `yaw`, rad, about the world's z."""
    c, s = np.cos(0.5 * yaw), np.sin(0.5 * yaw)
    return c * q[0] - s * q[3], c * q[1] - s * q[2], c * q[2] + s * q[1], c * q[3] + s * q[0]


@inlined
def heading_of(q: Array) -> float:
    """Yaw of a quaternion (w, x, y, z), rad."""
    return np.arctan2(2 * (q[1] * q[2] + q[0] * q[3]), 1 - 2 * (q[2] * q[2] + q[3] * q[3]))


@inlined
def turn_rows(c: float, s: float, m: Array) -> None:
    """Rz(θ) m in place, with (c, s) the cosine and sine of θ."""
    for j in range(3):
        m0, m1 = m[0, j], m[1, j]
        m[0, j], m[1, j] = c * m0 - s * m1, s * m0 + c * m1


@inlined
def rotation_error(a: Array, b: Array, out: Array) -> None:
    """Rotation vector of A Bᵀ: what turns b into a, in their common frame."""
    x = y = z = trace = 0.0
    for k in range(3):
        x += a[2, k] * b[1, k] - a[1, k] * b[2, k]
        y += a[0, k] * b[2, k] - a[2, k] * b[0, k]
        z += a[1, k] * b[0, k] - a[0, k] * b[1, k]
        trace += a[0, k] * b[0, k] + a[1, k] * b[1, k] + a[2, k] * b[2, k]
    sine = 0.5 * np.sqrt(x * x + y * y + z * z)
    angle = np.arctan2(sine, 0.5 * (trace - 1.0))
    factor = 0.5 if sine < 1e-9 else 0.5 * angle / sine
    out[0], out[1], out[2] = factor * x, factor * y, factor * z


@inlined
def copy(v: Array, out: Array) -> None:
    """Writes v (n,) to `out` (n,). `out[:] = v` compiles for longer than most kernels: it compares shapes."""
    for i in range(v.shape[0]):
        out[i] = v[i]


@inlined
def times(m: Array, v: Array, out: Array) -> None:
    """m v for a 3 × 3 matrix."""
    for i in range(3):
        out[i] = m[i, 0] * v[0] + m[i, 1] * v[1] + m[i, 2] * v[2]


@inlined
def turned(m: Array, x: float, y: float, z: float) -> tuple[float, float, float]:
    """m (x, y, z) for a 3 × 3 matrix."""
    return (
        m[0, 0] * x + m[0, 1] * y + m[0, 2] * z,
        m[1, 0] * x + m[1, 1] * y + m[1, 2] * z,
        m[2, 0] * x + m[2, 1] * y + m[2, 2] * z,
    )


@inlined
def turned_back(m: Array, x: float, y: float, z: float) -> tuple[float, float, float]:
    """mᵀ (x, y, z) for a 3 × 3 matrix."""
    return turned(m.T, x, y, z)


@inlined
def transposed_times(m: Array, v: Array, out: Array) -> None:
    """mᵀ v for a 3 × 3 matrix."""
    for i in range(3):
        out[i] = m[0, i] * v[0] + m[1, i] * v[1] + m[2, i] * v[2]


@inlined
def heading_vector(c: float, s: float, v: Array, out: Array) -> None:
    """Rz(−ψ) v with (c, s) of ψ."""
    out[0], out[1], out[2] = c * v[0] + s * v[1], -s * v[0] + c * v[1], v[2]


@inlined
def solve_damped(m: Array, x: float, y: float, z: float, out: Array) -> None:
    """The v nearest to 0 among those with m v near (x, y, z), for a 3 × 3 matrix: (mᵀ m + ε) v = mᵀ (x, y, z)."""
    a = b = c = SINGULAR
    d = e = f = 0.0
    for k in range(3):
        a, b, c = a + m[k, 0] * m[k, 0], b + m[k, 1] * m[k, 1], c + m[k, 2] * m[k, 2]
        d, e, f = d + m[k, 0] * m[k, 1], e + m[k, 0] * m[k, 2], f + m[k, 1] * m[k, 2]
    x, y, z = turned_back(m, x, y, z)
    p, q, r = b * c - f * f, e * f - d * c, d * f - b * e
    s, t, u = a * c - e * e, d * e - a * f, a * b - d * d
    scale = 1.0 / (a * p + d * q + e * r)
    out[0] = scale * (p * x + q * y + r * z)
    out[1] = scale * (q * x + s * y + t * z)
    out[2] = scale * (r * x + t * y + u * z)
