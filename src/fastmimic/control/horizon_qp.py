"""The QP of the long horizon: its Hessian, gradient and bounds (see `fastmimic.control.horizon`)."""

from typing import Any, Final

from fastmimic.base.arrays import Array
from fastmimic.base.jit import inlined, kernel
from fastmimic.control.config_parts import MAX_HORIZON_STEPS
from fastmimic.control.stance import friction_rows

MAX_VARIABLES: Final = 12 * MAX_HORIZON_STEPS
MAX_CONSTRAINTS: Final = 36 * MAX_HORIZON_STEPS


@inlined
def _along(column: Array, axis: int, v: Array) -> float:
    """Column of B times v; its linear part is along its own axis."""
    return column[axis] * v[axis] + column[3] * v[3] + column[4] * v[4] + column[5] * v[5]


@inlined
def variable(slot: int, axis: int, k: int) -> int:
    """Index of a force component: the z of all k forces first, for DAQP's simple bounds, then their x and y."""
    return slot if axis == 2 else k + 2 * slot + axis


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
def condense(config: Any, weight: float, ahead: Any, qp: Any) -> int:
    """Assembles the QP from `ahead` (standing, columns, drift, target, free[0]) and returns the number k of forces.
    There are 3 k variables, k simple bounds and 4 k or 8 k rows."""
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

    # friction and bounds
    for i in range(k):
        qp.lower[i], qp.upper[i] = config.min_force / weight, config.max_force / weight
    friction_rows(config, k, qp)
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
