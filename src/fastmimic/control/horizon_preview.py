"""The coming steps of the long horizon: the reference's course, the standing feet, and the model about them."""

from typing import Any, Final

import numpy as np

from fastmimic.base.arrays import Array
from fastmimic.base.conventions import GRAVITY
from fastmimic.base.jit import floats, inlined, integers, kernel, record_dtype
from fastmimic.base.vectors import copy, heading_of, heading_vector, quat_to_matrix, rotation_error, times, turn_rows
from fastmimic.control.config import MAX_HORIZON_STEPS
from fastmimic.control.joint_commands import REGULATED
from fastmimic.control.stance import force_column
from fastmimic.reference.table import next_period

_N: Final = MAX_HORIZON_STEPS

FORESIGHT: Final = record_dtype(
    [
        *integers(standing=(_N, 4), slot=(_N, 4), time=2),  # slot: number of the leg's force, −1 in the air
        *floats(arms=(_N, 4, 3), inverse_inertia=(_N, 3, 3)),
        # accelerations without forces (gravity, and what the legs' motion takes), and by each force, in weights
        *floats(drift=(_N, 6), columns=(_N, 4, 3, 6)),
        # path of the body that these are for, from where it is; targets, and states without forces
        *floats(nominal=(_N + 1, 3), target=(_N + 1, 12), free=(_N + 1, 12), costate=12, impulse=6, rotation=(3, 3)),
        # the reference's root from the robot's, now; of where feet in the air will land from the reference's; from the
        # root to the centre of mass; changes of ẍ_des, and of the plan from the reference
        *floats(here=3, offset=(4, 3), com=3, change=6, apart=12),
    ]
)
"""Work memory for one robot's horizon, one record per thread."""


@inlined
def _beyond(table: Any, clock: Any, steps: int) -> int:
    """Control steps by which `steps` from now lies past the end of a motion that does not repeat."""
    return max(0, clock.sample + steps - table.shape[0] + 1) if clock.repeats == 0 else 0


@inlined
def _coasted(config: Any, ref: Any, steps: int) -> tuple[float, float, float]:
    """Planar displacement, in the table's frame, and turn of a body that keeps a sample's twist."""
    time = steps * config.dt
    turn = ref.ang_vel[2] * time
    # time · (sin θ / θ, (1 − cos θ) / θ)
    along, across = time, 0.5 * turn * time
    if abs(turn) > 1e-6:
        along, across = np.sin(turn) / ref.ang_vel[2], (1 - np.cos(turn)) / ref.ang_vel[2]
    vx, vy = ref.lin_vel[0], ref.lin_vel[1]
    return along * vx - across * vy, across * vx + along * vy, turn


@inlined
def _ahead(config: Any, table: Any, clock: Any, steps: int) -> tuple[int, float, float, float]:
    """Sample after `steps` control steps, and the origin (x, y, yaw) that it is seen from. After its end a motion keeps
    the twist of its last sample, level."""
    n = table.shape[0]
    sample = clock.sample + steps
    x, y, yaw = clock.origin[0], clock.origin[1], clock.origin[2]
    beyond = _beyond(table, clock, steps)
    if beyond > 0:
        sample = n - 1
        ref = table[sample]
        dx, dy, turn = _coasted(config, ref, beyond)
        c, s = np.cos(turn), np.sin(turn)
        # turned about the root, which has moved
        dx += ref.root_pos[0] - (c * ref.root_pos[0] - s * ref.root_pos[1])
        dy += ref.root_pos[1] - (s * ref.root_pos[0] + c * ref.root_pos[1])
        c, s = np.cos(yaw), np.sin(yaw)
        x += c * dx - s * dy
        y += s * dx + c * dy
        yaw += turn
    while sample >= n:
        sample -= n
        x, y, yaw = next_period(clock, x, y, yaw)
    return sample, x, y, yaw


@inlined
def _turned(c: float, s: float, m: Array, out: Array) -> None:
    """Rz m Rzᵀ of a symmetric 3 × 3 matrix, (c, s) of the angle."""
    a, b, d = m[0, 0], m[0, 1], m[1, 1]
    out[0, 0] = c * c * a - 2 * c * s * b + s * s * d
    out[1, 1] = s * s * a + 2 * c * s * b + c * c * d
    out[0, 1] = c * s * (a - d) + (c * c - s * s) * b
    out[0, 2] = c * m[0, 2] - s * m[1, 2]
    out[1, 2] = s * m[0, 2] + c * m[1, 2]
    out[1, 0], out[2, 0], out[2, 1] = out[0, 1], out[0, 2], out[1, 2]
    out[2, 2] = m[2, 2]


@kernel
def foresee(config: Any, model: Any, table: Any, clock: Any, obs: Any, memory: Any, scratch: Any, ahead: Any) -> None:
    """Fills `ahead` with what the reference wants and the feet allow in the coming steps. Reads from `scratch`:
    rotation, reference_rotation, feet, arms, inverse_inertia, velocity_error and the velocities."""
    rotation, arms = scratch.rotation, scratch.arms
    for r in range(3):
        ahead.free[0, r], ahead.free[0, 3 + r] = 0.0, 0.0
        ahead.free[0, 6 + r], ahead.free[0, 9 + r] = scratch.lin_vel[r], scratch.ang_vel[r]
        foot = scratch.feet[0]
        ahead.com[r] = rotation[r, 0] * foot[0] + rotation[r, 1] * foot[1] + rotation[r, 2] * foot[2] - arms[0, r]
    ahead.com[2] -= model.foot_radius
    heading = heading_of(obs.root_quat)
    _targets(config, table, clock, obs, scratch, heading, ahead)
    _landings(config, memory, scratch, ahead.offset)
    for leg in range(4):
        ahead.standing[0, leg] = memory.stance[leg]
        copy(arms[leg], ahead.arms[0, leg])
    for r in range(3):
        copy(scratch.inverse_inertia[r], ahead.inverse_inertia[0, r])
    yaw_error = np.arctan2(scratch.reference_rotation[1, 0], scratch.reference_rotation[0, 0])
    for j in range(1, config.horizon_steps):
        _footing(config, model, table, clock, scratch, heading, yaw_error, j, ahead)
    weight = model.mass * GRAVITY
    for j in range(config.horizon_steps):
        for leg in range(4):
            if ahead.standing[j, leg] == 0:
                continue
            for axis in range(3):
                column = ahead.columns[j, leg, axis]
                force_column(ahead.inverse_inertia[j], ahead.arms[j, leg], axis, model.mass, column)
                for r in range(6):
                    column[r] *= weight


@kernel
def _targets(config: Any, table: Any, clock: Any, obs: Any, scratch: Any, heading: float, ahead: Any) -> None:
    """Reference at the ends of the steps, and the nominal path beside it."""
    c, s = np.cos(heading), np.sin(heading)
    for j in range(config.horizon_steps + 1):
        steps = round(j * config.horizon_step_s / config.dt)
        sample, x, y, yaw = _ahead(config, table, clock, steps)
        ref, target = table[sample], ahead.target[j]
        co, so = np.cos(yaw), np.sin(yaw)
        dx = x + co * ref.root_pos[0] - so * ref.root_pos[1] - obs.root_pos[0]
        dy = y + so * ref.root_pos[0] + co * ref.root_pos[1] - obs.root_pos[1]
        target[0], target[1], target[2] = c * dx + s * dy, -s * dx + c * dy, ref.root_pos[2] - obs.root_pos[2]
        for r in range(3):
            if j == 0:
                ahead.here[r] = target[r]
            ahead.nominal[j, r] = target[r] - ahead.here[r]
        ct, st = np.cos(yaw - heading), np.sin(yaw - heading)
        quat_to_matrix(ref.root_quat, ahead.rotation)
        turn_rows(ct, st, ahead.rotation)
        rotation_error(ahead.rotation, scratch.rotation, target[3:6])
        heading_vector(ct, -st, ref.lin_vel, target[6:9])
        heading_vector(ct, -st, ref.ang_vel, target[9:12])
        if _beyond(table, clock, steps) > 0:  # height and tilt stay
            target[8], target[9], target[10] = 0.0, 0.0, 0.0
        if j == config.horizon_steps:
            return
        # gravity, and what the legs take in the middle of the step
        steps = round((j + 0.5) * config.horizon_step_s / config.dt)
        sample, x, y, yaw = _ahead(config, table, clock, steps)
        ct, st = np.cos(yaw - heading), np.sin(yaw - heading)
        drift = ahead.drift[j]
        heading_vector(ct, -st, table[sample].leg_lin_acc, drift[0:3])
        heading_vector(ct, -st, table[sample].leg_ang_acc, drift[3:6])
        if _beyond(table, clock, steps) > 0:  # the legs stay as they are
            drift[:] = 0.0
        for r in range(6):
            drift[r] = -config.leg_momentum * drift[r] - (scratch.against[r] if r < 3 else 0.0)


@inlined
def _landings(config: Any, memory: Any, scratch: Any, offset: Array) -> None:
    """Offset (4, 3) of the next footholds from the reference's, heading frame."""
    rotation = scratch.rotation
    for leg in range(4):
        for r in range(3):
            offset[leg, r] = 0.0
            if memory.stance[leg] == 1 or r == 2:
                continue
            if config.foothold == REGULATED:
                offset[leg, r] = memory.foot_shift[leg, r] + scratch.lean[r]
                continue
            for q in range(2):
                offset[leg, r] -= rotation[r, q] * config.velocity_feedback[q] * scratch.velocity_error[q]


@kernel
def _footing(
    config: Any, model: Any, table: Any, clock: Any, scratch: Any, heading: float, yaw_error: float, j: int, ahead: Any
) -> None:
    """Feet that stand in the middle of step j ≥ 1, and their arms from the centre of mass on its nominal path."""
    steps = round((j + 0.5) * config.horizon_step_s / config.dt)
    sample, _, _, yaw = _ahead(config, table, clock, steps)
    ref = table[sample]
    turn = yaw - heading - yaw_error  # a yaw error goes along with the robot
    quat_to_matrix(ref.root_quat, ahead.rotation)
    turn_rows(np.cos(turn), np.sin(turn), ahead.rotation)
    turned = np.arctan2(ahead.rotation[1, 0], ahead.rotation[0, 0])
    c, s = np.cos(turned), np.sin(turned)
    com_x, com_y, com_z = c * ahead.com[0] - s * ahead.com[1], s * ahead.com[0] + c * ahead.com[1], ahead.com[2]
    # a foot stays where it stands at the motion's end
    dx, dy, coasted = _coasted(config, ref, _beyond(table, clock, steps))
    ct, st = np.cos(yaw - coasted - heading), np.sin(yaw - coasted - heading)
    left_x, left_y = ct * dx - st * dy, st * dx + ct * dy
    turn_rows(np.cos(-coasted), np.sin(-coasted), ahead.rotation)
    for leg in range(4):
        ahead.standing[j, leg] = ref.contact[leg]
        if ref.contact[leg] == 0:
            continue
        stood = True
        for i in range(j):
            stood = stood and ahead.standing[i, leg] == 1
        arm = ahead.arms[j, leg]
        if stood:
            for r in range(3):
                arm[r] = scratch.arms[leg, r] + ahead.com[r] - 0.5 * (ahead.nominal[j, r] + ahead.nominal[j + 1, r])
        else:
            times(ahead.rotation, ref.foot_pos[leg], arm)
            for r in range(3):
                arm[r] += ahead.offset[leg, r]
            arm[0] -= left_x
            arm[1] -= left_y
            arm[2] += ahead.here[2] - model.foot_radius
        arm[0] -= com_x
        arm[1] -= com_y
        arm[2] -= com_z
    _turned(c, s, scratch.inverse_inertia, ahead.inverse_inertia[j])
