"""Swing: where the feet in the air go (paper, eq. 3)."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from fastmimic.control.vectors import transposed_times
from fastmimic.jit import inlined
from fastmimic.robot.kinematics import leg_inverse

Array = NDArray[np.float64]


@inlined
def swing_errors(
    config: Any,
    rotation: Array,
    error: Array,
    velocity_error: Array,
    sway: Array,
    memory: Any,
    position_error_b: Array,
    work: Array,
) -> None:
    """Errors that the swing feet make up for, body frame: position, and velocity low-passed."""
    for k in range(3):
        work[k] = error[k] + (config.swing_sway * sway[0, k] if k < 2 else 0.0)
    transposed_times(rotation, work, position_error_b)
    for k in range(3):
        work[k] = velocity_error[k] + (config.swing_sway * sway[1, k] if k < 2 else 0.0)
    for k in range(2):
        v = rotation[0, k] * work[0] + rotation[1, k] * work[1] + rotation[2, k] * work[2]
        if np.isfinite(v):  # a filter would never forget a NaN
            memory.velocity_error[k] += config.filter_gain * (v - memory.velocity_error[k])


@inlined
def swing_target(
    config: Any, ref: Any, rotation: Array, reference_rotation: Array, height_error: float, leg: int, out: Array
) -> None:
    """Reference foot in the robot's body frame, levelled to gravity and ground by the factor `config.level`."""
    x, y, z = ref.foot_pos[leg, 0], ref.foot_pos[leg, 1], ref.foot_pos[leg, 2]
    hx = reference_rotation[0, 0] * x + reference_rotation[0, 1] * y + reference_rotation[0, 2] * z
    hy = reference_rotation[1, 0] * x + reference_rotation[1, 1] * y + reference_rotation[1, 2] * z
    hz = reference_rotation[2, 0] * x + reference_rotation[2, 1] * y + reference_rotation[2, 2] * z
    # a yaw error is not the swing foot's to make up for
    yaw = np.arctan2(reference_rotation[1, 0], reference_rotation[0, 0])
    cy, sy = np.cos(yaw), np.sin(yaw)
    hx, hy = cy * hx + sy * hy, -sy * hx + cy * hy
    hz += height_error
    lx = rotation[0, 0] * hx + rotation[1, 0] * hy + rotation[2, 0] * hz
    ly = rotation[0, 1] * hx + rotation[1, 1] * hy + rotation[2, 1] * hz
    lz = rotation[0, 2] * hx + rotation[1, 2] * hy + rotation[2, 2] * hz
    out[0] = x + config.level * (lx - x)
    out[1] = y + config.level * (ly - y)
    out[2] = z + config.level * (lz - z)


@inlined
def swing_leg(
    config: Any,
    model: Any,
    obs: Any,
    ref: Any,
    memory: Any,
    command: Any,
    scratch: Any,
    leg: int,
    height_error: float,
) -> None:
    """Paper, eq. 3: reference foot minus K (v̄ − v), and a share of the position error, by inverse kinematics."""
    target = scratch.vectors[7]
    swing_target(config, ref, scratch.rotation, scratch.reference_rotation, height_error, leg, target)
    for k in range(2):
        if memory.deliberate[leg] == 1:
            target[k] += scratch.world_error[k]
        else:
            target[k] -= config.velocity_feedback * memory.velocity_error[k]
            target[k] -= config.position_feedback * scratch.position_error[k]
    if memory.since_switch[leg] < config.blend_time:
        left = 1.0 - memory.since_switch[leg] / config.blend_time
        fade = left * left * (3.0 - 2.0 * left)
        for k in range(3):
            target[k] += fade * memory.liftoff_offset[leg, k]
    a, h, k, _ = leg_inverse(model.geometry[leg], target[0], target[1], target[2])
    j = 3 * leg
    command.joint_pos[j], command.joint_pos[j + 1], command.joint_pos[j + 2] = a, h, k
    for j in range(3 * leg, 3 * leg + 3):
        command.joint_vel[j] = ref.joint_vel[j]
        command.stiffness[j] = config.swing_kp
        command.damping[j] = config.swing_kd
        command.torque[j] = 0.0
