"""A motion's problem as a sparse nonlinear program for IPOPT, through CasADi.

The exact derivatives of one node (`node`) are put together to sparse ones of the whole, whose size grows linearly with
the number of nodes. CasADi alone would find the same by colouring, in much longer time.
"""

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from fastmimic.base.arrays import Array
from fastmimic.trajectory.config import TrajectoryConfig
from fastmimic.trajectory.node import N_ROWS, N_VARIABLES, NodeFunctions

_DIVERGED: Final = 1e5


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
        given: (N, 81) parameters of the nodes.
        bounds: (N, 93) of the rows; those without a finite bound are left out.
        quadratic: sparse E (e, n) and e (e,) of a further cost |E w − e|² of all variables w (n,).
    """
    import casadi as ca
    import scipy.sparse as sp

    smooth, offset = quadratic
    n, nodes = smooth.shape[1], len(index)
    low, high = (bound.ravel() for bound in bounds)
    selected = np.flatnonzero(np.isfinite(low) | np.isfinite(high))
    w, empty, factor = ca.MX.sym("w", n), ca.MX.sym("p", 0), ca.MX.sym("factor")
    multipliers = ca.MX.sym("multipliers", len(selected))
    z, known = ca.reshape(w[index.ravel().tolist()], N_VARIABLES, nodes), ca.DM(given.T)

    matrix = ca.DM(smooth.tocsc())
    rest = matrix @ w - ca.DM(offset)
    cost = ca.sum2(functions.cost.map(nodes)(z, known)) + ca.sumsqr(rest)
    rows = ca.vec(functions.rows.map(nodes)(z, known))[selected.tolist()]
    gather = _accumulation(index.ravel(), n)
    gradient = ca.DM(gather) @ ca.vec(functions.gradient.map(nodes)(z, known)) + 2 * matrix.T @ rest

    local_row, local_column = functions.jacobian_at
    place = np.full(N_ROWS * nodes, -1)
    place[selected] = np.arange(len(selected))
    row = place[(N_ROWS * np.arange(nodes)[:, None] + local_row).ravel()]
    pattern, gather = _sparse(row, index[:, local_column].ravel(), (len(selected), n), row >= 0)
    jacobian = ca.MX(pattern, ca.DM(gather) @ ca.vec(functions.jacobian.map(nodes)(z, known)))

    local_row, local_column = functions.hessian_at
    a, b = index[:, local_row].ravel(), index[:, local_column].ravel()
    twice = np.where((a == b) & np.tile(local_row != local_column, nodes), 2.0, 1.0)  # two entries, one variable
    curvature = sp.triu(2 * (smooth.T @ smooth)).tocoo()
    row = np.concatenate([np.minimum(a, b), curvature.row])
    column = np.concatenate([np.maximum(a, b), curvature.col])
    pattern, gather = _sparse(row, column, (n, n), np.ones(len(row), dtype=np.bool_))
    constant = gather[:, len(a) :] @ curvature.data
    gather = gather[:, : len(a)] @ sp.diags(twice)
    spread = sp.csc_matrix((np.ones(len(selected)), (selected, np.arange(len(selected)))), (len(place), len(selected)))
    shared = ca.reshape(ca.DM(spread) @ multipliers, N_ROWS, nodes)
    entries = functions.hessian.map(nodes)(z, known, ca.repmat(factor, 1, nodes), shared)
    hessian = ca.MX(pattern, ca.DM(gather.tocsc()) @ ca.vec(entries) + factor * ca.DM(constant))

    watch = _diverging(n, len(selected))
    options = {
        "grad_f": ca.Function("nlp_grad_f", [w, empty], [cost, gradient], ["x", "p"], ["f", "grad_f_x"]),
        "jac_g": ca.Function("nlp_jac_g", [w, empty], [rows, jacobian], ["x", "p"], ["g", "jac_g_x"]),
        "hess_lag": ca.Function(
            "nlp_hess_l",
            [w, empty, factor, multipliers],
            [hessian],
            ["x", "p", "lam_f", "lam_g"],
            ["triu_hess_gamma_x_x"],
        ),
        "print_time": False,
        "ipopt.sb": "yes",
        "ipopt.print_level": 0,
        "ipopt.max_iter": config.iterations,
        "ipopt.tol": config.tolerance,
        # what is left to gain then is 4 % of the cost of a passage, in as many iterations again
        "ipopt.acceptable_tol": 30 * config.tolerance,
        "ipopt.acceptable_iter": 2,
        "ipopt.mumps_pivot_order": 0,  # minimum degree: half of the time of METIS here
        "ipopt.constr_viol_tol": 1e-5,
        "ipopt.dual_inf_tol": 10.0,
        "ipopt.mu_strategy": "adaptive",
        "ipopt.nlp_scaling_method": "none",  # the rows are shares of their limits; 30 % fewer iterations than with it
        "ipopt.fixed_variable_treatment": "make_parameter",
        "iteration_callback": watch,
    }
    solver = ca.nlpsol("nearest", "ipopt", {"x": w, "f": cost, "g": rows}, options)
    solver.watch = watch  # the solver itself does not keep it alive
    return solver, (low[selected], high[selected])


def _diverging(n: int, constraints: int) -> Any:
    """Stops the solver where the multipliers of the constraints grow without bound: no solution is near. It would go on
    for minutes. Of nine problems with a solution, gallops among them, none had one above 2000."""
    import casadi as ca

    sizes = {"f": (1, 1), "x": (n, 1), "lam_x": (n, 1), "g": (constraints, 1), "lam_g": (constraints, 1)}

    class Diverging(ca.Callback):
        def __init__(self) -> None:
            ca.Callback.__init__(self)
            self.construct("diverging", {})

        def get_n_in(self) -> int:
            return int(ca.nlpsol_n_out())

        def get_n_out(self) -> int:
            return 1

        def get_sparsity_in(self, i: int) -> Any:
            return ca.Sparsity.dense(*sizes.get(ca.nlpsol_out(i), (0, 0)))

        def eval(self, answer: list[Any]) -> list[Any]:
            multipliers = answer[ca.nlpsol_out().index("lam_g")]
            return [int(np.abs(multipliers.full()).max(initial=0.0) > _DIVERGED)]

    return Diverging()


def _accumulation(place: NDArray[np.int_], n: int) -> Any:
    """Sparse matrix that adds values to the places (k,) of a vector (n,)."""
    import scipy.sparse as sp

    return sp.csc_matrix((np.ones(len(place)), (place, np.arange(len(place)))), (n, len(place)))


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
