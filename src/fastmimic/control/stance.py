"""Stance: which legs stand (paper, §III-B1), and the forces that accelerate the body (eq. 1; Di Carlo et al. 2018).

The gait planner is a state machine per leg over contact schedule and measured contact. A leg leaves stance when the
schedule says so (take-off), or when it bears nothing for a while in scheduled stance, though it is asked to or the
ground is rough, where it may have missed it (early take-off). It enters stance when the schedule says so (touch-down),
or when it meets the ground late in a scheduled swing (early touch-down). Two switches of a leg are at least
`min_switch_time` apart, but for scheduled take-offs: a leg that has only just stood again, and waits, swings late and
along the ground.

All vectors are in the heading frame (world frame turned by the robot's yaw), so that gains keep their meaning in turns.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from fastmimic.base.arrays import Array, Records
from fastmimic.base.jit import inlined, kernel
from fastmimic.control.footing import SMALL_HEIGHT_M
from fastmimic.control.native import INFINITY, OPTIMAL, solve_qp

MAX_VARIABLES = 12
MAX_CONSTRAINTS = 4 + 32
_SIDES = np.array([[-1, 0], [1, 0], [0, -1], [0, 1], *(np.sqrt(0.5) * np.array([[-1, -1], [-1, 1], [1, -1], [1, 1]]))])
_HOLD_STEPS = 10  # control steps for which the last forces are held when the QP fails


def begin_legs(memory: Records, tables: Records, sample: NDArray[np.int64]) -> None:
    """Clears the memory (n,) of `MEMORY`; leg states become those of the tables (1 or n, t) at `sample` (n,)."""
    memory[...] = np.zeros((), memory.dtype)
    memory["stance"] = tables["contact"][np.minimum(np.arange(len(memory)), len(tables) - 1), sample]
    memory["since_switch"] = 1e3


@inlined
def plan_leg(config: Any, memory: Any, leg: int, wanted: bool, swung: float, force_z: float) -> bool:
    """Advances one leg in `memory` by one control step; True if it has just lifted off. `wanted` is the scheduled
    stance, `swung` the share of the scheduled swing that is over, `force_z` the measured vertical ground force, N."""
    loaded = force_z > config.contact_threshold
    memory.since_switch[leg] += config.dt
    free = force_z < config.release_threshold
    memory.unloaded_time[leg] = memory.unloaded_time[leg] + config.dt if free else 0.0
    asked = memory.force[leg, 2] >= config.early_takeoff_force or memory.roughness > 2 * SMALL_HEIGHT_M
    missed = free and asked
    memory.missed_time[leg] = memory.missed_time[leg] + config.dt if missed else 0.0
    if config.planner_full == 0:
        stood = memory.stance[leg] == 1
        if wanted != stood:
            _switch(memory, leg, 1 if wanted else 0)
        return stood and not wanted
    least = config.recovery_switch_time if memory.recovering > 0 else config.min_switch_time
    may_switch = memory.since_switch[leg] >= least
    if memory.stance[leg] == 1:
        if loaded:
            memory.was_loaded[leg] = 1
        lost = memory.was_loaded[leg] == 1 and memory.missed_time[leg] >= config.early_takeoff_time
        if wanted:
            memory.early[leg] = 0
        # after an early touch-down the leg stands until the schedule agrees, unless it comes free again
        due = not wanted and memory.early[leg] == 0
        if due or (lost and may_switch):
            _switch(memory, leg, 0)
            return True
    elif may_switch and (wanted or (loaded and swung >= config.early_touchdown_from)):
        if not wanted:
            memory.early[leg] = 1
            memory.early_touchdowns += 1
        _switch(memory, leg, 1)
    return False


@inlined
def _switch(memory: Any, leg: int, stance: int) -> None:
    memory.stance[leg] = stance
    memory.since_switch[leg] = 0.0
    memory.was_loaded[leg] = 0
    memory.raised[leg] = 0.0
    if stance == 0:
        memory.early[leg] = 0


@inlined
def invert_symmetric_3x3(a: Array, out: Array) -> None:
    """Inverse of a symmetric positive definite 3 × 3 matrix."""
    c00 = a[1, 1] * a[2, 2] - a[1, 2] * a[1, 2]
    c01 = a[0, 2] * a[1, 2] - a[0, 1] * a[2, 2]
    c02 = a[0, 1] * a[1, 2] - a[0, 2] * a[1, 1]
    det = a[0, 0] * c00 + a[0, 1] * c01 + a[0, 2] * c02
    out[0, 0], out[0, 1], out[0, 2] = c00 / det, c01 / det, c02 / det
    out[1, 0], out[1, 1] = c01 / det, (a[0, 0] * a[2, 2] - a[0, 2] * a[0, 2]) / det
    out[1, 2] = (a[0, 1] * a[0, 2] - a[0, 0] * a[1, 2]) / det
    out[2, 0], out[2, 1] = out[0, 2], out[1, 2]
    out[2, 2] = (a[0, 0] * a[1, 1] - a[0, 1] * a[0, 1]) / det


@inlined
def force_column(inverse_inertia: Array, arm: Array, axis: int, mass: float, out: Array) -> None:
    """Acceleration (6,) of the body by a unit force along `axis` at `arm` from the centre of mass."""
    out[0], out[1], out[2] = 0.0, 0.0, 0.0
    out[axis] = 1.0 / mass
    if axis == 0:
        m0, m1, m2 = 0.0, arm[2], -arm[1]
    elif axis == 1:
        m0, m1, m2 = -arm[2], 0.0, arm[0]
    else:
        m0, m1, m2 = arm[1], -arm[0], 0.0
    for i in range(3):
        out[3 + i] = inverse_inertia[i, 0] * m0 + inverse_inertia[i, 1] * m1 + inverse_inertia[i, 2] * m2


@inlined
def variable(slot: int, axis: int, k: int) -> int:
    """Index of a force component: the z of all k forces first, for DAQP's simple bounds, then their x and y."""
    return slot if axis == 2 else k + 2 * slot + axis


@inlined
def solve_for_forces(config: Any, mu: float, unit: float, k: int, qp: Any) -> bool:
    """Solves for k forces in multiples of `unit` N, within bounds on f_z and friction; False if the solver failed."""
    for i in range(k):
        qp.lower[i], qp.upper[i] = config.min_force / unit, config.max_force / unit
    _friction_rows(config, mu, k, qp)
    solved = solve_qp(qp, 3 * k, (1 + config.friction_sides) * k, k) == OPTIMAL
    for i in range(3 * k):
        solved = solved and np.isfinite(qp.x[i])  # DAQP calls a problem with a NaN in it solved
    return solved


@inlined
def _friction_rows(config: Any, mu: float, k: int, qp: Any) -> None:
    """Writes the friction pyramids of k forces, 4 k or 8 k rows, below the k simple bounds on f_z."""
    n, row = 3 * k, 0
    qp.rows[: config.friction_sides * k * n] = 0.0
    for first in range(0, config.friction_sides, 4):
        for i in range(k):
            for side in range(first, first + 4):  # the force along a side's normal − μ f_z ≤ 0
                qp.rows[row * n + i] = -mu
                qp.rows[row * n + k + 2 * i], qp.rows[row * n + k + 2 * i + 1] = _SIDES[side, 0], _SIDES[side, 1]
                qp.upper[k + row], qp.lower[k + row] = 0.0, -INFINITY
                row += 1


@kernel
def stance_forces(config: Any, model: Any, gain: Any, memory: Any, scratch: Any, qp: Any) -> bool:
    """Solves for the forces of the standing legs, into `memory.force`; False if the solver failed.

        min ‖A f − g̃ − ẍ_des‖²_Q + ‖f‖²_R,  |f_x|, |f_y| ≤ μ f_z,  f_min ≤ f_z ≤ f_max;  f = 0 in swing;
        with `friction_sides` 8 also |f_x ± f_y| ≤ √2 μ f_z.

    The variables are the z forces of the k standing legs, then their x and y forces, so that the bounds on f_z are
    DAQP's simple bounds. After a failure the last forces are held for a few steps and then dropped. Reads from
    `scratch`: inverse_inertia, arms, desired (ẍ_des) and against (g̃); Q is `gain.weight`.
    """
    desired, against, columns, weighted = scratch.desired, scratch.against, scratch.columns, scratch.weighted
    k = memory.stance[0] + memory.stance[1] + memory.stance[2] + memory.stance[3]
    if k == 0:
        memory.force[:, :] = 0.0
        memory.failed_in_a_row = 0
        return True
    n, index = 3 * k, 0
    for leg in range(4):
        if memory.stance[leg] == 0:
            continue
        for axis in range(3):
            column = columns[variable(index, axis, k)]
            force_column(scratch.inverse_inertia, scratch.arms[leg], axis, model.mass, column)
        index += 1
    for i in range(n):
        gradient = 0.0
        for r in range(6):
            weighted[i, r] = 0.0
            for c in range(6):
                weighted[i, r] += gain.weight[r, c] * columns[i, c]
            gradient -= weighted[i, r] * (desired[r] + (against[r] if r < 3 else 0.0))
        qp.gradient[i] = gradient
        for j in range(i + 1):
            h = config.r_weight if i == j else 0.0
            for r in range(6):
                h += weighted[i, r] * columns[j, r]
            qp.hessian[i * n + j] = h
            qp.hessian[j * n + i] = h
    if not solve_for_forces(config, memory.friction, 1.0, k, qp):
        memory.qp_failures += 1
        memory.failed_in_a_row += 1
        for leg in range(4):
            if memory.stance[leg] == 0 or memory.failed_in_a_row > _HOLD_STEPS:
                memory.force[leg, :] = 0.0
        return False
    memory.failed_in_a_row = 0
    index = 0
    for leg in range(4):
        if memory.stance[leg] == 0:
            memory.force[leg, :] = 0.0
            continue
        for axis in range(3):
            memory.force[leg, axis] = qp.x[variable(index, axis, k)]
        index += 1
    return True
