"""The QP solver that kernels call, against DAQP's own Python function."""

from collections.abc import Callable
from typing import Any

import daqp
import numpy as np
import pytest
from numba import config as numba_config

from fastmimic.control.native import (
    INFINITY,
    OPTIMAL,
    _solve_object,
    make_workspace,
    solve_qp,
)

N_MAX, M_MAX = 12, 20

SOLVERS = {"chosen": solve_qp, "plain Python": getattr(_solve_object, "py_func", _solve_object)}
if not numba_config.DISABLE_JIT:
    SOLVERS["object mode"] = _solve_object


# the fallback cannot release the GIL, and Numba says so
pytestmark = pytest.mark.filterwarnings("ignore:Code running in object mode")


@pytest.fixture(params=list(SOLVERS))
def solver(request: pytest.FixtureRequest) -> Callable[..., int]:
    """What kernels call here, and what they fall back to where DAQP's library is built differently."""
    return SOLVERS[request.param]


class Problem:
    """min ½xᵀHx + fᵀx subject to lower ≤ (x[:ms], A x) ≤ upper."""

    def __init__(self, hessian: Any, gradient: Any, rows: Any, lower: Any, upper: Any) -> None:
        self.hessian, self.gradient = np.array(hessian, float), np.array(gradient, float)
        self.lower, self.upper = np.array(lower, float), np.array(upper, float)
        self.n, self.m = len(self.gradient), len(self.upper)
        self.rows = np.array(rows, float).reshape(-1, self.n)
        self.ms = self.m - len(self.rows)

    @classmethod
    def random(cls, rng: np.random.Generator) -> "Problem":
        n = int(rng.integers(2, N_MAX + 1))
        ms = int(rng.integers(0, n + 1))
        k = int(rng.integers(1, M_MAX - ms + 1))
        root = rng.normal(size=(n, n))
        inside = rng.normal(size=n)  # a point that satisfies every constraint
        rows = rng.normal(size=(k, n))
        value = np.concatenate([inside[:ms], rows @ inside])
        lower = np.where(rng.random(ms + k) < 0.5, -INFINITY, value - rng.uniform(0, 1, ms + k))
        return cls(
            root @ root.T + 0.1 * np.eye(n),
            rng.normal(size=n) * 5,
            rows,
            lower,
            value + rng.uniform(0, 1, ms + k),
        )

    def solve(self, solver: Callable[..., int], workspace: Any) -> tuple[int, np.ndarray, np.ndarray]:
        w = workspace[0]
        w["hessian"][: self.n**2] = self.hessian.ravel()
        w["gradient"][: self.n] = self.gradient
        w["rows"][: self.rows.size] = self.rows.ravel()
        w["lower"][: self.m], w["upper"][: self.m] = self.lower, self.upper
        flag = solver(workspace[0], self.n, self.m, self.ms)
        return flag, w["x"][: self.n].copy(), w["dual"][: self.m].copy()

    def reference(self) -> np.ndarray:
        x, _, flag, _ = daqp.solve(
            self.hessian, self.gradient, self.rows, self.upper, self.lower, np.zeros(self.m, np.intc)
        )
        assert flag == OPTIMAL
        return x


@pytest.mark.slow
@pytest.mark.nojit
@pytest.mark.parametrize(
    ("problem", "expected"),
    [
        pytest.param(
            Problem(np.eye(2), [-3, -1], [[1, 1]], [-INFINITY] * 2, [1, 1.5]),
            [1.0, 0.5],
            id="one bound and one row are active",
        ),
        pytest.param(
            Problem([[2, 0], [0, 4]], [-2, 4], [[1, 0]], [-INFINITY], [INFINITY]),
            [1.0, -1.0],
            id="nothing is active: −H⁻¹f",
        ),
        pytest.param(
            Problem(np.eye(3), [0, 0, 0], [[1, 1, 1]], [-1, 3], [1, 4]),
            [1.0, 1.0, 1.0],
            id="the lower side of a row is active",
        ),
    ],
)
def test_known_problems(solver: Callable[..., int], problem: Problem, expected: list[float]) -> None:
    flag, x, _ = problem.solve(solver, make_workspace(N_MAX, M_MAX))
    assert flag == OPTIMAL
    np.testing.assert_allclose(x, expected, atol=1e-9)


@pytest.mark.nojit
def test_random_problems_of_all_sizes_in_one_workspace_agree_with_daqps_own_function(
    solver: Callable[..., int],
) -> None:
    """Nothing of an earlier, larger problem may be left in a later one."""
    rng = np.random.default_rng(0)
    workspace = make_workspace(N_MAX, M_MAX)
    for _ in range(60):
        problem = Problem.random(rng)
        flag, x, dual = problem.solve(solver, workspace)
        assert flag == OPTIMAL
        np.testing.assert_allclose(x, problem.reference(), rtol=0, atol=1e-10)
        # the multipliers satisfy stationarity: H x + f + Aᵀ λ = 0
        rows = np.vstack([np.eye(problem.n)[: problem.ms], problem.rows])
        residual = problem.hessian @ x + problem.gradient + rows.T @ dual
        np.testing.assert_allclose(residual, 0, atol=1e-6)


INFEASIBLE = Problem(np.eye(2), [1, 1], [[1, 1], [1, 1]], [2, -INFINITY], [INFINITY, 1])


@pytest.mark.nojit
@pytest.mark.parametrize(
    "problem",
    [
        pytest.param(INFEASIBLE, id="x + y ≥ 2 and ≤ 1"),
        pytest.param(Problem(np.eye(2), [1, 1], [[1, 0]], [3], [2]), id="an upper bound below the lower"),
        pytest.param(Problem(-np.eye(2), [1, 1], [[1, 0]], [-1], [1]), id="not convex"),
    ],
)
def test_what_has_no_solution_is_not_optimal(solver: Callable[..., int], problem: Problem) -> None:
    flag, _, _ = problem.solve(solver, make_workspace(N_MAX, M_MAX))
    assert flag != OPTIMAL


def test_a_failure_leaves_no_trace_in_the_next_problem(solver: Callable[..., int]) -> None:
    workspace = make_workspace(N_MAX, M_MAX)
    problem = Problem.random(np.random.default_rng(3))
    _, before, _ = problem.solve(solver, workspace)
    INFEASIBLE.solve(solver, workspace)
    flag, after, _ = problem.solve(solver, workspace)
    assert flag == OPTIMAL
    np.testing.assert_array_equal(after, before)


def test_kernels_reach_the_c_function_of_the_installed_daqp() -> None:
    """The fallback is slower by an order of magnitude: with the wheel that is installed here it must not be in use."""
    if numba_config.DISABLE_JIT:
        pytest.skip("without the JIT the Python function is called")
    assert solve_qp is not _solve_object


def test_workspaces_point_to_their_own_memory() -> None:
    first, second = make_workspace(N_MAX, M_MAX), make_workspace(N_MAX, M_MAX)
    problem = Problem.random(np.random.default_rng(4))
    _, x, _ = problem.solve(solve_qp, first)
    assert np.any(x != 0)
    np.testing.assert_array_equal(second[0]["x"], 0)
