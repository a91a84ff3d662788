"""Rotations as unit quaternions (w, x, y, z), body → world, over arrays with any leading shape; planar motions."""

import numpy as np

from fastmimic.base.arrays import Array


def quat_multiply(a: Array, b: Array) -> Array:
    """Hamilton product a ⊗ b (apply b, then a); (..., 4) each."""
    w1, x1, y1, z1 = np.moveaxis(np.asarray(a, dtype=np.float64), -1, 0)
    w2, x2, y2, z2 = np.moveaxis(np.asarray(b, dtype=np.float64), -1, 0)
    w = w1 * w2 - x1 * x2 - y1 * y2 - z1 * z2
    x = w1 * x2 + x1 * w2 + y1 * z2 - z1 * y2
    y = w1 * y2 - x1 * z2 + y1 * w2 + z1 * x2
    z = w1 * z2 + x1 * y2 - y1 * x2 + z1 * w2
    return np.stack([w, x, y, z], axis=-1)


def quat_conjugate(q: Array) -> Array:
    """Inverse of a unit quaternion, (..., 4)."""
    return np.asarray(q) * np.array([1.0, -1.0, -1.0, -1.0])


def quat_rotate(q: Array, v: Array) -> Array:
    """Rotates v (..., 3) by q (..., 4): body → world if q is body → world."""
    q, v = np.asarray(q), np.asarray(v)
    t = 2 * np.cross(q[..., 1:], v)
    return v + q[..., :1] * t + np.cross(q[..., 1:], t)


def quat_rotate_inverse(q: Array, v: Array) -> Array:
    """Rotates v (..., 3) by the inverse of q (..., 4): world → body."""
    return quat_rotate(quat_conjugate(q), v)


def quat_from_yaw(yaw: Array | float) -> Array:
    """Rotation by `yaw` (...) rad about world z, (..., 4)."""
    half = np.asarray(yaw, dtype=np.float64) / 2
    zero = np.zeros_like(half)
    return np.stack([np.cos(half), zero, zero, np.sin(half)], axis=-1)


def quat_from_rotvec(rotvec: Array) -> Array:
    """Rotation vector (..., 3), rad → quaternion (..., 4)."""
    rotvec = np.asarray(rotvec, dtype=np.float64)
    angle = np.linalg.norm(rotvec, axis=-1, keepdims=True)
    return np.concatenate([np.cos(angle / 2), 0.5 * np.sinc(angle / (2 * np.pi)) * rotvec], axis=-1)


def rotvec_from_quat(q: Array) -> Array:
    """Quaternion (..., 4) → the shortest rotation vector (..., 3), rad."""
    q = np.where(q[..., :1] < 0, -q, q)
    s = np.linalg.norm(q[..., 1:], axis=-1, keepdims=True)
    angle = 2 * np.arctan2(s, q[..., :1])
    factor = np.where(s > 1e-9, angle / np.where(s > 1e-9, s, 1.0), 2.0)
    return q[..., 1:] * factor


def yaw_from_quat(q: Array) -> Array:
    """Heading: angle of the body's x axis in the world's horizontal plane, (...), rad in (-π, π]."""
    w, x, y, z = np.moveaxis(np.asarray(q), -1, 0)
    return np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))


def matrix_from_quat(q: Array) -> Array:
    """Quaternion (..., 4) → rotation matrix (..., 3, 3)."""
    eye = np.broadcast_to(np.eye(3), (*np.shape(q)[:-1], 3, 3))
    return np.swapaxes(quat_rotate(np.asarray(q)[..., None, :], eye), -1, -2)


def quat_continuous(q: Array) -> Array:
    """Flips signs so that consecutive quaternions (t, 4) lie in the same hemisphere."""
    q = np.array(q, dtype=np.float64)
    flips = np.cumprod(np.where(np.sum(q[1:] * q[:-1], axis=-1) < 0, -1.0, 1.0))
    q[1:] *= flips[:, None]
    return q


def rotate_planar(angle: Array | float, xy: Array) -> Array:
    """Rotates (..., 2) by `angle` (...) rad."""
    c, s = np.cos(angle), np.sin(angle)
    return np.stack([c * xy[..., 0] - s * xy[..., 1], s * xy[..., 0] + c * xy[..., 1]], axis=-1)


def turned_about_z(v: Array, angle: Array | float) -> Array:
    """Vectors (..., 3) turned by `angle` (...) rad about z."""
    out = np.array(v)
    out[..., :2] = rotate_planar(angle, out[..., :2])
    return out


def roll_pitch_from_quat(q: Array) -> tuple[Array, Array]:
    """Roll and pitch (...), rad, of (..., 4): the ZYX Euler angles that go with `yaw_from_quat`."""
    w, x, y, z = np.moveaxis(q, -1, 0)
    roll = np.arctan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    return roll, np.arcsin(np.clip(2 * (w * y - z * x), -1.0, 1.0))


def trunk_quaternion(heading: Array, tilt: Array) -> Array:
    """Orientation (t, 4) from heading (t,), then pitch, then roll about the body's x; `tilt` (t, 2) is roll, pitch."""
    zero = np.zeros_like(heading)
    roll = quat_from_rotvec(np.stack([tilt[:, 0], zero, zero], axis=-1))
    pitch = quat_from_rotvec(np.stack([zero, tilt[:, 1], zero], axis=-1))
    return quat_multiply(quat_from_yaw(heading), quat_multiply(pitch, roll))


def planar_exp(twist: Array, share: Array) -> tuple[Array, Array]:
    """SE(2) exponential: displacement (..., 2) and rotation (...), rad, at `share` (...) of the twist (vx, vy, ω)."""
    angle = share * twist[2]
    a, b = _coefficients(angle)
    x, y = share * twist[0], share * twist[1]
    return np.stack([a * x - b * y, b * x + a * y], axis=-1), angle


def planar_log(displacement: Array) -> Array:
    """SE(2) logarithm: the twist (vx, vy, ω) with the exponential (dx, dy, dyaw) at share 1; |dyaw| < 2π."""
    x, y, angle = displacement
    a, b = _coefficients(angle)
    square = a * a + b * b
    return np.array([(a * x + b * y) / square, (-b * x + a * y) / square, angle])


def _coefficients(angle: Array) -> tuple[Array, Array]:
    """sin θ/θ and (1 − cos θ)/θ, without dividing by θ."""
    return np.sinc(angle / np.pi), angle / 2 * np.sinc(angle / (2 * np.pi)) ** 2
