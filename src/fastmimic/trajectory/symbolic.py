"""One instant of a quadruped as CasADi expressions: kinematics, and inverse dynamics of the whole body.

Each leg is three hinges (x, y, y) on the trunk, as in `robot.dynamics`; recursive Newton-Euler (Featherstone 2008,
ch. 5) with every vector in the body frame. A configuration has 18 coordinates: base position (world, m), roll, pitch,
yaw with R = Rz(yaw) Ry(pitch) Rx(roll), and 12 joints (rad).
"""

from functools import reduce
from typing import Any, Final, NamedTuple

import numpy as np

from fastmimic.base.arrays import Array
from fastmimic.base.conventions import GRAVITY
from fastmimic.robot import Robot
from fastmimic.robot.mjcf import composite

Expression = Any  # a CasADi SX matrix; CasADi has no types


class Instant(NamedTuple):
    """Expressions of one instant.

    Attributes:
        wrench: (6,) that is missing on the base, body frame about its origin, N and N·m: 0 for a motion that is
            consistent with the forces.
        torque: (12,) of the joints, rotor inertia included, N·m.
        feet: (12,) centres of the feet, world, m.
        knees: (4,) heights of the knees above the ground, m.
        feet_level: (12,) centres of the feet from the base's origin in the heading frame, m.
        apart: (4,) least distances between the middle lines of `NEIGHBOURS`' thighs and calves, m, by a smooth minimum.
    """

    wrench: Expression
    torque: Expression
    feet: Expression
    knees: Expression
    feet_level: Expression
    apart: Expression


NEIGHBOURS: Final = ((0, 1), (2, 3), (0, 2), (1, 3))
"""Legs that can meet: those of a pair, and those of a side."""
_ON_LEG: Final = ((1, 0.5), (1, 0.75), (1, 1.0), (2, 0.25), (2, 0.5), (2, 0.75), (2, 1.0))
"""Points whose distances count: the link, thigh or calf, and the share of its length."""
_SHARPNESS: Final = 200.0  # of the smooth minimum, 1/m: it is below the least distance by some millimetres


def rotation(axis: int, angle: Expression) -> Expression:
    """Rotation matrix about x (0), y (1) or z (2)."""
    import casadi as ca

    c, s = ca.cos(angle), ca.sin(angle)
    rows = ([[1, 0, 0], [0, c, -s], [0, s, c]], [[c, 0, s], [0, 1, 0], [-s, 0, c]], [[c, -s, 0], [s, c, 0], [0, 0, 1]])
    return ca.vertcat(*(ca.horzcat(*row) for row in rows[axis]))


def feet_in_world(robot: Robot, q: Expression) -> Expression:
    """Centres of the feet (12,), world, m."""
    import casadi as ca

    turn = _orientation(q)
    return ca.vertcat(*(q[:3] + turn @ _leg_origins(robot, leg, q)[-1] for leg in range(4)))


def instant(robot: Robot, q: Expression, v: Expression, a: Expression, force: Expression) -> Instant:
    """The robot at coordinates `q` (18,), their rates `v` and accelerations `a`, with ground reaction forces `force`
    (12,) on the lowest points of its feet, world, N."""
    import casadi as ca

    turn = _orientation(q)
    rates, rates_dot = _euler_rates(q, v)
    omega, alpha = rates @ v[3:6], rates @ a[3:6] + rates_dot @ v[3:6]
    base = turn.T @ (a[:3] + ca.DM([0, 0, GRAVITY]))
    mass, com, inertia = _trunk(robot)
    total = mass * _accelerated(base, alpha, omega, com)
    moment = inertia @ alpha + ca.cross(omega, inertia @ omega) + ca.cross(com, total)
    below = turn.T @ ca.DM([0, 0, robot.foot_radius])
    torques, feet, knees, level, lines = [], [], [], [], []
    for leg in range(4):
        joint = slice(6 + 3 * leg, 9 + 3 * leg)
        origins = _leg_origins(robot, leg, q)
        axes = [ca.DM([1, 0, 0])] + 2 * [rotation(0, q[joint][0]) @ ca.DM([0, 1, 0])]
        pushed = turn.T @ force[3 * leg : 3 * leg + 3]
        forces, moments = _link_demands(robot, leg, origins, axes, (q, v, a), (base, omega, alpha))
        forces.append(-pushed)
        moments.append(-ca.cross(origins[3] - below, pushed))
        carried_force, carried_moment = forces[3], moments[3]
        own = []
        for link in (2, 1, 0):
            carried_force, carried_moment = carried_force + forces[link], carried_moment + moments[link]
            about_joint = carried_moment - ca.cross(origins[link], carried_force)
            rotor = float(robot.armature[3 * leg + link]) * a[joint][link]
            own.append(ca.dot(axes[link], about_joint) + rotor)
        torques += own[::-1]
        total, moment = total + carried_force, moment + carried_moment
        feet.append(q[:3] + turn @ origins[3])
        knees.append((q[:3] + turn @ origins[2])[2])
        lines.append([origins[i] + share * (origins[i + 1] - origins[i]) for i, share in _ON_LEG])
        level.append(rotation(1, q[4]) @ rotation(0, q[3]) @ origins[3])
    apart = [_least_distance(lines[a], lines[b]) for a, b in NEIGHBOURS]
    return Instant(ca.vertcat(total, moment), *(ca.vertcat(*x) for x in (torques, feet, knees, level, apart)))


def _least_distance(points: list[Expression], others: list[Expression]) -> Expression:
    import casadi as ca

    near = 0
    for a in points:
        for b in others:
            near += ca.exp(-_SHARPNESS * ca.sqrt(ca.sumsqr(a - b) + 1e-6))
    return -ca.log(near) / _SHARPNESS


def _orientation(q: Expression) -> Expression:
    return rotation(2, q[5]) @ rotation(1, q[4]) @ rotation(0, q[3])


def _euler_rates(q: Expression, v: Expression) -> tuple[Expression, Expression]:
    """(3, 3) from the rates of roll, pitch and yaw to the angular velocity in the body frame, and its rate."""
    import casadi as ca

    (sr, cr), (sp, cp) = ((ca.sin(x), ca.cos(x)) for x in (q[3], q[4]))
    dr, dp = v[3], v[4]
    rows = [[1, 0, -sp], [0, cr, sr * cp], [0, -sr, cr * cp]]
    rates = [
        [0, 0, -cp * dp],
        [0, -sr * dr, cr * cp * dr - sr * sp * dp],
        [0, -cr * dr, -sr * cp * dr - cr * sp * dp],
    ]
    matrix, matrix_dot = (ca.vertcat(*(ca.horzcat(*row) for row in x)) for x in (rows, rates))
    return matrix, matrix_dot


def _accelerated(acceleration: Expression, alpha: Expression, omega: Expression, arm: Expression) -> Expression:
    """Acceleration of a point at `arm` from one that has `acceleration`."""
    import casadi as ca

    return acceleration + ca.cross(alpha, arm) + ca.cross(omega, ca.cross(omega, arm))


def _leg_frames(leg: int, q: Expression) -> list[Expression]:
    """Orientations of hip, thigh and calf against the trunk."""
    a, h, k = (q[6 + 3 * leg + j] for j in range(3))
    roll = rotation(0, a)
    return [roll, roll @ rotation(1, h), roll @ rotation(1, h + k)]


def _links(robot: Robot, leg: int) -> Array:
    """(3, 3) from each link's origin to the next one's, link frames, m."""
    g = robot.geometry[leg]
    return np.array([[g[4], g[3], g[5]], [g[6], 0.0, g[7]], [g[8], 0.0, g[9]]])


def _leg_origins(robot: Robot, leg: int, q: Expression) -> list[Expression]:
    """Origins of abduction, hip and knee, and the foot's centre, body frame, m."""
    import casadi as ca

    steps = [frame @ ca.DM(link) for frame, link in zip(_leg_frames(leg, q), _links(robot, leg), strict=True)]
    return reduce(lambda found, step: [*found, found[-1] + step], steps, [ca.DM(robot.hip_pos_b[leg])])


def _link_demands(
    robot: Robot,
    leg: int,
    origins: list[Expression],
    axes: list[Expression],
    state: tuple[Expression, Expression, Expression],
    trunk: tuple[Expression, Expression, Expression],
) -> tuple[list[Expression], list[Expression]]:
    """Force and moment about the base's origin that move each of a leg's three links. `state` is q, v, a; `trunk` is
    acceleration minus gravity, angular velocity and angular acceleration."""
    import casadi as ca

    q, v, a = state
    acceleration, omega, alpha = trunk
    forces, moments = [], []
    origin = ca.DM.zeros(3)
    for link, frame in enumerate(_leg_frames(leg, q)):
        joint = 6 + 3 * leg + link
        acceleration = _accelerated(acceleration, alpha, omega, origins[link] - origin)
        origin = origins[link]
        spin = axes[link] * v[joint]
        alpha = alpha + axes[link] * a[joint] + ca.cross(omega, spin)
        omega = omega + spin
        arm = frame @ ca.DM(robot.link_com[leg, link])
        force = float(robot.link_mass[leg, link]) * _accelerated(acceleration, alpha, omega, arm)
        inertia = frame @ ca.DM(robot.link_inertia[leg, link]) @ frame.T
        forces.append(force)
        moments.append(inertia @ alpha + ca.cross(omega, inertia @ omega) + ca.cross(origin + arm, force))
    return forces, moments


def _trunk(robot: Robot) -> tuple[float, Expression, Expression]:
    """Mass, centre of mass and central inertia of the body that carries the legs, with what is fixed to it, body
    frame."""
    import casadi as ca
    import mujoco

    model = robot.model()
    free = int(np.flatnonzero(model.jnt_type == mujoco.mjtJoint.mjJNT_FREE)[0])
    body = int(model.jnt_bodyid[free])
    if np.sum(model.body_weldid == body) > 1:  # as of a URDF, whose floating link has no mass of its own
        mass, com, inertia = composite(model, body)
        return mass, ca.DM(com), ca.DM(inertia)
    frame = np.zeros(9)
    mujoco.mju_quat2Mat(frame, model.body_iquat[body])
    axes = frame.reshape(3, 3)
    inertia = axes @ np.diag(model.body_inertia[body]) @ axes.T
    return float(model.body_mass[body]), ca.DM(model.body_ipos[body]), ca.DM(inertia)
