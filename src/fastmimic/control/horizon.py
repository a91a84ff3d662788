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
from fastmimic.base.jit import kernel, record_dtype
from fastmimic.base.vectors import heading_vector
from fastmimic.control.config_parts import MAX_HORIZON_STEPS
from fastmimic.control.daqp import OPTIMAL, solve_qp
from fastmimic.control.horizon_preview import foresee, heading_of
from fastmimic.control.horizon_qp import advance, condense, variable

_N: Final = MAX_HORIZON_STEPS

PLAN: Final = record_dtype(
    [
        ("age", "i8"),  # control steps since it was made
        ("valid", "i8"),
        ("heading", "f8"),  # of the frame that it is in, rad
        ("state", "f8", (_N + 1, 12)),  # X and V at the ends of the steps, from where it was made
        ("reference", "f8", (_N + 1, 12)),  # X̄ and V̄, as `state`
        ("acceleration", "f8", (_N, 6)),
        ("force", "f8", (_N, 4, 3)),  # N
    ]
)
"""The plan of one robot, in the heading frame at planning time."""


@kernel
def plan_forces(
    config: Any,
    model: Any,
    table: Any,
    clock: Any,
    obs: Any,
    memory: Any,
    scratch: Any,
    plan: Any,
    ahead: Any,
    qp: Any,
) -> bool:
    """Plans the forces ahead of one robot (inputs as in `foresee`); False, and no plan, if the solver failed."""
    foresee(config, model, table, clock, obs, memory, scratch, ahead)
    weight = model.mass * GRAVITY
    k = condense(config, weight, ahead, qp)
    solved = True
    if k > 0:
        solved = solve_qp(qp, 3 * k, (1 + config.friction_sides) * k, k) == OPTIMAL
        for i in range(3 * k):
            solved = solved and np.isfinite(qp.x[i])  # DAQP calls a problem with a NaN in it solved
    plan.valid, plan.age = solved, 0
    if not solved:
        memory.qp_failures += 1
        memory.horizon_failures += 1
        return False
    plan.heading = heading_of(obs.root_quat)
    plan.reference[:, :] = ahead.target
    plan.state[0, :] = ahead.free[0]
    for j in range(config.horizon_steps):
        acceleration = plan.acceleration[j]
        for r in range(6):
            acceleration[r] = ahead.drift[j, r]
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
def track_plan(config: Any, obs: Any, plan: Any, ahead: Any, desired: Array) -> None:
    """Moves the stance's feedback `desired` (6,), ẍ_des in the heading frame, from the reference to the plan. Only the
    plan's deviation from the reference enters: the reference's course within a step of the horizon, and the feet that
    the position is measured from, stay those of the stance."""
    h = config.horizon_step_s
    t = plan.age * config.dt
    j = min(int(t / h), config.horizon_steps - 1)
    t -= j * h
    state, reference, a = plan.state[j], plan.reference[j], plan.acceleration[j]
    change = ahead.change
    for r in range(6):
        mean = (plan.reference[j + 1, 6 + r] - reference[6 + r]) / h
        velocity = state[6 + r] - reference[6 + r]
        change[r] = config.kd[r] * (velocity + t * (a[r] - mean))
        change[r] += config.kp[r] * (state[r] - reference[r] + t * (velocity + 0.5 * t * (a[r] - mean)))
        change[r] += a[r] - config.reference_acceleration * mean
    turn = plan.heading - heading_of(obs.root_quat)
    heading_vector(np.cos(turn), -np.sin(turn), change[0:3], ahead.vector)
    for r in range(3):
        desired[r] += ahead.vector[r]
    heading_vector(np.cos(turn), -np.sin(turn), change[3:6], ahead.vector)
    for r in range(3):
        desired[3 + r] += ahead.vector[r]
