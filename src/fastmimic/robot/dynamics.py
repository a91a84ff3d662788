"""Rigid-body dynamics: one leg on a moving trunk in closed form, and the whole robot through MuJoCo. The closed form is
recursive Newton-Euler (Featherstone 2008, ch. 5) for three hinges (x, y, y), with every vector in the body frame."""

from typing import Any

import numpy as np

from fastmimic.base.arrays import Array
from fastmimic.base.jit import inlined, kernel
from fastmimic.base.vectors import turned
from fastmimic.robot.robot import Robot
from fastmimic.robot.state import pack_model


@inlined
def cross(a0: float, a1: float, a2: float, b0: float, b1: float, b2: float) -> tuple[float, float, float]:
    return a1 * b2 - a2 * b1, a2 * b0 - a0 * b2, a0 * b1 - a1 * b0


@inlined
def rotated(sa: float, ca: float, s: float, c: float, x: float, y: float, z: float) -> tuple[float, float, float]:
    """Rx(a) Ry(θ) (x, y, z), with (s, c) the sine and cosine of θ."""
    u = c * x + s * z
    w = -s * x + c * z
    return u, ca * y - sa * w, sa * y + ca * w


@inlined
def _inertia_times(
    inertia: Array, sa: float, ca: float, s: float, c: float, v0: float, v1: float, v2: float
) -> tuple[float, float, float]:
    """R I Rᵀ v with R = Rx(a) Ry(θ)."""
    w = ca * v2 - sa * v1
    y = ca * v1 + sa * v2
    x = c * v0 - s * w
    z = s * v0 + c * w
    m0, m1, m2 = turned(inertia, x, y, z)
    return rotated(sa, ca, s, c, m0, m1, m2)


@inlined
def leg_inverse_dynamics(
    model: Any, leg: int, q: Array, dq: Array, ddq: Array, omega: Array, acceleration: Array, out: Array
) -> None:
    """Joint torques `out` (3,), N·m, without rotor inertia, that give a leg the accelerations `ddq` in the air.

    `model` is a record of `MODEL`; `omega` (3,) is the trunk's angular velocity, rad/s, and `acceleration` (3,) that of
    the base's origin minus gravity, m/s² (standing still: +9.81 upwards), both in the body frame.
    """
    geometry, mass, com = model.geometry[leg], model.link_mass[leg], model.link_com[leg]
    inertia = model.link_inertia[leg]
    ca, sa = np.cos(q[0]), np.sin(q[0])
    # each link's position: origin o, link frame Rx(a) Ry(theta); forces summed about the three joint axes
    ox, oy, oz = geometry[0], geometry[1], geometry[2]
    w0, w1, w2 = omega[0], omega[1], omega[2]
    e0, e1, e2 = 0.0, 0.0, 0.0  # angular acceleration
    a0, a1, a2 = acceleration[0], acceleration[1], acceleration[2]
    r0, r1, r2 = ox, oy, oz  # from the previous origin to this one
    o1x, o1y, o1z, o2x, o2y, o2z = ox, oy, oz, ox, oy, oz
    o3x, o3y, o3z = ox, oy, oz
    theta = 0.0
    out[0], out[1], out[2] = 0.0, 0.0, 0.0
    for link in range(3):
        # acceleration of this link's origin, a point of the previous link
        b0, b1, b2 = cross(w0, w1, w2, r0, r1, r2)
        c0, c1, c2 = cross(w0, w1, w2, b0, b1, b2)
        d0, d1, d2 = cross(e0, e1, e2, r0, r1, r2)
        a0, a1, a2 = a0 + c0 + d0, a1 + c1 + d1, a2 + c2 + d2
        # axis: x for the abduction, the rolled y axis for hip and knee
        s0, s1, s2 = (1.0, 0.0, 0.0) if link == 0 else (0.0, ca, sa)
        g0, g1, g2 = cross(w0, w1, w2, s0 * dq[link], s1 * dq[link], s2 * dq[link])
        e0, e1, e2 = e0 + s0 * ddq[link] + g0, e1 + s1 * ddq[link] + g1, e2 + s2 * ddq[link] + g2
        w0, w1, w2 = w0 + s0 * dq[link], w1 + s1 * dq[link], w2 + s2 * dq[link]
        if link > 0:
            theta += q[link]
        ct, st = np.cos(theta), np.sin(theta)
        # force and moment of this link about its centre of mass
        p0, p1, p2 = rotated(sa, ca, st, ct, com[link, 0], com[link, 1], com[link, 2])
        b0, b1, b2 = cross(w0, w1, w2, p0, p1, p2)
        c0, c1, c2 = cross(w0, w1, w2, b0, b1, b2)
        d0, d1, d2 = cross(e0, e1, e2, p0, p1, p2)
        f0, f1, f2 = mass[link] * (a0 + c0 + d0), mass[link] * (a1 + c1 + d1), mass[link] * (a2 + c2 + d2)
        i0, i1, i2 = _inertia_times(inertia[link], sa, ca, st, ct, w0, w1, w2)
        n0, n1, n2 = cross(w0, w1, w2, i0, i1, i2)
        i0, i1, i2 = _inertia_times(inertia[link], sa, ca, st, ct, e0, e1, e2)
        n0, n1, n2 = n0 + i0, n1 + i1, n2 + i2
        m0, m1, m2 = cross(ox + p0 - o1x, oy + p1 - o1y, oz + p2 - o1z, f0, f1, f2)
        out[0] += n0 + m0
        if link > 0:
            m0, m1, m2 = cross(ox + p0 - o2x, oy + p1 - o2y, oz + p2 - o2z, f0, f1, f2)
            out[1] += ca * (n1 + m1) + sa * (n2 + m2)
        if link > 1:
            m0, m1, m2 = cross(ox + p0 - o3x, oy + p1 - o3y, oz + p2 - o3z, f0, f1, f2)
            out[2] += ca * (n1 + m1) + sa * (n2 + m2)
        if link == 0:
            r0, r1, r2 = rotated(sa, ca, 0.0, 1.0, geometry[4], geometry[3], geometry[5])
            o2x, o2y, o2z = ox + r0, oy + r1, oz + r2
            ox, oy, oz = o2x, o2y, o2z
        elif link == 1:
            r0, r1, r2 = rotated(sa, ca, st, ct, geometry[6], 0.0, geometry[7])
            o3x, o3y, o3z = ox + r0, oy + r1, oz + r2
            ox, oy, oz = o3x, o3y, o3z


@inlined
def leg_mass_moment(model: Any, leg: int, q: Array) -> tuple[float, float, float]:
    """Σ mass × centre of one leg's links in the body frame, kg·m; `model` is a record of `MODEL`."""
    geometry, mass, com = model.geometry[leg], model.link_mass[leg], model.link_com[leg]
    ca, sa = np.cos(q[0]), np.sin(q[0])
    ox, oy, oz = geometry[0], geometry[1], geometry[2]
    mx = my = mz = pitch = 0.0
    for link in range(3):
        pitch += q[link] if link > 0 else 0.0
        s, c = np.sin(pitch), np.cos(pitch)
        px, py, pz = rotated(sa, ca, s, c, com[link, 0], com[link, 1], com[link, 2])
        mx, my, mz = mx + mass[link] * (ox + px), my + mass[link] * (oy + py), mz + mass[link] * (oz + pz)
        x, y, z = (geometry[4], geometry[3], geometry[5]) if link == 0 else (geometry[6], 0.0, geometry[7])
        rx, ry, rz = rotated(sa, ca, s, c, x, y, z)
        ox, oy, oz = ox + rx, oy + ry, oz + rz
    return mx, my, mz


@kernel
def _inverse_dynamics(
    models: Any, q: Array, dq: Array, ddq: Array, omega: Array, acceleration: Array, out: Array
) -> None:
    model = models[0]
    for n in range(q.shape[0]):
        for leg in range(4):
            part = slice(3 * leg, 3 * leg + 3)
            leg_inverse_dynamics(
                model, leg, q[n, part], dq[n, part], ddq[n, part], omega[n], acceleration[n], out[n, part]
            )
        for j in range(12):
            out[n, j] += model.armature[j] * ddq[n, j]


def leg_torques(
    robot: Robot, joint_pos: Array, joint_vel: Array, joint_acc: Array, ang_vel_b: Array, acceleration_b: Array
) -> Array:
    """Joint torques (n, 12), N·m, rotor inertia included, that move the legs while no foot touches the ground. Joints
    are (n, 12) rad, rad/s, rad/s². `ang_vel_b` (n, 3), rad/s, is the trunk's; `acceleration_b` (n, 3), m/s², is that of
    the base's origin minus gravity, body frame."""
    given = (joint_pos, joint_vel, joint_acc, ang_vel_b, acceleration_b)
    q, dq, ddq, omega, acceleration = (np.ascontiguousarray(x, dtype=np.float64) for x in given)
    out = np.empty_like(q)
    _inverse_dynamics(pack_model(robot), q, dq, ddq, omega, acceleration, out)
    return out


def inverse_dynamics(robot: Robot, position: Array, velocity: Array, acceleration: Array) -> tuple[Array, Array]:
    """Generalised forces (k, 18) that move the whole robot without contacts, and its centre of mass (k, 3), world, m.

    `position` (k, 19) is base position (world, m), quaternion (w, x, y, z) and joints (rad); `velocity` (k, 18) is base
    velocity (world, m/s), angular velocity (body frame, rad/s) and joints (rad/s); `acceleration` its derivative.
    Forces are on the base (world, N), moment (body frame, N·m), and joint torques (N·m).
    """
    import mujoco

    model = robot.model()
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    data = mujoco.MjData(model)
    joints = [mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, name) for name in robot.joint_names]
    place = np.append(np.arange(7), model.jnt_qposadr[joints])
    degree = np.append(np.arange(6), model.jnt_dofadr[joints])
    force, com = np.zeros((len(position), 18)), np.zeros((len(position), 3))
    for k in range(len(position)):
        data.qpos[place], data.qvel[degree], data.qacc[degree] = position[k], velocity[k], acceleration[k]
        mujoco.mj_inverse(model, data)
        force[k], com[k] = data.qfrc_inverse[degree], data.subtree_com[0]
    return force, com
