"""Errors between robot and reference, and the acceleration that should reduce them (paper, eq. 1)."""

from typing import Any

import numpy as np

from fastmimic.base.arrays import Array
from fastmimic.base.jit import inlined
from fastmimic.base.vectors import heading_vector, quat_to_matrix, rotation_error, transposed_times, turn_rows
from fastmimic.control.stance import invert_symmetric_3x3
from fastmimic.robot.dynamics import leg_mass_moment
from fastmimic.robot.kinematics import leg_forward


@inlined
def _feet_and_com(model: Any, obs: Any, rotation: Array, feet: Array, arms: Array, com: Array) -> None:
    """Feet in the body frame, and their lever arms from the centre of mass in the heading frame."""
    com[0], com[1], com[2] = model.trunk_moment[0], model.trunk_moment[1], model.trunk_moment[2]
    for leg in range(4):
        q = obs.joint_pos[3 * leg : 3 * leg + 3]
        feet[leg, 0], feet[leg, 1], feet[leg, 2] = leg_forward(model.geometry[leg], q[0], q[1], q[2])
        m0, m1, m2 = leg_mass_moment(model, leg, q)
        com[0] += m0
        com[1] += m1
        com[2] += m2
    for k in range(3):
        com[k] /= model.mass
    for leg in range(4):
        x, y, z = feet[leg, 0] - com[0], feet[leg, 1] - com[1], feet[leg, 2] - com[2]
        for k in range(3):
            arms[leg, k] = rotation[k, 0] * x + rotation[k, 1] * y + rotation[k, 2] * z
        arms[leg, 2] -= model.foot_radius  # the ground is felt under the centre of the foot sphere


@inlined
def _heading_inertia(inertia: Array, rotation: Array, out: Array) -> None:
    """R I Rᵀ."""
    for i in range(3):
        for j in range(i + 1):
            total = 0.0
            for a in range(3):
                for b in range(3):
                    total += rotation[i, a] * inertia[a, b] * rotation[j, b]
            out[i, j] = total
            out[j, i] = total


@inlined
def compare_to_reference(model: Any, ref: Any, clock: Any, obs: Any, scratch: Any) -> None:
    """The robot's pose and velocity and their errors to the reference, in the robot's heading frame."""
    rotation, reference_rotation = scratch.rotation, scratch.reference_rotation
    quat_to_matrix(obs.root_quat, rotation)
    yaw = np.arctan2(rotation[1, 0], rotation[0, 0])
    c, s = np.cos(yaw), np.sin(yaw)
    turn_rows(c, -s, rotation)
    quat_to_matrix(ref.root_quat, reference_rotation)
    turn = clock.origin[2] - yaw
    ct, st = np.cos(turn), np.sin(turn)
    turn_rows(ct, st, reference_rotation)
    scratch.turn[0], scratch.turn[1] = ct, st

    _feet_and_com(model, obs, rotation, scratch.feet, scratch.arms, scratch.com)
    _heading_inertia(model.inertia, rotation, scratch.inertia)
    invert_symmetric_3x3(scratch.inertia, scratch.inverse_inertia)
    heading_vector(c, s, obs.lin_vel, scratch.lin_vel)
    heading_vector(c, s, obs.ang_vel, scratch.ang_vel)
    heading_vector(ct, -st, ref.lin_vel, scratch.ref_lin_vel)
    heading_vector(ct, -st, ref.ang_vel, scratch.ref_ang_vel)

    co, so = np.cos(clock.origin[2]), np.sin(clock.origin[2])
    x = clock.origin[0] + co * ref.root_pos[0] - so * ref.root_pos[1] - obs.root_pos[0]
    y = clock.origin[1] + so * ref.root_pos[0] + co * ref.root_pos[1] - obs.root_pos[1]
    scratch.error[0], scratch.error[1] = c * x + s * y, -s * x + c * y
    scratch.error[2] = ref.root_pos[2] - obs.root_pos[2]
    rotation_error(reference_rotation, rotation, scratch.angle_error)
    for k in range(3):
        scratch.lin_vel_error[k] = scratch.ref_lin_vel[k] - scratch.lin_vel[k]
        scratch.ang_vel_error[k] = scratch.ref_ang_vel[k] - scratch.ang_vel[k]


@inlined
def _desired_acceleration(
    config: Any, error: Array, velocity_error: Array, feedforward: Array, out: Array, at: int
) -> None:
    """k_p e + k_d ė + feed-forward, into out[at:at + 3]."""
    for i in range(3):
        a = config.kp[at + i] * error[i] + config.kd[at + i] * velocity_error[i]
        out[at + i] = a + config.reference_acceleration * feedforward[i]


@inlined
def _relative_to_feet(
    config: Any, ref: Any, rotation: Array, reference_rotation: Array, feet: Array, memory: Any, error: Array
) -> None:
    """Mixes the x and y position error, heading frame, with that relative to the standing feet. Balance depends on the
    feet: the body belongs over the actual feet as it is over the reference's, wherever they landed. Feet about to lift
    off fade out."""
    ex = ey = total = 0.0
    for leg in range(4):
        if memory.stance[leg] == 0 or ref.contact[leg] == 0:
            continue
        weight = min(ref.remaining[leg], config.foothold_preview + config.dt)
        for k in range(3):
            ex += weight * (rotation[0, k] * feet[leg, k] - reference_rotation[0, k] * ref.foot_pos[leg, k])
            ey += weight * (rotation[1, k] * feet[leg, k] - reference_rotation[1, k] * ref.foot_pos[leg, k])
        total += weight
    if total > 0:
        error[0] += config.foothold_share * (ex / total - error[0])
        error[1] += config.foothold_share * (ey / total - error[1])


@inlined
def desired_motion(config: Any, ref: Any, memory: Any, scratch: Any) -> None:
    """ẍ_des for the standing legs; errors and velocities in the body frame for all legs."""
    rotation, reference_rotation, error = scratch.rotation, scratch.reference_rotation, scratch.error
    transposed_times(rotation, scratch.lin_vel, scratch.lin_vel_b)
    transposed_times(rotation, scratch.ang_vel, scratch.ang_vel_b)
    transposed_times(reference_rotation, scratch.ref_lin_vel, scratch.ref_lin_vel_b)
    transposed_times(reference_rotation, scratch.ref_ang_vel, scratch.ref_ang_vel_b)
    transposed_times(rotation, error, scratch.position_error)
    transposed_times(rotation, scratch.lin_vel_error, scratch.velocity_error)
    scratch.joint_acc = ref.joint_acc

    scratch.shift[0], scratch.shift[1] = -error[0], -error[1]
    _relative_to_feet(config, ref, rotation, reference_rotation, scratch.feet, memory, error)
    scratch.shift[0] += error[0]
    scratch.shift[1] += error[1]
    c, s = scratch.turn[0], scratch.turn[1]
    heading_vector(c, -s, ref.lin_acc, scratch.ref_lin_acc)
    _desired_acceleration(config, error, scratch.lin_vel_error, scratch.ref_lin_acc, scratch.desired, 0)
    heading_vector(c, -s, ref.ang_acc, scratch.ref_ang_acc)
    _desired_acceleration(config, scratch.angle_error, scratch.ang_vel_error, scratch.ref_ang_acc, scratch.desired, 3)
