"""The one way in which kernels are compiled: cached, without the GIL, IEEE arithmetic."""

from collections.abc import Callable
from typing import Any

import numpy as np
from numba import njit


def kernel(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compiles `function` with Numba: no GIL, cached on disk, no fast-math (results must not depend on the machine).

    With `NUMBA_DISABLE_JIT=1` the same Python code runs as it stands, for debugging.
    """
    return njit(cache=True, nogil=True, error_model="numpy")(function)


def inlined(function: Callable[..., Any]) -> Callable[..., Any]:
    """Like `kernel`, for small functions that LLVM should inline into their callers."""
    return njit(cache=True, nogil=True, error_model="numpy", forceinline=True)(function)


def record_dtype(fields: list[tuple[Any, ...]]) -> np.dtype[Any]:
    """A structured type for kernels: aligned, its fields attributes (`np.record`) also where the JIT is off."""
    return np.dtype((np.record, np.dtype(fields, align=True)))
