"""How much moment a turn of the trunk takes while feet stand.

The stance QP's body is the whole robot, rigid. Standing legs do not turn with the trunk: their feet stay, they fold
under it, and their rotors turn. For the A1 in roll on four feet, turning the trunk takes about half of the rigid body's
moment, so feedback that assumes the rigid body is that much too stiff. The right inertia is the trunk's with the feet
held: the operational-space inertia of the constrained robot (Khatib 1987; Featherstone 2008, ch. 8).
"""

from typing import Any, Final

import numpy as np

from fastmimic.base.arrays import Array
from fastmimic.base.jit import inlined, kernel, record_dtype
from fastmimic.base.vectors import copy
from fastmimic.robot.dynamics import cross, rotated
from fastmimic.robot.kinematics import leg_jacobian

WORK: Final = record_dtype(
    [
        ("jacobian", "f8", (3, 3)),
        ("turning", "f8", (3, 3)),  # of the trunk about each axis
        ("rates", "f8", (3, 3)),  # of the joints meanwhile
        ("velocity", "f8", (3, 3)),  # of a link's centre
        ("carried", "f8", (3, 3)),  # the same if the leg were rigid
        ("spin", "f8", (3, 3)),  # angular velocity of the link
        ("rigid", "f8", (3, 3)),
        ("origins", "f8", (3, 3)),  # of the joints
        ("place", "f8", (3,)),  # of the link's centre
        ("vector", "f8", (3,)),
    ]
)  # work memory, body frame
_LEAST_REACH: Final = 1e-6  # m³, |det J| below which a leg is stretched so far that it counts as rigid


@inlined
def _turned_back(sa: float, ca: float, s: float, c: float, v: Array, out: Array) -> None:
    """(Rx(a) Ry(θ))ᵀ v."""
    y, z = ca * v[1] + sa * v[2], -sa * v[1] + ca * v[2]
    out[0], out[1], out[2] = c * v[0] - s * z, y, s * v[0] + c * z


@inlined
def _solve_3x3(a: Array, b: Array, det: float, out: Array) -> None:
    """x of a x = b, by Cramer's rule."""
    for k in range(3):
        i, j = (k + 1) % 3, (k + 2) % 3
        cx = a[1, i] * a[2, j] - a[2, i] * a[1, j]
        cy = a[2, i] * a[0, j] - a[0, i] * a[2, j]
        cz = a[0, i] * a[1, j] - a[1, i] * a[0, j]
        out[k] = (cx * b[0] + cy * b[1] + cz * b[2]) / det


@kernel
def add_standing_leg(model: Any, leg: int, q: Array, foot: Array, com: Array, work: Any, inertia: Array) -> None:
    """Changes `inertia` (3, 3), kg·m², body axes, about the centre of mass, by holding one leg's foot in place. `q`
    (3,) are the leg's joints, `foot` and `com` (3,) in m, body frame; `work` is of `WORK`."""
    g, jacobian, rates = model.geometry[leg], work.jacobian, work.rates
    leg_jacobian(g, q[0], q[1], q[2], jacobian)
    cx, cy, cz = cross(jacobian[0, 1], jacobian[1, 1], jacobian[2, 1], jacobian[0, 2], jacobian[1, 2], jacobian[2, 2])
    det = jacobian[0, 0] * cx + jacobian[1, 0] * cy + jacobian[2, 0] * cz
    if abs(det) < _LEAST_REACH:
        return
    ca, sa = np.cos(q[0]), np.sin(q[0])
    fx, fy, fz = foot[0] - com[0], foot[1] - com[1], foot[2] - com[2]
    for axis in range(3):  # joint rates that hold the foot while the trunk turns with 1 rad/s about the axis
        w = work.turning[axis]
        w[:] = 0.0
        w[axis] = 1.0
        vx, vy, vz = cross(w[0], w[1], w[2], fx, fy, fz)
        work.vector[0], work.vector[1], work.vector[2] = -vx, -vy, -vz
        _solve_3x3(jacobian, work.vector, det, rates[axis])
        for other in range(axis + 1):
            total = 0.0
            for joint in range(3):
                total += model.armature[3 * leg + joint] * rates[axis, joint] * rates[other, joint]
            inertia[axis, other] += total
    origins = work.origins
    copy(g[0:3], origins[0])
    origins[1, 0], origins[1, 1], origins[1, 2] = rotated(sa, ca, 0.0, 1.0, g[4], g[3], g[5])
    s, c = np.sin(q[1]), np.cos(q[1])
    origins[2, 0], origins[2, 1], origins[2, 2] = rotated(sa, ca, s, c, g[6], 0.0, g[7])
    for k in range(3):
        origins[1, k] += origins[0, k]
        origins[2, k] += origins[1, k]
    theta = 0.0
    for link in range(3):
        theta += q[link] if link > 0 else 0.0
        s, c = np.sin(theta), np.cos(theta)
        place, com_link = work.place, model.link_com[leg, link]
        place[0], place[1], place[2] = rotated(sa, ca, s, c, com_link[0], com_link[1], com_link[2])
        for k in range(3):
            place[k] += origins[link, k]
        for axis in range(3):
            _link_motion(work, axis, link, sa, ca, com)
            for other in range(axis + 1):
                total = 0.0
                for k in range(3):
                    total += work.velocity[axis, k] * work.velocity[other, k]
                    total -= work.carried[axis, k] * work.carried[other, k]
                inertia[axis, other] += model.link_mass[leg, link] * total
            _turned_back(sa, ca, s, c, work.spin[axis], work.vector)
            copy(work.vector, work.spin[axis])
            _turned_back(sa, ca, s, c, work.turning[axis], work.vector)
            copy(work.vector, work.rigid[axis])
            for other in range(axis + 1):
                total = 0.0
                for a in range(3):
                    for b in range(3):
                        held = work.spin[axis, a] * work.spin[other, b] - work.rigid[axis, a] * work.rigid[other, b]
                        total += model.link_inertia[leg, link, a, b] * held
                inertia[axis, other] += total
    for axis in range(3):
        for other in range(axis):
            inertia[other, axis] = inertia[axis, other]


@inlined
def _link_motion(work: Any, axis: int, link: int, sa: float, ca: float, com: Array) -> None:
    """Velocity and angular velocity of a link while the trunk turns about `com` and the foot is held, and the velocity
    of a rigid leg (`carried`)."""
    w, place, rates = work.turning[axis], work.place, work.rates[axis]
    v, spin = work.velocity[axis], work.spin[axis]
    v[0], v[1], v[2] = cross(w[0], w[1], w[2], place[0] - com[0], place[1] - com[1], place[2] - com[2])
    copy(v, work.carried[axis])
    copy(w, spin)
    for joint in range(link + 1):
        s0, s1, s2 = (1.0, 0.0, 0.0) if joint == 0 else (0.0, ca, sa)
        o = work.origins[joint]
        dx, dy, dz = cross(s0, s1, s2, place[0] - o[0], place[1] - o[1], place[2] - o[2])
        v[0] += dx * rates[joint]
        v[1] += dy * rates[joint]
        v[2] += dz * rates[joint]
        spin[0] += s0 * rates[joint]
        spin[1] += s1 * rates[joint]
        spin[2] += s2 * rates[joint]
