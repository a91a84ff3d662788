"""Which forces a motion asks of the ground, and which part of them standing feet cannot give."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from fastmimic.base.arrays import Array
from fastmimic.base.rotations import (
    quat_from_yaw,
    quat_rotate,
    quat_rotate_inverse,
    rotate_planar,
    yaw_from_quat,
)
from fastmimic.motion.motion import Motion
from fastmimic.retargeting.measure import feet_in_world
from fastmimic.retargeting.signal import differentiate, pad_open
from fastmimic.robot import Robot

_PYRAMID: Final = np.array([[1.0, 0.0, 1.0], [-1.0, 0.0, 1.0], [0.0, 1.0, 1.0], [0.0, -1.0, 1.0]])


@dataclass(frozen=True, eq=False)
class GroundDemand:
    """What a motion asks of the ground at some of its samples, heading frame, about the centre of mass.

    Attributes:
        sample: (k,) indices.
        wrench: (k, 6) force, N, and moment, N·m.
        arm: (k, 4, 3) from the centre of mass to where each foot touches the ground, m.
        stands: (k, 4) which feet can push.
        joint_torque: (k, 12) of the motors, were the wrench given at the trunk, N·m.
    """

    sample: NDArray[np.int_]
    wrench: Array
    arm: Array
    stands: NDArray[np.bool_]
    joint_torque: Array


def ground_demand(robot: Robot, motion: Motion, sample: NDArray[np.int_]) -> GroundDemand:
    """Inverse dynamics of the whole robot, legs included: the wrench that the ground has to give."""
    import mujoco

    model = robot.model()
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    data = mujoco.MjData(model)
    joints = [mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, name) for name in robot.joint_names]
    q_index, v_index = model.jnt_qposadr[joints], model.jnt_dofadr[joints]
    linear, angular, joint = _accelerations(motion)
    quat = motion.root_quat_wxyz
    velocity_b = quat_rotate_inverse(quat, motion.root_ang_vel_w)
    acceleration_b = quat_rotate_inverse(quat, angular)
    wrench, com, torque = np.zeros((len(sample), 6)), np.zeros((len(sample), 3)), np.zeros((len(sample), 12))
    for k, i in enumerate(sample):
        data.qpos[:3], data.qpos[3:7], data.qpos[q_index] = motion.root_pos_w[i], quat[i], motion.joint_pos[i]
        data.qvel[:3], data.qvel[3:6], data.qvel[v_index] = motion.root_lin_vel_w[i], velocity_b[i], motion.joint_vel[i]
        data.qacc[:3], data.qacc[3:6], data.qacc[v_index] = linear[i], acceleration_b[i], joint[i]
        mujoco.mj_inverse(model, data)
        wrench[k], com[k], torque[k] = data.qfrc_inverse[:6], data.subtree_com[0], data.qfrc_inverse[v_index]
    base, unturn = motion.root_pos_w[sample], quat_from_yaw(-yaw_from_quat(quat[sample]))
    moment = quat_rotate(quat[sample], wrench[:, 3:]) + np.cross(base - com, wrench[:, :3])
    contact = feet_in_world(motion)[sample] - np.array([0.0, 0.0, robot.foot_radius])
    return GroundDemand(
        sample=sample,
        wrench=np.concatenate([quat_rotate(unturn, wrench[:, :3]), quat_rotate(unturn, moment)], axis=1),
        arm=quat_rotate(unturn[:, None], contact - com[:, None]),
        stands=motion.contact[sample],
        joint_torque=torque,
    )


def push_directions(demand: GroundDemand, friction: float) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Pushes of 1 N normal force along the edges of each foot's friction pyramid.

    Returns:
        forces (k, 16, 3); their wrenches about the centre of mass (k, 16, 6); which feet can give them (k, 16).
    """
    k = len(demand.sample)
    force = np.broadcast_to(_PYRAMID * np.array([friction, friction, 1.0]), (k, 4, 4, 3))
    moment = np.cross(demand.arm[:, :, None], force)
    wrench = np.concatenate([force, moment], axis=-1)
    return force.reshape(k, 16, 3), wrench.reshape(k, 16, 6), np.repeat(demand.stands, 4, axis=1)


def _accelerations(motion: Motion) -> tuple[Array, Array, Array]:
    """Of root (t, 3), its rotation (t, 3), world, and of the joints (t, 12)."""

    def of(velocity: Array, planar: bool) -> Array:
        if motion.cycle is None:
            return differentiate(pad_open(velocity), motion.dt)
        padded = np.concatenate([velocity[-2:], velocity, velocity[:2]])
        if planar:
            padded[:2, :2] = rotate_planar(-motion.cycle[2], padded[:2, :2])
            padded[-2:, :2] = rotate_planar(motion.cycle[2], padded[-2:, :2])
        return differentiate(padded, motion.dt)

    return of(motion.root_lin_vel_w, True), of(motion.root_ang_vel_w, True), of(motion.joint_vel, False)
