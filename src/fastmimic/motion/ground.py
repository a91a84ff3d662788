"""The ground wrench that a motion needs."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fastmimic.base.arrays import Array
from fastmimic.base.rotations import quat_from_yaw, quat_rotate, quat_rotate_inverse, rotate_planar, yaw_from_quat
from fastmimic.motion.motion import Motion
from fastmimic.robot import Robot
from fastmimic.robot.dynamics import inverse_dynamics


def differentiate(padded: Array, dt: float) -> Array:
    """Fourth-order central differences (t, ...) of `padded` (t + 4, ...), which has two extra samples at each end."""
    return (padded[:-4] - 8 * padded[1:-3] + 8 * padded[3:-1] - padded[4:]) / (12 * dt)


def pad(values: Array, periodic: bool) -> Array:
    """Two more samples at each end of (t, ...): those of the neighbouring periods, or extrapolated quadratically."""
    if periodic:
        return np.concatenate([values[-2:], values, values[:2]])

    def beyond(a: Array, b: Array, c: Array) -> Array:
        return 3 * a - 3 * b + c

    front1 = beyond(values[0], values[1], values[2])
    front2 = beyond(front1, values[0], values[1])
    back1 = beyond(values[-1], values[-2], values[-3])
    back2 = beyond(back1, values[-1], values[-2])
    return np.concatenate([[front2, front1], values, [back1, back2]])


@dataclass(frozen=True, eq=False)
class GroundDemand:
    """The ground wrench (k, 6) of k samples, N and N·m, heading frame, about the centre of mass. `arm` (k, 4, 3) is
    from the centre of mass to each foot's contact point, m; `stands` (k, 4) marks feet in stance; `joint_torque` (k,
    12), N·m, would act if the wrench acted on the trunk."""

    wrench: Array
    arm: Array
    stands: NDArray[np.bool_]
    joint_torque: Array


def ground_demand(robot: Robot, motion: Motion, sample: NDArray[np.int_]) -> GroundDemand:
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
