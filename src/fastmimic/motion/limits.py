"""The ground wrench that a motion needs, and how much of a robot's limits it uses: inverse dynamics of the whole robot,
with the ground reaction forces that give it within the friction of the ground at the least joint torques."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from fastmimic.base.arrays import Array, Flags, Indices
from fastmimic.base.conventions import GRAVITY, GROUND_FRICTION
from fastmimic.base.rotations import (
    quat_from_yaw,
    quat_multiply,
    quat_rotate,
    quat_rotate_inverse,
    rotate_planar,
    yaw_from_quat,
)
from fastmimic.motion.motion import Motion
from fastmimic.robot import Robot
from fastmimic.robot.dynamics import inverse_dynamics
from fastmimic.robot.kinematics import foot_jacobians

_TORQUE_WEIGHT: Final = 1e-3  # of squared joint torques (limits) against the squared residual acceleration (g)
_FORCE_WEIGHT: Final = 1e-6  # of the squared ground forces (weights)
_PYRAMID: Final = np.array([[1.0, 0.0, 1.0], [-1.0, 0.0, 1.0], [0.0, 1.0, 1.0], [0.0, -1.0, 1.0]])


def differentiate(padded: Array, dt: float) -> Array:
    """Fourth-order central differences (t, ...) of `padded` (t + 4, ...), which has two extra samples at each end."""
    return (padded[:-4] - 8 * padded[1:-3] + 8 * padded[3:-1] - padded[4:]) / (12 * dt)


def pad(values: Array, periodic: bool) -> Array:
    """Two more samples at each end of (t, ...): those of the neighbouring periods, or extrapolated quadratically."""
    if periodic:
        return np.concatenate([values[-2:], values, values[:2]])
    for _ in range(2):
        before, after = (3 * a - 3 * b + c for a, b, c in (values[:3], values[:-4:-1]))
        values = np.concatenate([[before], values, [after]])
    return values


@dataclass(frozen=True, eq=False)
class GroundDemand:
    """The ground wrench (k, 6) of k samples, N and N·m, heading frame, about the centre of mass. `arm` (k, 4, 3) is
    from the centre of mass to each foot's contact point, m; `stands` (k, 4) marks feet in stance; `joint_torque` (k,
    12), N·m, would act if the wrench acted on the trunk."""

    wrench: Array
    arm: Array
    stands: Flags
    joint_torque: Array


def ground_demand(robot: Robot, motion: Motion, sample: Indices) -> GroundDemand:
    """The ground wrench at samples (k,), by inverse dynamics of the whole robot, legs included."""
    quat = motion.root_quat_wxyz
    linear, angular, joint = _accelerations(motion)
    velocity_b, acceleration_b = quat_rotate_inverse(quat, motion.root_ang_vel_w), quat_rotate_inverse(quat, angular)
    position = np.hstack([motion.root_pos_w, quat, motion.joint_pos])
    velocity = np.hstack([motion.root_lin_vel_w, velocity_b, motion.joint_vel])
    acceleration = np.hstack([linear, acceleration_b, joint])
    force, com = inverse_dynamics(robot, position[sample], velocity[sample], acceleration[sample])
    base, unturn = motion.root_pos_w[sample], quat_from_yaw(-yaw_from_quat(quat[sample]))
    moment = quat_rotate(quat[sample], force[:, 3:6]) + np.cross(base - com, force[:, :3])
    contact = motion.foot_pos_w[sample] - np.array([0.0, 0.0, robot.foot_radius])
    return GroundDemand(
        wrench=np.concatenate([quat_rotate(unturn, force[:, :3]), quat_rotate(unturn, moment)], axis=1),
        arm=quat_rotate(unturn[:, None], contact - com[:, None]),
        stands=motion.contact[sample],
        joint_torque=force[:, 6:],
    )


def _accelerations(motion: Motion) -> tuple[Array, Array, Array]:
    """Of the root (t, 3), its rotation (t, 3), world, and of the joints (t, 12)."""

    def of(velocity: Array, planar: bool) -> Array:
        padded = pad(velocity, motion.cycle is not None)
        if planar and motion.cycle is not None:
            padded[:2, :2] = rotate_planar(-motion.cycle[2], padded[:2, :2])
            padded[-2:, :2] = rotate_planar(motion.cycle[2], padded[-2:, :2])
        return (padded[3:-1] - padded[1:-3]) / (2 * motion.dt)  # accelerations jump: a wider difference overshoots

    return of(motion.root_lin_vel_w, True), of(motion.root_ang_vel_w, True), of(motion.joint_vel, False)


@dataclass(frozen=True, eq=False)
class LimitUse:
    """How much of each limit a motion uses at k instants, (k,) each; `friction` is NaN without a foot on the ground,
    `lacking` (k, 6) is the acceleration that the standing feet cannot give, m/s² and rad/s²."""

    joint_speed: Array
    torque: Array
    torque_at_speed: Array
    friction: Array
    lacking: Array


def use_of_limits(robot: Robot, motion: Motion, sample: Indices) -> LimitUse:
    """What a motion uses of each limit at its samples (k,), whether or not the robot can."""
    demand = ground_demand(robot, motion, sample)
    torque, lacking = _joint_torques(robot, motion, sample, demand)
    driving = torque * np.sign(motion.joint_vel[sample])
    speed = np.abs(motion.joint_vel[sample]) / robot.joint_speed_limit
    total = demand.wrench[:, :3]
    ratio = np.linalg.norm(total[:, :2], axis=1) / np.maximum(total[:, 2], 0.1 * robot.mass * GRAVITY)
    return LimitUse(
        joint_speed=speed.max(axis=1),
        torque=np.abs(torque).max(axis=1),
        torque_at_speed=0.5 * (driving + 2 * speed).max(axis=1),
        friction=np.where(demand.stands.any(axis=1), ratio, np.nan),
        lacking=lacking,
    )


def _joint_torques(robot: Robot, motion: Motion, sample: Indices, demand: GroundDemand) -> tuple[Array, Array]:
    """Joint torques (k, 12), shares of their limits, and the acceleration (k, 6), m/s² and rad/s², that the feet cannot
    give: of the ground forces, in their friction pyramids, nearest to the demand those with the least torques."""
    from scipy.optimize import nnls

    weight = robot.mass * GRAVITY
    scale = np.concatenate([np.full(3, 1.0 / weight), 1.0 / (GRAVITY * robot.inertia_b.diagonal())])
    k = len(sample)
    force = np.broadcast_to(_PYRAMID * np.array([GROUND_FRICTION, GROUND_FRICTION, 1.0]), (k, 4, 4, 3))
    wrench = np.concatenate([force, np.cross(demand.arm[:, :, None], force)], axis=-1).reshape(k, 16, 6)
    can = np.repeat(demand.stands, 4, axis=1)
    push = weight * scale[:, None] * np.swapaxes(wrench * can[..., None], 1, 2)
    quat = motion.root_quat_wxyz[sample]
    tilt = quat_multiply(quat_from_yaw(-yaw_from_quat(quat)), quat)
    force_b = quat_rotate_inverse(tilt[:, None, None], force)
    jacobian = foot_jacobians(robot, motion.joint_pos[sample])
    moved = np.zeros((k, 4, 3, 4, 4))  # torque of each leg's joints by its own foot's pushes
    moved[:, range(4), :, range(4)] = np.einsum("tlij,tlei->ltje", jacobian, force_b)
    moved = moved.reshape(-1, 12, 16) * can[:, None] * (weight / robot.torque_limit)[:, None]
    torque, wanted = demand.joint_torque / robot.torque_limit, demand.wrench * scale
    lacking, small, zero = np.zeros_like(wanted), np.sqrt(_FORCE_WEIGHT) * np.eye(16), np.zeros(16)
    share = np.sqrt(_TORQUE_WEIGHT)
    for i in range(k):
        rows = np.concatenate([push[i], share * moved[i], small])
        x = nnls(rows, np.concatenate([wanted[i], share * torque[i], zero]))[0] * can[i]
        torque[i] -= moved[i] @ x
        lacking[i] = GRAVITY * (wanted[i] - push[i] @ x)
    return torque, lacking
