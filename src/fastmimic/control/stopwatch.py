"""The monotonic clock, callable from compiled code. For timing only, never for behaviour."""

import ctypes
import sys
import time
from typing import Any, Final

import numpy as np
from numba import config as numba_config
from numba import objmode, types
from numpy.typing import NDArray

from fastmimic.base.jit import kernel

_MONOTONIC: Final = 6 if sys.platform == "darwin" else 1  # CLOCK_MONOTONIC

_clock_gettime: Any = types.ExternalFunction("clock_gettime", types.int32(types.int32, types.voidptr))


@kernel
def _now_native(timespec: NDArray[np.int64]) -> float:
    _clock_gettime(_MONOTONIC, timespec.ctypes)
    return timespec[0] + 1e-9 * timespec[1]


@kernel
def _now_object(timespec: NDArray[np.int64]) -> float:
    with objmode(now="float64"):
        now = time.perf_counter()
    return now


def _now_plain(timespec: NDArray[np.int64]) -> float:
    return time.perf_counter()


def _choose() -> Any:
    if numba_config.DISABLE_JIT:  # type: ignore[attr-defined]
        return _now_plain
    try:
        _ = ctypes.CDLL(None).clock_gettime
    except (OSError, AttributeError, TypeError):
        return _now_object
    return _now_native


seconds_now = _choose()
"""seconds_now(timespec) → s since some moment; `timespec` is (2,) int64 scratch, sec and ns on 64-bit systems."""
