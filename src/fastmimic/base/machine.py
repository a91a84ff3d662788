"""The machine and the installed packages."""

import os
import platform
from functools import cache
from importlib import import_module, metadata
from typing import Any

from fastmimic.base.errors import FastMimicError


def available_cores() -> int:
    """Processor cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def versions() -> dict[str, str]:
    """Versions of this package and of those that its results depend on."""
    names = ("fastmimic", "mujoco", "daqp", "cma", "numba", "numpy")
    return {"python": platform.python_version(), **{name: _version(name) for name in names}}


_version = cache(metadata.version)


def optional(module: str, otherwise: FastMimicError) -> Any:
    """A module that need not be installed; raises `otherwise` if it is not."""
    try:
        return import_module(module)
    except ImportError:
        raise otherwise from None
