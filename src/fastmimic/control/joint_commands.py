"""Joint commands: standing legs by the ground forces, with the paper's online adaptation (eq. 2); swinging legs along
paths of the feet in the air (eq. 3); and for all legs their own dynamics, joint losses, and limits."""

from typing import Any, Final

import numpy as np

from fastmimic.base.arrays import Array
from fastmimic.base.jit import inlined
from fastmimic.base.vectors import solve_damped, transposed_times, turned, turned_back
from fastmimic.control.footing import feel_for_ground, lift_over
from fastmimic.robot.dynamics import cross, leg_inverse_dynamics
from fastmimic.robot.kinematics import contact_jacobian, leg_inverse, leg_jacobian

DAMPING_AFTER_FAILURE: Final = 5.0  # N·m·s/rad where nothing better can be computed
RAIBERT, REGULATED = 1, 2  # kinds of footholds, in the order of `SwingConfig.foothold`'s choices
DRY_FRICTION_FROM: Final = 0.5  # rad/s; below it friction is compensated in part, so that torques do not jump


@inlined
def stance_leg(
    config: Any, model: Any, obs: Any, memory: Any, command: Any, scratch: Any, leg: int, solved: bool
) -> None:
    """τ = −Jᵀ Rᵀ f, plus low-gain feedback towards the joints' next positions (paper, eq. 2): those that carry the body
    with the reference's velocity over feet that roll. J is that of the contact point (the paper's feet are points):
    the centre of a ball that rolls moves on, and held still it would push the body off its reference."""
    j, foot, jacobian, wanted = 3 * leg, scratch.feet[leg], scratch.jacobian, scratch.vector
    q, up = obs.joint_pos[j : j + 3], scratch.rotation[2]
    contact_jacobian(model.geometry[leg], q, model.foot_radius, up, jacobian)
    transposed_times(scratch.rotation, memory.force[leg], scratch.force_b)
    transposed_times(jacobian, scratch.force_b, scratch.torque)
    stiffness, damping = 0.0, 0.0
    if not solved and memory.force[leg, 2] == 0.0:
        damping = DAMPING_AFTER_FAILURE
    wanted[0] = wanted[1] = wanted[2] = 0.0
    if config.adaptation > 0:
        stiff, damped, reach = feel_for_ground(config, memory, leg)
        stiffness, damping = stiff * config.stance_kp, max(damping, damped * config.stance_kd)
        v, w = scratch.ref_lin_vel_b, scratch.ref_ang_vel_b
        r, turning = model.foot_radius, 1.0 if config.adaptation == 2 else 0.0
        x, y, z = foot[0] - r * up[0], foot[1] - r * up[1], foot[2] - r * up[2]
        x, y, z = cross(turning * w[0], turning * w[1], turning * w[2], x, y, z)
        solve_damped(jacobian, -v[0] - x, -v[1] - y, -v[2] - z - reach, wanted)
    for i in range(3):
        command.joint_vel[j + i] = wanted[i]
        command.joint_pos[j + i] = q[i] + config.dt * wanted[i]
        command.stiffness[j + i] = stiffness
        command.damping[j + i] = damping
        command.torque[j + i] = -scratch.torque[i]


@inlined
def swing_target(config: Any, ref: Any, scratch: Any, leg: int, out: Array) -> None:
    """Reference foot in the robot's body frame, levelled to gravity and ground by the factor `config.level`."""
    rotation, reference_rotation = scratch.rotation, scratch.reference_rotation
    x, y, z = ref.foot_pos[leg, 0], ref.foot_pos[leg, 1], ref.foot_pos[leg, 2]
    hx, hy, hz = turned(reference_rotation, x, y, z)
    # a yaw error is not corrected by the swing foot
    yaw = np.arctan2(reference_rotation[1, 0], reference_rotation[0, 0])
    cy, sy = np.cos(yaw), np.sin(yaw)
    hx, hy = cy * hx + sy * hy, -sy * hx + cy * hy
    hz += scratch.error[2]
    lx, ly, lz = turned_back(rotation, hx, hy, hz)
    out[0] = x + config.level * (lx - x)
    out[1] = y + config.level * (ly - y)
    out[2] = z + config.level * (lz - z)


@inlined
def lift_off(config: Any, ref: Any, memory: Any, scratch: Any, leg: int) -> None:
    """Stores where a foot leaves the ground, body frame: its offset from the reference, or the start of its path."""
    foot, target = scratch.feet[leg], scratch.foot_target
    if config.foothold == RAIBERT:
        rotation = scratch.rotation
        for k in range(3):
            level = rotation[k, 0] * foot[0] + rotation[k, 1] * foot[1] + rotation[k, 2] * foot[2]
            level -= scratch.error[2] if k == 2 else 0.0
            memory.liftoff_offset[leg, k] = foot[k] + config.level * (level - foot[k])
        return
    swing_target(config, ref, scratch, leg, target)
    for k in range(3):
        memory.liftoff_offset[leg, k] = foot[k] - target[k]
    if config.foothold == REGULATED:  # x and y are the regulator's
        for a in range(2):
            memory.foot_shift[leg, a], memory.foot_shift_rate[leg, a] = -scratch.lean[a], 0.0
            for k in range(3):
                memory.foot_shift[leg, a] += scratch.rotation[a, k] * (foot[k] - target[k])
        for k in range(3):
            for a in range(2):
                memory.liftoff_offset[leg, k] -= scratch.rotation[a, k] * (memory.foot_shift[leg, a] + scratch.lean[a])


@inlined
def raibert_path(
    config: Any, model: Any, ref: Any, memory: Any, scratch: Any, leg: int, share: float
) -> tuple[float, float, float]:
    """Joint angles at a share of the straight path to the Raibert foothold (Kang et al. 2021; paper, §IV-B). The path
    leads from lift-off to 0.5 T_s v − K (v̄ − v) from under the hip, on the ground: x and y linear in time, z over a
    parabola. Velocities are the base's, body frame, as in eq. 3. `config.level` levels the path."""
    g, rotation, start = model.geometry[leg], scratch.rotation, memory.liftoff_offset[leg]
    forward = 0.5 * config.swing_time
    x = g[0] + g[4] + forward * scratch.lin_vel_b[0] - config.velocity_feedback[0] * scratch.velocity_error[0]
    y = g[1] + g[3] + forward * scratch.lin_vel_b[1] - config.velocity_feedback[1] * scratch.velocity_error[1]
    z = model.foot_radius - ref.root_pos[2]
    x = start[0] + share * (x - start[0])
    y = start[1] + share * (y - start[1])
    z = start[2] + share * (z - start[2]) + 4.0 * config.swing_height * share * (1.0 - share)
    hz = z + scratch.error[2]
    lx, ly, lz = turned_back(rotation, x, y, hz)
    a, h, k, _ = leg_inverse(g, x + config.level * (lx - x), y + config.level * (ly - y), z + config.level * (lz - z))
    return a, h, k


@inlined
def raibert_leg(config: Any, model: Any, ref: Any, memory: Any, command: Any, scratch: Any, leg: int) -> None:
    """Moves a leg to the Raibert foothold, holding it after T_s until contact; independent of the animal."""
    share = min(memory.since_switch[leg] / config.swing_time, 1.0)
    step = config.dt / config.swing_time
    now = raibert_path(config, model, ref, memory, scratch, leg, share)
    before = after = now
    if share < 1.0:
        before = raibert_path(config, model, ref, memory, scratch, leg, share - step)
        after = raibert_path(config, model, ref, memory, scratch, leg, share + step)
    half, square = 0.5 / config.dt, 1.0 / (config.dt * config.dt)
    for i in range(3):
        command.joint_pos[3 * leg + i] = now[i]
        command.joint_vel[3 * leg + i] = half * (after[i] - before[i])
        scratch.joint_acc[3 * leg + i] = square * (after[i] - 2 * now[i] + before[i])


@inlined
def keep_in_reach(config: Any, model: Any, rotation: Array, leg: int, target: Array) -> None:
    """Moves a foot (3,), body frame, that the leg does not reach towards the hip, at its height above the ground: the
    nearest pose in reach would lift it, and it would come down as fast as a leg can stretch."""
    g, knee = model.geometry[leg], 3 * leg + 2
    straight = model.upper[knee] - config.joint_margin if g[10] < 0 else model.lower[knee] + config.joint_margin
    bend = straight - np.arctan2(-g[6], -g[7]) + np.arctan2(-g[8], -g[9])
    bend = min(bend, 0.0) if g[10] < 0 else max(bend, 0.0)  # a knee that turns further than straight ends there
    thigh, calf = np.hypot(g[6], g[7]), np.hypot(g[8], g[9])
    longest = thigh * thigh + calf * calf + 2.0 * thigh * calf * np.cos(bend) + g[3] * g[3]  # squared
    x, y, z = target[0] - g[0] - g[4], target[1] - g[1], target[2] - g[2]
    if x * x + y * y + z * z <= longest:
        return
    up = rotation[2]
    height = up[0] * x + up[1] * y + up[2] * z
    x, y, z = x - height * up[0], y - height * up[1], z - height * up[2]
    share = np.sqrt(max(longest - height * height, 0.0) / max(x * x + y * y + z * z, 1e-12))
    target[0] = g[0] + g[4] + share * x + height * up[0]
    target[1] = g[1] + share * y + height * up[1]
    target[2] = g[2] + share * z + height * up[2]


@inlined
def swing_leg(config: Any, model: Any, obs: Any, ref: Any, memory: Any, command: Any, scratch: Any, leg: int) -> None:
    """Follows the reference's foot, shifted by the regulator, or by −K (v̄ − v) (paper, eq. 3); inverse kinematics."""
    for j in range(3 * leg, 3 * leg + 3):
        command.stiffness[j] = config.swing_kp
        command.damping[j] = config.swing_kd
        command.torque[j] = 0.0
    if config.foothold == RAIBERT:
        raibert_leg(config, model, ref, memory, command, scratch, leg)
        return
    target = scratch.foot_target
    swing_target(config, ref, scratch, leg, target)
    if config.foothold == REGULATED:
        for k in range(3):
            for a in range(2):
                target[k] += scratch.rotation[a, k] * (memory.foot_shift[leg, a] + scratch.lean[a])
        if config.follow_ground == 1:
            lift_over(config, model, obs, memory, scratch, leg, target)
        keep_in_reach(config, model, scratch.rotation, leg, target)
    else:
        for k in range(2):
            target[k] -= config.velocity_feedback[k] * scratch.velocity_error[k]
    if memory.since_switch[leg] < config.blend_time:
        left = 1.0 - memory.since_switch[leg] / config.blend_time
        fade = left * left * (3.0 - 2.0 * left)
        for k in range(3):
            target[k] += fade * memory.liftoff_offset[leg, k]
    a, h, k, _ = leg_inverse(model.geometry[leg], target[0], target[1], target[2])
    j = 3 * leg
    command.joint_pos[j], command.joint_pos[j + 1], command.joint_pos[j + 2] = a, h, k
    own = scratch.vector
    own[0] = own[1] = own[2] = 0.0
    if config.foothold == REGULATED:
        x = memory.foot_shift_rate[leg, 0] - scratch.state[6]
        y = memory.foot_shift_rate[leg, 1] - scratch.state[7]
        x, y, z = turned_back(scratch.rotation, x, y, 0.0)
        leg_jacobian(model.geometry[leg], a, h, k, scratch.jacobian)
        solve_damped(scratch.jacobian, x, y, z, own)
    for i in range(3):
        command.joint_vel[j + i] = ref.joint_vel[j + i] + own[i]


@inlined
def add_leg_dynamics(config: Any, model: Any, obs: Any, memory: Any, command: Any, scratch: Any, leg: int) -> None:
    """Adds the torques that carry the leg itself and move it along its path."""
    weight = config.stance_dynamics if memory.stance[leg] == 1 else config.swing_dynamics
    if weight == 0.0:
        return
    part = slice(3 * leg, 3 * leg + 3)
    q, dq, ddq = obs.joint_pos[part], obs.joint_vel[part], scratch.joint_acc[part]
    leg_inverse_dynamics(model, leg, q, dq, ddq, scratch.ang_vel_b, scratch.gravity_acc_b, scratch.torque)
    for i in range(3):
        j = 3 * leg + i
        command.torque[j] += weight * (scratch.torque[i] + model.armature[j] * scratch.joint_acc[j])


@inlined
def finish_leg(config: Any, model: Any, command: Any, leg: int) -> None:
    """Adds the torques that a leg's joints lose to viscous and dry friction at their commanded velocities, and clips
    the command; where NaN observations made it NaN, it becomes damping."""
    for j in range(3 * leg, 3 * leg + 3):
        velocity = command.joint_vel[j]
        if model.joint_damping[j] > 0.0:
            command.torque[j] += model.joint_damping[j] * velocity
        if model.joint_friction[j] > 0.0:
            command.torque[j] += model.joint_friction[j] * np.tanh(velocity / DRY_FRICTION_FROM)
        if not np.isfinite(command.joint_pos[j] + velocity + command.torque[j]):
            command.joint_pos[j], command.joint_vel[j], command.torque[j] = 0.0, 0.0, 0.0
            command.stiffness[j], command.damping[j] = 0.0, DAMPING_AFTER_FAILURE
        lower, upper = model.lower[j] + config.joint_margin, model.upper[j] - config.joint_margin
        command.joint_pos[j] = min(max(command.joint_pos[j], lower), upper)
        limit = model.torque_limit[j]
        command.torque[j] = min(max(command.torque[j], -limit), limit)
