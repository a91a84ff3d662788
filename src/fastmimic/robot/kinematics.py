"""Closed-form kinematics of a leg with abduction, hip and knee joints.

With the leg's joints (a, h, k) and the abduction origin p₀ in the body frame, the foot is at

    p = p₀ + Rx(a) [ (s_x, d, s_z) + Ry(h) ( t + Ry(k) c ) ]

where d collects all lateral offsets (they commute with the two pitch rotations), s is the hip joint's shift in the
abduction frame, and t and c are thigh and calf in their plane.
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from fastmimic.base.arrays import Array
from fastmimic.base.jit import inlined, kernel
from fastmimic.robot.robot import Robot


@inlined
def leg_forward(g: Array, a: float, h: float, k: float) -> tuple[float, float, float]:
    """Foot centre of one leg in the body frame; `g` is its row of `Robot.geometry`."""
    ch, sh = np.cos(h), np.sin(h)
    ck, sk = np.cos(k), np.sin(k)
    ux = g[6] + ck * g[8] + sk * g[9]
    uz = g[7] - sk * g[8] + ck * g[9]
    x = g[4] + ch * ux + sh * uz
    z = g[5] - sh * ux + ch * uz
    ca, sa = np.cos(a), np.sin(a)
    return g[0] + x, g[1] + ca * g[3] - sa * z, g[2] + sa * g[3] + ca * z


@inlined
def leg_jacobian(g: Array, a: float, h: float, k: float, out: Array) -> None:
    """d(foot_b)/d(a, h, k) into `out` (3, 3); column j belongs to joint j."""
    ch, sh = np.cos(h), np.sin(h)
    ck, sk = np.cos(k), np.sin(k)
    cx = ck * g[8] + sk * g[9]
    cz = -sk * g[8] + ck * g[9]
    ux, uz = g[6] + cx, g[7] + cz
    z = g[5] - sh * ux + ch * uz
    ca, sa = np.cos(a), np.sin(a)
    out[0, 0], out[1, 0], out[2, 0] = 0.0, -sa * g[3] - ca * z, ca * g[3] - sa * z
    dx, dz = -sh * ux + ch * uz, -ch * ux - sh * uz
    out[0, 1], out[1, 1], out[2, 1] = dx, -sa * dz, ca * dz
    dx, dz = -sh * cx + ch * cz, -ch * cx - sh * cz
    out[0, 2], out[1, 2], out[2, 2] = dx, -sa * dz, ca * dz


@inlined
def contact_jacobian(g: Array, q: Array, radius: float, up: Array, out: Array) -> None:
    """d/d(a, h, k) of the point of a foot's sphere that is on the ground, into `out` (3, 3), body frame; it belongs to
    the calf, so that a foot under whose `out` nothing moves rolls. `up` (3,) is the ground's normal there."""
    leg_jacobian(g, q[0], q[1], q[2], out)
    c, s = np.cos(q[0]), np.sin(q[0])
    x, y, z = radius * up[0], radius * up[1], radius * up[2]
    out[1, 0] += z
    out[2, 0] -= y
    for j in range(1, 3):  # about (0, c, s)
        out[0, j] -= c * z - s * y
        out[1, j] -= s * x
        out[2, j] += c * x


@inlined
def leg_inverse(g: Array, px: float, py: float, pz: float) -> tuple[float, float, float, bool]:
    """Joints (a, h, k) for a foot position in the body frame, and whether the leg reaches it. If not, the angles are
    those of the nearest reachable point in the leg's plane, never NaN."""
    x, y, z = px - g[0] - g[4], py - g[1], pz - g[2]
    d = g[3]
    rr = y * y + z * z - d * d
    reachable = rr > 0.0
    w = -np.sqrt(rr) if reachable else -1e-9  # z in the abduction frame: the foot hangs below the hip
    a = np.arctan2(z, y) - np.arctan2(w, d)
    a = np.arctan2(np.sin(a), np.cos(a))
    w -= g[5]
    lt, lc = np.hypot(g[6], g[7]), np.hypot(g[8], g[9])
    r = np.hypot(x, w)
    c = (r * r - lt * lt - lc * lc) / (2.0 * lt * lc)
    if c > 1.0 or c < -1.0:
        reachable = False
        c = 1.0 if c > 1.0 else -1.0
    bend = g[10] * np.arccos(c)
    # angles of thigh and calf from straight down, in the model's zero pose (positive turns the foot backwards)
    t0, c0 = np.arctan2(-g[6], -g[7]), np.arctan2(-g[8], -g[9])
    k = bend + t0 - c0
    h = np.arctan2(-x, -w) - np.arctan2(lc * np.sin(bend), lt + lc * np.cos(bend)) - t0
    return a, np.arctan2(np.sin(h), np.cos(h)), np.arctan2(np.sin(k), np.cos(k)), reachable


@kernel
def _forward(rows: Array, q: Array, out: Array) -> None:
    for n in range(q.shape[0]):
        for leg in range(4):
            x, y, z = leg_forward(rows[leg], q[n, 3 * leg], q[n, 3 * leg + 1], q[n, 3 * leg + 2])
            out[n, leg, 0], out[n, leg, 1], out[n, leg, 2] = x, y, z


@kernel
def _jacobians(rows: Array, q: Array, out: Array) -> None:
    for n in range(q.shape[0]):
        for leg in range(4):
            leg_jacobian(rows[leg], q[n, 3 * leg], q[n, 3 * leg + 1], q[n, 3 * leg + 2], out[n, leg])


@kernel
def _inverse(rows: Array, p: Array, q: Array, reachable: Array) -> None:
    for n in range(p.shape[0]):
        for leg in range(4):
            a, h, k, ok = leg_inverse(rows[leg], p[n, leg, 0], p[n, leg, 1], p[n, leg, 2])
            q[n, 3 * leg], q[n, 3 * leg + 1], q[n, 3 * leg + 2] = a, h, k
            reachable[n, leg] = ok


def _of_legs(compute: Callable[..., None], robot: Robot, joint_pos: Array, *shape: int) -> Array:
    q = np.ascontiguousarray(joint_pos, dtype=np.float64)
    out = np.empty((q.size // 12, *shape))
    compute(robot.geometry, q.reshape(-1, 12), out)
    return out.reshape(*q.shape[:-1], *shape)


def foot_positions(robot: Robot, joint_pos: Array) -> Array:
    """Foot centres (..., 4, 3), body frame, m, at joint angles (..., 12), rad."""
    return _of_legs(_forward, robot, joint_pos, 4, 3)


def foot_jacobians(robot: Robot, joint_pos: Array) -> Array:
    """Jacobians (..., 4, 3, 3), m/rad, of each foot (body frame) by its leg's joints, at angles (..., 12), rad."""
    return _of_legs(_jacobians, robot, joint_pos, 4, 3, 3)


def inverse_kinematics(robot: Robot, foot_pos_b: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Joint angles (..., 12), rad, for foot centres (..., 4, 3), body frame, m; and whether each is reachable (..., 4).
    Joint ranges do not count. Out of reach, the angles are those of the nearest point in reach, in the leg's plane."""
    p = np.ascontiguousarray(foot_pos_b, dtype=np.float64)
    n = p.size // 12
    q, reachable = np.empty((n, 12)), np.empty((n, 4), dtype=np.bool_)
    _inverse(robot.geometry, p.reshape(-1, 4, 3), q, reachable)
    return q.reshape(*p.shape[:-2], 12), reachable.reshape(*p.shape[:-2], 4)
