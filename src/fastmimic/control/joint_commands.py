"""Joint commands: the standing legs' torques from the ground forces, with the paper's online adaptation (eq. 2), and
what all legs have in common: their own dynamics, joint losses, and limits."""

from typing import Any, Final

import numpy as np

from fastmimic.base.jit import inlined
from fastmimic.base.vectors import transposed_times
from fastmimic.robot.dynamics import cross, leg_inverse_dynamics
from fastmimic.robot.kinematics import leg_inverse, leg_jacobian

DAMPING_AFTER_FAILURE: Final = 5.0  # N·m·s/rad where nothing better can be computed
DRY_FRICTION_FROM: Final = 0.5  # rad/s; below it friction is compensated in part, so that torques do not jump


@inlined
def stance_leg(
    config: Any,
    model: Any,
    obs: Any,
    memory: Any,
    command: Any,
    scratch: Any,
    leg: int,
    solved: bool,
) -> None:
    """τ = −Jᵀ Rᵀ f, plus low-gain feedback towards the foot's next position (paper, eq. 2)."""
    j, foot = 3 * leg, scratch.feet[leg]
    q = obs.joint_pos[j : j + 3]
    leg_jacobian(model.geometry[leg], q[0], q[1], q[2], scratch.jacobian)
    force_b, v_ref_b, w_ref_b = scratch.force_b, scratch.ref_lin_vel_b, scratch.ref_ang_vel_b
    transposed_times(scratch.rotation, memory.force[leg], force_b)
    transposed_times(scratch.jacobian, force_b, scratch.torque)
    # the contact is below the sphere's centre: moment of the force about the centre, (−r z) × f in the body frame
    zx, zy, zz = scratch.rotation[2, 0], scratch.rotation[2, 1], scratch.rotation[2, 2]
    mx, my, mz = cross(zx, zy, zz, force_b[0], force_b[1], force_b[2])
    r = model.foot_radius
    pitching = -r * (np.cos(q[0]) * my + np.sin(q[0]) * mz)
    scratch.torque[0] -= r * mx
    scratch.torque[1] += pitching
    scratch.torque[2] += pitching
    stiffness, damping = 0.0, 0.0
    if not solved and memory.force[leg, 2] == 0.0:
        damping = DAMPING_AFTER_FAILURE
    a, h, k = q[0], q[1], q[2]
    if config.adaptation > 0:
        stiffness, damping = config.stance_kp, max(damping, config.stance_kd)
        turning = 1.0 if config.adaptation == 2 else 0.0
        dx = v_ref_b[0] + turning * (w_ref_b[1] * foot[2] - w_ref_b[2] * foot[1])
        dy = v_ref_b[1] + turning * (w_ref_b[2] * foot[0] - w_ref_b[0] * foot[2])
        dz = v_ref_b[2] + turning * (w_ref_b[0] * foot[1] - w_ref_b[1] * foot[0])
        dt = config.dt
        a, h, k, _ = leg_inverse(model.geometry[leg], foot[0] - dx * dt, foot[1] - dy * dt, foot[2] - dz * dt)
    command.joint_pos[j], command.joint_pos[j + 1], command.joint_pos[j + 2] = a, h, k
    for i in range(3):
        command.joint_vel[j + i] = (command.joint_pos[j + i] - q[i]) / config.dt
        command.stiffness[j + i] = stiffness
        command.damping[j + i] = damping
        command.torque[j + i] = -scratch.torque[i]


@inlined
def add_leg_dynamics(config: Any, model: Any, obs: Any, memory: Any, command: Any, scratch: Any, leg: int) -> None:
    """Adds the torques that carry the leg itself and move it along its path."""
    weight = config.stance_dynamics if memory.stance[leg] == 1 else config.swing_dynamics
    if weight == 0.0:
        return
    part = slice(3 * leg, 3 * leg + 3)
    leg_inverse_dynamics(
        model,
        leg,
        obs.joint_pos[part],
        obs.joint_vel[part],
        scratch.joint_acc[part],
        scratch.ang_vel_b,
        scratch.gravity_acc_b,
        scratch.torque,
    )
    for i in range(3):
        j = 3 * leg + i
        command.torque[j] += weight * (scratch.torque[i] + model.armature[j] * scratch.joint_acc[j])


@inlined
def compensate_friction(model: Any, command: Any, j: int) -> None:
    """Adds the torque that joint j loses to viscous and dry friction at its commanded velocity."""
    velocity = command.joint_vel[j]
    if model.joint_damping[j] > 0.0:
        command.torque[j] += model.joint_damping[j] * velocity
    if model.joint_friction[j] > 0.0:
        command.torque[j] += model.joint_friction[j] * np.tanh(velocity / DRY_FRICTION_FROM)


@inlined
def clip_command(config: Any, model: Any, command: Any, j: int) -> None:
    """Clips the command of joint j; where NaN observations made it NaN, it becomes damping."""
    if not np.isfinite(command.joint_pos[j] + command.joint_vel[j] + command.torque[j]):
        command.joint_pos[j], command.joint_vel[j], command.torque[j] = 0.0, 0.0, 0.0
        command.stiffness[j], command.damping[j] = 0.0, DAMPING_AFTER_FAILURE
    lower, upper = model.lower[j] + config.joint_margin, model.upper[j] - config.joint_margin
    command.joint_pos[j] = min(max(command.joint_pos[j], lower), upper)
    limit = model.torque_limit[j]
    command.torque[j] = min(max(command.torque[j], -limit), limit)
