"""Long-horizon convex model predictive control (Di Carlo et al. 2018): the ground forces of the coming steps.

The state is the body's pose X and velocity V, six components each, in the robot's heading frame at planning time;
orientations are rotation vectors from the present one. Over a step of length h with forces f,

    Ẍ = B f − g̃ − a,    X⁺ = X + h V + ½ h² Ẍ,    V⁺ = V + h Ẍ,

where B maps forces at the feet to accelerations as in the stance, linearised in each step along a nominal path beside
the reference, and a is what the legs' motion takes. The plan minimises, over the steps k,

    Σ ‖X_k − X̄_k‖²_Wp + ‖V_k − V̄_k‖²_Wv + ‖f_k‖²_R,   |f_x|, |f_y| ≤ μ f_z,  f_min ≤ f_z ≤ f_max.

The variables are the forces of the standing legs in each step, in multiples of the weight; the states are eliminated.
Because only B changes, the Hessian's block between steps i ≤ j is Bᵢᵀ D_ij Bⱼ with a diagonal D_ij in closed form: an
entry costs four products, and no matrix of the model is ever formed.
"""

from typing import Any, Final

import numpy as np

from fastmimic.base.arrays import Array
from fastmimic.base.conventions import GRAVITY
from fastmimic.base.jit import floats, inlined, integers, kernel, record_dtype
from fastmimic.base.vectors import copy, heading_of, heading_vector
from fastmimic.control.config import MAX_HORIZON_STEPS
from fastmimic.control.horizon_preview import foresee
from fastmimic.control.stance import solve_for_forces, variable
from fastmimic.reference.regulator import FEET, STATES

_N: Final = MAX_HORIZON_STEPS
HORIZON_VARIABLES: Final = 12 * _N
HORIZON_CONSTRAINTS: Final = 36 * _N

PLAN: Final = record_dtype(
    [
        *integers(age=(), valid=()),
        *floats(heading=(), state=(_N + 1, 12), reference=(_N + 1, 12), acceleration=(_N, 6), force=(_N, 4, 3)),
    ]
)
"""The plan of one robot, in the heading frame at planning time: its `age` in control steps; the frame's `heading`, rad;
at the ends of the steps X and V from where it was made (`state`), and X̄ and V̄ (`reference`); forces, N."""


@inlined
def _along(column: Array, axis: int, v: Array) -> float:
    """Column of B times v; its linear part is along its own axis."""
    return column[axis] * v[axis] + column[3] * v[3] + column[4] * v[4] + column[5] * v[5]


@inlined
def advance(step: float, acceleration: Array, state: Array, out: Array) -> None:
    """One step of the model."""
    for r in range(6):
        out[r] = state[r] + step * (state[6 + r] + 0.5 * step * acceleration[r])
        out[6 + r] = state[6 + r] + step * acceleration[r]


@inlined
def _coupling(config: Any, i: int, j: int, out: Array) -> None:
    """D_ij, i ≤ j: effect of accelerations in steps i and j together on the states from the end of step j on. A unit in
    step i moves X at the end of step k > i by h² (k − i − ½) and V by h; here summed over k > j."""
    h, m = config.horizon_step_s, float(config.horizon_steps - j)
    moved = h * h * (m * (4 * m * m - 1) / 12 + 0.5 * (j - i) * m * m)
    for r in range(6):
        out[r] = h * h * (config.horizon_velocity_weight[r] * m + config.horizon_position_weight[r] * moved)


@kernel
def condense(config: Any, ahead: Any, qp: Any) -> int:
    """Assembles the QP's cost from `ahead` (standing, columns, drift, target, free[0]); returns the count of forces."""
    steps, h = config.horizon_steps, config.horizon_step_s
    k = 0
    for j in range(steps):
        for leg in range(4):
            ahead.slot[j, leg] = -1
            if ahead.standing[j, leg] == 1:
                ahead.slot[j, leg] = k
                k += 1
    _hessian(config, ahead, k, qp)

    # gradient, back in time: `costate` is the cost's change with the state at the end of the step, without forces
    costate, impulse = ahead.costate, ahead.impulse
    for j in range(steps):
        advance(h, ahead.drift[j], ahead.free[j], ahead.free[j + 1])
    costate[:] = 0.0
    for j in range(steps - 1, -1, -1):
        for r in range(6):
            x, v = ahead.free[j + 1, r] - ahead.target[j + 1, r], ahead.free[j + 1, 6 + r] - ahead.target[j + 1, 6 + r]
            costate[6 + r] += h * costate[r] + config.horizon_velocity_weight[r] * v
            costate[r] += config.horizon_position_weight[r] * x
            impulse[r] = h * (0.5 * h * costate[r] + costate[6 + r])
        for leg in range(4):
            if ahead.slot[j, leg] < 0:
                continue
            for axis in range(3):
                at = variable(ahead.slot[j, leg], axis, k)
                qp.gradient[at] = _along(ahead.columns[j, leg, axis], axis, impulse)
    return k


@kernel
def _hessian(config: Any, ahead: Any, k: int, qp: Any) -> None:
    """Bᵢᵀ D_ij Bⱼ for all steps, and R on the diagonal."""
    n, weighted = 3 * k, ahead.costate
    for j in range(config.horizon_steps):
        for i in range(j + 1):
            _coupling(config, i, j, ahead.impulse)
            for leg in range(4):
                if ahead.slot[j, leg] < 0:
                    continue
                for axis in range(3):
                    column = ahead.columns[j, leg, axis]
                    at = variable(ahead.slot[j, leg], axis, k)
                    for r in range(6):
                        weighted[r] = ahead.impulse[r] * column[r]
                    for other in range(4):
                        if ahead.slot[i, other] < 0:
                            continue
                        for side in range(3):
                            value = _along(ahead.columns[i, other, side], side, weighted)
                            row = variable(ahead.slot[i, other], side, k)
                            qp.hessian[row * n + at] = value
                            qp.hessian[at * n + row] = value
    for i in range(n):
        qp.hessian[i * n + i] += config.horizon_force_weight


@kernel
def plan_forces(
    config: Any, model: Any, table: Any, clock: Any, obs: Any, memory: Any, scratch: Any, plan: Any, ahead: Any, qp: Any
) -> bool:
    """Plans the forces ahead of one robot (inputs as in `foresee`); False, and no plan, if the solver failed."""
    foresee(config, model, table, clock, obs, memory, scratch, ahead)
    weight = model.mass * GRAVITY
    k = condense(config, ahead, qp)
    solved = k == 0 or solve_for_forces(config, config.mu, weight, k, qp)
    plan.valid, plan.age = solved, 0
    if not solved:
        memory.qp_failures += 1
        memory.horizon_failures += 1
        return False
    plan.heading = heading_of(obs.root_quat)
    plan.reference = ahead.target
    copy(ahead.free[0], plan.state[0])
    for j in range(config.horizon_steps):
        acceleration = plan.acceleration[j]
        copy(ahead.drift[j], acceleration)
        for leg in range(4):
            plan.force[j, leg, :] = 0.0
            if ahead.slot[j, leg] < 0:
                continue
            for axis in range(3):
                share = qp.x[variable(ahead.slot[j, leg], axis, k)]
                plan.force[j, leg, axis] = share * weight
                for r in range(6):
                    acceleration[r] += ahead.columns[j, leg, axis, r] * share
        advance(config.horizon_step_s, acceleration, plan.state[j], plan.state[j + 1])
    return True


@kernel
def track_plan(config: Any, obs: Any, plan: Any, gain: Any, deviation: Array, ahead: Any, desired: Array) -> None:
    """Moves the stance's feedback `desired` (6,), ẍ_des in the heading frame, from the reference to the plan. Only the
    plan's deviation from the reference enters, in place of the feet's; the reference's course within a step of the
    horizon stays. `deviation` (28,) is the regulator's state."""
    h = config.horizon_step_s
    t = plan.age * config.dt
    j = min(int(t / h), config.horizon_steps - 1)
    t -= j * h
    state, reference, a = plan.state[j], plan.reference[j], plan.acceleration[j]
    change, apart = ahead.change, ahead.apart
    for r in range(6):
        mean = (plan.reference[j + 1, 6 + r] - reference[6 + r]) / h
        velocity = state[6 + r] - reference[6 + r]
        apart[r] = state[r] - reference[r] + t * (velocity + 0.5 * t * (a[r] - mean))
        apart[6 + r] = velocity + t * (a[r] - mean)
        change[r] = a[r] - config.reference_acceleration * mean
    for r in range(6):
        for k in range(FEET):
            change[r] += gain.trunk[r, k] * apart[k]
    for r in range(6):
        for k in range(FEET, STATES):  # the plan knows where the feet are
            desired[r] += gain.trunk[r, k] * deviation[k]
    turn = plan.heading - heading_of(obs.root_quat)
    for part in (change[0:3], change[3:6]):
        heading_vector(np.cos(turn), -np.sin(turn), part, part)
    for r in range(6):
        desired[r] += change[r]
