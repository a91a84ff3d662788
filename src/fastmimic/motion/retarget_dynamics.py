"""Which forces a motion asks of the ground, and which part of them standing feet cannot give."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from fastmimic.motion.motion import Motion
from fastmimic.motion.retarget_measure import feet_in_world
from fastmimic.motion.retarget_signal import differentiate, pad_open
from fastmimic.robot import Robot
from fastmimic.rotations import (
    matrix_from_quat,
    quat_from_yaw,
    quat_rotate,
    quat_rotate_inverse,
    rotate_planar,
    yaw_from_quat,
)

Array = NDArray[np.float64]

_PYRAMID: Final = np.array([[1.0, 0.0, 1.0], [-1.0, 0.0, 1.0], [0.0, 1.0, 1.0], [0.0, -1.0, 1.0]])
_FORCE_COST: Final = 1e-4
"""Of a newton against an m/s² of residual: spreads the forces over the feet without leaving a residual."""


@dataclass(frozen=True, eq=False)
class Demand:
    """What a motion asks of the ground at some of its samples, heading frame, about the centre of mass.

    Attributes:
        sample: (k,) indices.
        wrench: (k, 6) force, N, and moment, N·m.
        arm: (k, 4, 3) from the centre of mass to where each foot touches the ground, m.
        stands: (k, 4) which feet can push.
    """

    sample: NDArray[np.int_]
    wrench: Array
    arm: Array
    stands: NDArray[np.bool_]


def ground_demand(robot: Robot, motion: Motion, sample: NDArray[np.int_]) -> Demand:
    """Inverse dynamics of the whole robot, legs included: the wrench that the ground has to give."""
    import mujoco

    model = mujoco.MjModel.from_xml_string(robot.xml)
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    data = mujoco.MjData(model)
    joints = [mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, name) for name in robot.joint_names]
    q_index, v_index = model.jnt_qposadr[joints], model.jnt_dofadr[joints]
    linear, angular, joint = _accelerations(motion)
    quat = motion.root_quat_wxyz
    velocity_b = quat_rotate_inverse(quat, motion.root_ang_vel_w)
    acceleration_b = quat_rotate_inverse(quat, angular)
    wrench, com = np.zeros((len(sample), 6)), np.zeros((len(sample), 3))
    for k, i in enumerate(sample):
        data.qpos[:3], data.qpos[3:7], data.qpos[q_index] = motion.root_pos_w[i], quat[i], motion.joint_pos[i]
        data.qvel[:3], data.qvel[3:6], data.qvel[v_index] = motion.root_lin_vel_w[i], velocity_b[i], motion.joint_vel[i]
        data.qacc[:3], data.qacc[3:6], data.qacc[v_index] = linear[i], acceleration_b[i], joint[i]
        mujoco.mj_inverse(model, data)
        wrench[k], com[k] = data.qfrc_inverse[:6], data.subtree_com[0]
    base, unturn = motion.root_pos_w[sample], quat_from_yaw(-yaw_from_quat(quat[sample]))
    moment = quat_rotate(quat[sample], wrench[:, 3:]) + np.cross(base - com, wrench[:, :3])
    contact = feet_in_world(motion)[sample] - np.array([0.0, 0.0, robot.foot_radius])
    return Demand(
        sample=sample,
        wrench=np.concatenate([quat_rotate(unturn, wrench[:, :3]), quat_rotate(unturn, moment)], axis=1),
        arm=quat_rotate(unturn[:, None], contact - com[:, None]),
        stands=motion.contact[sample],
    )


def ground_forces(robot: Robot, demand: Demand, friction: float) -> tuple[Array, Array, Array]:
    """The forces within the friction pyramids that come nearest to what is demanded.

    Returns:
        forces (k, 4, 3), N; the residual (k, 6) as acceleration of the whole robot, m/s² and rad/s²; and projectors
        (k, 6, 6) onto the accelerations that no change of these forces can give.
    """
    from scipy.optimize import nnls

    scale = 1.0 / np.array([robot.mass] * 3 + list(robot.inertia_b.diagonal()))
    pushes = _PYRAMID * np.array([friction, friction, 1.0])
    k = len(demand.sample)
    forces, residual, blind = np.zeros((k, 4, 3)), demand.wrench * scale, np.tile(np.eye(6), (k, 1, 1))
    for i in range(k):
        legs = np.flatnonzero(demand.stands[i])
        if not len(legs):
            continue
        arm = demand.arm[i, legs]
        columns = np.concatenate([np.tile(pushes, (len(legs), 1)), np.cross(arm[:, None], pushes[None]).reshape(-1, 3)], axis=1)
        matrix = (columns * scale).T
        size = matrix.shape[1]
        strength, _ = nnls(
            np.concatenate([matrix, _FORCE_COST * np.eye(size)]), np.concatenate([residual[i], np.zeros(size)])
        )
        forces[i, legs] = strength.reshape(-1, 4) @ pushes
        residual[i] -= matrix @ strength
        used = matrix[:, strength > 1e-6]
        if used.size:
            u, s, _ = np.linalg.svd(used, full_matrices=False)
            u = u[:, s > 1e-6 * s[0]]
            blind[i] -= u @ u.T
    return forces, residual, blind


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
