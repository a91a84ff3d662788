"""Common to all joint commands: the leg's own dynamics, joint losses, and limits."""

from typing import Any, Final

import numpy as np

from fastmimic.base.jit import inlined
from fastmimic.control.adaptation import DAMPING_AFTER_FAILURE
from fastmimic.robot.dynamics import leg_inverse_dynamics

DRY_FRICTION_FROM: Final = 0.5  # rad/s; below it friction is compensated in part, so that torques do not jump


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
