"""A motion's problem as a sparse nonlinear program for IPOPT, through CasADi.

The exact derivatives of one node (`node`) are put together to sparse ones of the whole, whose size grows linearly with
the number of nodes. CasADi alone would find the same by colouring, in much longer time.
"""

from collections.abc import Callable
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from fastmimic.base.arrays import Array
from fastmimic.trajectory.config import TrajectoryConfig
from fastmimic.trajectory.node import N_ROWS, N_VARIABLES, NodeFunctions
from fastmimic.trajectory.tape import on_nodes

DIVERGED: Final = "User_Requested_Stop"
"""IPOPT's word for a solver that `_MOST_MULTIPLIER` stops."""
_MOST_MULTIPLIER: Final = 1e9
"""Where the multipliers of the constraints grow without bound, no solution is near, and the solver would go on for
minutes. With a solution the greatest was below 2000 for cycles, and up to 2e7 on the way to it for passages."""


def make_solver(
    functions: NodeFunctions,
    index: NDArray[np.int_],
    given: Array,
    bounds: tuple[Array, Array],
    quadratic: tuple[Any, Array],
    config: TrajectoryConfig,
) -> tuple[Any, tuple[Array, Array]]:
    """IPOPT for a whole motion, and the bounds of its constraints.

    Args:
        index: (N, 77) variables of the program that are those of each node.
        given: (N, 91) parameters of the nodes.
        bounds: (N, 93) of the rows; those without a finite bound are left out.
        quadratic: sparse E (e, n) and e (e,) of a further cost |E w − e|² of all variables w (n,).
    """
    import casadi as ca
    import scipy.sparse as sp

    smooth, offset = quadratic
    n, nodes = smooth.shape[1], len(index)
    low, high = (bound.ravel() for bound in bounds)
    selected = np.flatnonzero(np.isfinite(low) | np.isfinite(high))
    w = ca.MX.sym("w", n)
    z, known = ca.reshape(w[index.ravel().tolist()], N_VARIABLES, nodes), ca.DM(given.T)
    rest = ca.DM(smooth.tocsc()) @ w - ca.DM(offset)
    cost = ca.sum2(functions.cost.map(nodes)(z, known)) + ca.sumsqr(rest)
    rows = ca.vec(functions.rows.map(nodes)(z, known))[selected.tolist()]
    cost_of, rows_of = ca.Function("cost", [w], [cost]), ca.Function("rows", [w], [rows])

    gather = sp.csc_matrix((np.ones(index.size), (index.ravel(), np.arange(index.size))), (n, index.size))
    gradient_of = on_nodes(functions.gradient, nodes)

    def gradient(w: Array) -> Array:
        return np.asarray(gather @ gradient_of(w[index], given).ravel() + 2 * (smooth.T @ (smooth @ w - offset)))

    local_row, local_column = functions.jacobian_at
    place = np.full(N_ROWS * nodes, -1)
    place[selected] = np.arange(len(selected))
    row = place[(N_ROWS * np.arange(nodes)[:, None] + local_row).ravel()]
    slopes, slopes_sum = _sparse(row, index[:, local_column].ravel(), (len(selected), n), row >= 0)
    jacobian_of = on_nodes(functions.jacobian, nodes)

    def jacobian(w: Array) -> Array:
        return np.asarray(slopes_sum @ jacobian_of(w[index], given).ravel())

    local_row, local_column = functions.hessian_at
    a, b = index[:, local_row].ravel(), index[:, local_column].ravel()
    twice = np.where((a == b) & np.tile(local_row != local_column, nodes), 2.0, 1.0)  # two entries, one variable
    curvature = sp.triu(2 * (smooth.T @ smooth)).tocoo()
    row = np.concatenate([np.minimum(a, b), curvature.row])
    column = np.concatenate([np.maximum(a, b), curvature.col])
    curves, curves_sum = _sparse(row, column, (n, n), np.ones(len(row), dtype=np.bool_))
    constant = curves_sum[:, len(a) :] @ curvature.data
    curves_sum = curves_sum[:, : len(a)] @ sp.diags(twice)
    hessian_of, shared = on_nodes(functions.hessian, nodes), np.zeros(len(place))

    def hessian(w: Array, factor: Array, multipliers: Array) -> Array:
        shared[selected] = multipliers
        factors = np.full((nodes, 1), factor[0])
        entries = hessian_of(w[index], given, factors, shared.reshape(nodes, N_ROWS))
        return np.asarray(curves_sum @ entries.ravel() + factor[0] * constant)

    one, x, g = (ca.Sparsity.dense(size) for size in (1, n, len(selected)))
    first = {"x": x, "p": ca.Sparsity.dense(0)}
    computed = {
        "grad_f": _computed("nlp_grad_f", first, {"f": (one, cost_of), "grad_f_x": (x, gradient)}),
        "jac_g": _computed("nlp_jac_g", first, {"g": (g, rows_of), "jac_g_x": (slopes, jacobian)}),
        "hess_lag": _computed(
            "nlp_hess_l", first | {"lam_f": one, "lam_g": g}, {"triu_hess_gamma_x_x": (curves, hessian)}
        ),
    }
    interrupts: list[int] = []

    def stop(x: Array, f: Array, g: Array, lam_x: Array, lam_g: Array) -> bool:
        return bool(interrupts) or bool(np.abs(lam_g).max() > _MOST_MULTIPLIER)

    sizes = {"x": x, "f": one, "lam_x": x, "g": g, "lam_g": g}
    watch = _computed(
        "diverging",
        {name: sizes.get(name, ca.Sparsity(0, 0)) for name in ca.nlpsol_out()},
        {"stop": (one, stop)},
    )
    options = {
        **computed,
        "print_time": False,
        "show_eval_warnings": False,
        "ipopt.sb": "yes",
        "ipopt.print_level": 0,
        "ipopt.max_iter": config.iterations,
        "ipopt.tol": config.tolerance,
        # what is left to gain then is 4 % of the cost of a passage, in as many iterations again
        "ipopt.acceptable_tol": 30 * config.tolerance,
        "ipopt.acceptable_iter": 2,
        "ipopt.acceptable_constr_viol_tol": 5e-5,
        "ipopt.mumps_pivot_order": 0,  # minimum degree: half of the time of METIS here
        "ipopt.constr_viol_tol": 1e-5,
        "ipopt.dual_inf_tol": 10.0,
        "ipopt.mu_strategy": "adaptive",
        "ipopt.nlp_scaling_method": "none",  # the rows are shares of their limits; 30 % fewer iterations than with it
        "ipopt.fixed_variable_treatment": "make_parameter",
        "iteration_callback": watch,
    }
    solver = ca.nlpsol("nearest", "ipopt", {"x": w, "f": cost, "g": rows}, options)
    solver.calls_back, solver.interrupts = (watch, computed), interrupts  # the solver itself keeps none alive
    return solver, (low[selected], high[selected])


def _computed(name: str, given: dict[str, Any], found: dict[str, tuple[Any, Callable[..., Any]]]) -> Any:
    """A CasADi function of inputs with the sparsities `given`, whose outputs `found` have a sparsity and a function
    each: of the inputs but the empty ones, to a vector or to the entries of a sparse matrix."""
    import casadi as ca

    class Computed(ca.Callback):
        def __init__(self) -> None:
            ca.Callback.__init__(self)
            self.construct(name, {})

        def get_n_in(self) -> int:
            return len(given)

        def get_n_out(self) -> int:
            return len(found)

        def get_name_in(self, i: int) -> str:
            return list(given)[i]

        def get_name_out(self, i: int) -> str:
            return list(found)[i]

        def get_sparsity_in(self, i: int) -> Any:
            return list(given.values())[i]

        def get_sparsity_out(self, i: int) -> Any:
            return list(found.values())[i][0]

        def has_eval_buffer(self) -> bool:
            return True

        def eval_buffer(self, arguments: list[Any], results: list[Any]) -> int:
            values = [np.frombuffer(buffer) for buffer in arguments if buffer]
            for buffer, (_, function) in zip(results, found.values(), strict=True):
                if buffer:  # else it is not wanted
                    np.frombuffer(buffer)[:] = np.ravel(function(*values))
            return 0

    return Computed()


def _sparse(
    row: NDArray[np.int_], column: NDArray[np.int_], shape: tuple[int, int], kept: NDArray[np.bool_]
) -> tuple[Any, Any]:
    """Sparsity of entries at (row, column), and the matrix that adds the values of those `kept` to its nonzeros."""
    import casadi as ca
    import scipy.sparse as sp

    key = column[kept].astype(np.int64) * shape[0] + row[kept]
    unique, place = np.unique(key, return_inverse=True)
    pattern = ca.Sparsity.triplet(*shape, (unique % shape[0]).tolist(), (unique // shape[0]).tolist())
    gather = sp.csc_matrix((np.ones(len(place)), (place, np.flatnonzero(kept))), (len(unique), len(row)))
    return pattern, gather
