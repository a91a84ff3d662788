"""C functions, callable from compiled code: DAQP's solver (Arnström, Bemporad, Axehill 2022) and the monotonic clock.

    min ½ xᵀHx + fᵀx   subject to   lower ≤ (x[:ms], A x) ≤ upper

The wheel's extension module exports the C interface. LLVM knows its symbols as an external function, so that kernels
which call it can be cached. Solving a known problem checks the structs' layout once; if that fails (another build of
DAQP), the slower Python function is called instead, with the same results.
"""

import ctypes
import functools
import sys
import time
from typing import Any, Final

import daqp
import numpy as np
from llvmlite import binding
from numba import config as numba_config
from numba import objmode, types
from numpy.typing import NDArray

from fastmimic.base.arrays import Array, Records
from fastmimic.base.jit import depends_on, floats, kernel, object_kernel, record_dtype

OPTIMAL: Final = 1
INFINITY: Final = 1e30
_SETTINGS_BYTES: Final = 1024  # more than the struct needs in any release


def make_workspace(n_max: int, m_max: int) -> Records:
    """Memory of a problem of up to n_max variables and m_max constraints, simple bounds included. One per thread. The
    record holds `hessian` (n × n, row-major in its first n² entries), `gradient` f, `rows` of A, `upper` and `lower`
    (simple bounds first), the solution `x`, its multipliers `dual`, and DAQP's structs, which point to them."""
    given = floats(hessian=n_max * n_max, gradient=n_max, rows=m_max * n_max, upper=m_max, lower=m_max)
    structs = [("problem", "i4", (20,)), ("result", "i4", (32,)), ("settings", "u1", (_SETTINGS_BYTES,))]
    found = floats(x=n_max, dual=m_max)
    workspace = np.zeros(1, record_dtype([*given, *found, *structs, ("sense", "i4", (m_max,))]))

    def address(name: str) -> int:
        return int(workspace[name].ctypes.data)

    # struct DAQPProblem {int n, m, ms; double *H, *f, *A, *bupper, *blower; int *sense, *break_points; int nh, type;}
    fields = ("hessian", "gradient", "rows", "upper", "lower", "sense")
    workspace["problem"][0].view(np.int64)[2:8] = [address(name) for name in fields]
    # struct DAQPResult {double *x, *lam, fval, soft_slack; int exitflag, iter, nodes; double solve_time, setup_time;}
    workspace["result"][0].view(np.int64)[:2] = [address("x"), address("dual")]
    library = _library()
    if library is not None:
        library.daqp_default_settings(ctypes.c_void_p(address("settings")))
    return workspace


@functools.cache
def _library() -> Any:
    """The extension module as a C library with its symbols known to LLVM; None if it does not export them."""
    try:
        library = ctypes.CDLL(daqp.__file__)
        _ = library.daqp_quadprog, library.daqp_default_settings
        binding.load_library_permanently(daqp.__file__)
    except (OSError, AttributeError, RuntimeError):
        return None
    return library


_quadprog = types.ExternalFunction("daqp_quadprog", types.void(types.voidptr, types.voidptr, types.voidptr))


def _solve_python(
    n: int, m: int, ms: int, hessian: Array, gradient: Array, rows: Array, upper: Array, lower: Array
) -> tuple[int, Array, Array]:
    square, table = hessian[: n * n].reshape(n, n), rows[: (m - ms) * n].reshape(m - ms, n)
    given = (part.copy() for part in (square, gradient[:n], table, upper[:m], lower[:m]))
    solution, _, flag, info = daqp.solve(*given, np.zeros(m, np.intc))
    return int(flag), solution, info["lam"]


@kernel
def _solve_native(w: Any, n: int, m: int, ms: int) -> int:
    w.problem[0], w.problem[1], w.problem[2] = n, m, ms
    w.sense[:m] = 0
    _quadprog(w.result.ctypes, w.problem.ctypes, w.settings.ctypes)
    return w.result[8]


@object_kernel
def _solve_object(w: Any, n: int, m: int, ms: int) -> int:
    # arrays of a record arrive in Python as copies: results have to be handed back; it also runs without the JIT
    with objmode(flag="int64", x="float64[::1]", dual="float64[::1]"):
        flag, x, dual = _solve_python(n, m, ms, w.hessian, w.gradient, w.rows, w.upper, w.lower)
    w.x[:n], w.dual[:m] = x, dual
    return flag


def _native_works() -> bool:
    """Solves min ½|x|² − (3, 1)·x subject to x₀ ≤ 1 and x₀ + x₁ ≤ 1.5; the solution is (1, 0.5)."""
    workspace = make_workspace(2, 2)
    w = workspace[0]
    w["hessian"][:4] = (1, 0, 0, 1)
    w["gradient"][:2] = (-3, -1)
    w["rows"][:2] = (1, 1)
    w["upper"][:2], w["lower"][:2] = (1.0, 1.5), -INFINITY
    flag = _solve_native(workspace[0], 2, 2, 1)
    return flag == OPTIMAL and bool(np.allclose(w["x"], (1.0, 0.5), atol=1e-9))


def _choose_solver() -> Any:
    library = None if numba_config.DISABLE_JIT else _library()  # type: ignore[attr-defined]
    if library is None:
        return _solve_object
    depends_on(_solve_native, library._name)  # kernels in the cache were made for this build's structs
    return _solve_native if _native_works() else _solve_object


solve_qp = _choose_solver()
"""solve_qp(workspace, n, m, ms) → exit flag, `OPTIMAL` if solved; the solution is in `workspace.x[:n]`."""


_MONOTONIC: Final = 6 if sys.platform == "darwin" else 1  # CLOCK_MONOTONIC

_clock_gettime: Any = types.ExternalFunction("clock_gettime", types.int32(types.int32, types.voidptr))


@kernel
def _now_native(timespec: NDArray[np.int64]) -> float:
    _clock_gettime(_MONOTONIC, timespec.ctypes)
    return timespec[0] + 1e-9 * timespec[1]


@object_kernel
def _now_object(timespec: NDArray[np.int64]) -> float:
    with objmode(now="float64"):
        now = time.perf_counter()
    return now


def _choose_clock() -> Any:
    if numba_config.DISABLE_JIT:  # type: ignore[attr-defined]
        return _now_object
    try:
        _ = ctypes.CDLL(None).clock_gettime
    except (OSError, AttributeError, TypeError):
        return _now_object
    return _now_native


seconds_now = _choose_clock()
"""seconds_now(timespec) → s since some moment; `timespec` is (2,) int64 scratch. For timing, never for behaviour."""
