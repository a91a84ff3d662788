"""Errors between robot and reference, and the acceleration that should reduce them (paper, eq. 1)."""

from typing import Any, Final

import numpy as np

from fastmimic.base.arrays import Array
from fastmimic.base.conventions import GRAVITY
from fastmimic.base.jit import inlined
from fastmimic.base.vectors import heading_vector, quat_to_matrix, rotation_error, transposed_times, turn_rows, turned
from fastmimic.control.recovery import find_urgency
from fastmimic.control.stance import force_column, invert_symmetric_3x3
from fastmimic.reference.regulator import FEET, RATES, STATES
from fastmimic.reference.table import in_world
from fastmimic.robot.dynamics import leg_mass_moment
from fastmimic.robot.kinematics import leg_forward

MOST_DISTURBANCE: Final = (3.0, 10.0)  # m/s², rad/s²
LEAN: Final = (0.3, 0.7)  # shares of that distance along and across which trot and walk need
FAR_S: Final = 0.5  # a step that is farther ahead catches nobody: the feet that stand have to hold the robot
LAG_S: Final = 0.3  # time constant with which the trunk follows standing feet of a reference that made haste
LATE: Final = 0.9  # a foot that should have landed keeps this share of its shift's speed each step


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
        arms[leg, 0], arms[leg, 1], arms[leg, 2] = turned(rotation, x, y, z)
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
    scratch.heading[0], scratch.heading[1] = c, s
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
    heading_vector(c, s, scratch.uphill, scratch.against)
    for a in range(2):
        scratch.lean[a] = -LEAN[a] * ref.root_pos[2] * scratch.against[a] / scratch.against[2]
    heading_vector(ct, -st, ref.lin_vel, scratch.ref_lin_vel)
    heading_vector(ct, -st, ref.ang_vel, scratch.ref_ang_vel)

    x, y = in_world(clock, ref.root_pos)
    x, y = x - obs.root_pos[0], y - obs.root_pos[1]
    scratch.error[0], scratch.error[1] = c * x + s * y, -s * x + c * y
    scratch.error[2] = ref.root_pos[2] - obs.root_pos[2]
    rotation_error(reference_rotation, rotation, scratch.angle_error)
    for k in range(3):
        scratch.lin_vel_error[k] = scratch.ref_lin_vel[k] - scratch.lin_vel[k]
        scratch.ang_vel_error[k] = scratch.ref_ang_vel[k] - scratch.ang_vel[k]


@inlined
def body_frame(ref: Any, scratch: Any) -> None:
    """Velocities and their errors in the body frame, for the legs."""
    rotation, reference_rotation = scratch.rotation, scratch.reference_rotation
    transposed_times(rotation, scratch.lin_vel, scratch.lin_vel_b)
    transposed_times(rotation, scratch.ang_vel, scratch.ang_vel_b)
    transposed_times(reference_rotation, scratch.ref_lin_vel, scratch.ref_lin_vel_b)
    transposed_times(reference_rotation, scratch.ref_ang_vel, scratch.ref_ang_vel_b)
    transposed_times(rotation, scratch.lin_vel_error, scratch.velocity_error)
    scratch.joint_acc = ref.joint_acc


@inlined
def estimate_disturbance(config: Any, obs: Any, memory: Any, scratch: Any) -> None:
    """Follows the acceleration that the last step's forces do not explain, slowly: a payload, a slope, wrong masses."""
    if config.disturbance_time == 0.0:
        return
    share = min(config.dt / config.disturbance_time, 1.0)
    for at in range(0, 6, 3):
        now, change = (obs.lin_vel if at == 0 else obs.ang_vel), scratch.change
        for k in range(3):
            scratch.vector[k] = (now[k] - memory.velocity[at + k]) / config.dt
            memory.velocity[at + k] = now[k]
        heading_vector(scratch.heading[0], scratch.heading[1], scratch.vector, change)
        if memory.began == 0:
            continue
        most = MOST_DISTURBANCE[at // 3]
        for k in range(3):
            d = memory.disturbance[at + k]
            d += share * (change[k] - memory.expected[at + k] - d)
            memory.disturbance[at + k] = min(max(d, -most), most)
    memory.began = 1


@inlined
def expect_acceleration(model: Any, memory: Any, scratch: Any) -> None:
    """The trunk's acceleration by this step's forces, for `estimate_disturbance`."""
    expected, column = memory.expected, scratch.column
    for r in range(6):
        expected[r] = -scratch.momentum[r]
    for k in range(3):
        expected[k] -= scratch.against[k]
    for leg in range(4):
        if memory.stance[leg] == 0:
            continue
        for axis in range(3):
            force_column(scratch.inverse_inertia, scratch.arms[leg], axis, model.mass, column)
            for r in range(6):
                expected[r] += column[r] * memory.force[leg, axis]


@inlined
def _make_haste(config: Any, ref: Any, gain: Any, memory: Any, scratch: Any, state: Array) -> None:
    """How much faster the reference's feet have to move, so that the next step can catch the robot: the distance of the
    capture point from the reference's, both from their feet, grows until a foot lands as an inverted pendulum falls."""
    x, y, n = 0.0, 0.0, 0
    for leg in range(4):
        if memory.stance[leg] == 1:
            x += memory.foot_shift[leg, 0]
            y += memory.foot_shift[leg, 1]
            n += 1
    if n > 0:
        x, y = x / n, y / n
    rate = np.sqrt(GRAVITY / ref.root_pos[2])
    x, y = state[6] / rate - x, state[7] / rate - y
    share = np.hypot(x / config.step_reach[0], y / config.step_reach[1])
    due = config.least_step_time
    if share < 1.0:
        due = max(due, -np.log(max(share, 1e-9)) / rate)
    find_urgency(config, ref, gain, memory, scratch, x, y)
    memory.haste = min(max(gain.landing / due - 1.0, 0.0), config.most_haste) if gain.landing < FAR_S else 0.0


@inlined
def regulate(config: Any, ref: Any, gain: Any, memory: Any, scratch: Any) -> None:
    """ẍ_des for the standing legs, and where the others' feet are to be (`fastmimic.reference.regulator`)."""
    state, rotation, reference_rotation = scratch.state, scratch.rotation, scratch.reference_rotation
    shift, rate = memory.foot_shift, memory.foot_shift_rate
    for k in range(3):
        state[k] = -scratch.error[k]
        state[3 + k] = -scratch.angle_error[k]
        state[6 + k] = -scratch.lin_vel_error[k]
        state[9 + k] = -scratch.ang_vel_error[k]
    for leg in range(4):
        for a in range(2):
            if memory.stance[leg] == 1:
                memory.lag[leg, a] += config.dt * max(memory.haste, 0.0) * scratch.ref_lin_vel[a]
                memory.lag[leg, a] *= 1.0 - config.dt / LAG_S
                shift[leg, a], rate[leg, a] = -memory.lag[leg, a] - scratch.lean[a], 0.0
                for k in range(3):
                    shift[leg, a] += rotation[a, k] * scratch.feet[leg, k]
                    shift[leg, a] -= reference_rotation[a, k] * ref.foot_pos[leg, k]
            state[FEET + 2 * leg + a] = shift[leg, a] + state[a]
            state[RATES + 2 * leg + a] = rate[leg, a]
    _make_haste(config, ref, gain, memory, scratch, state)
    c, s = scratch.turn[0], scratch.turn[1]
    heading_vector(c, -s, ref.lin_acc, scratch.ref_lin_acc)
    heading_vector(c, -s, ref.ang_acc, scratch.ref_ang_acc)
    for r in range(6):
        forward = scratch.ref_lin_acc[r] if r < 3 else scratch.ref_ang_acc[r - 3]
        scratch.desired[r] = config.reference_acceleration * forward - memory.disturbance[r]
        for k in range(STATES):
            scratch.desired[r] -= gain.trunk[r, k] * state[k]
    turned, tempo = config.dt * scratch.ang_vel[2], 1.0 + memory.haste
    for leg in range(4):
        if memory.stance[leg] == 1:
            continue
        for a in range(2):
            memory.lag[leg, a] = 0.0
            if ref.contact[leg] == 1:
                rate[leg, a] *= LATE  # should have landed
            for k in range(STATES):
                faster = tempo if k >= RATES else tempo * tempo
                rate[leg, a] -= config.dt * faster * gain.feet[2 * leg + a, k] * state[k]
            shift[leg, a] += config.dt * (rate[leg, a] - state[6 + a])
        x, y = shift[leg, 0], shift[leg, 1]
        shift[leg, 0], shift[leg, 1] = x + turned * y, y - turned * x
