"""Solutions that were found before, and what came of running them: a motion is made executable once."""

from functools import cache
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from fastmimic.base.arrays import Array, fingerprint
from fastmimic.base.errors import FastMimicError
from fastmimic.base.files import read_arrays, replace_file

MOST: Final = 1000
"""Files that are kept, a solution's of about 50 kB; the oldest go."""


def problem_key(*parts: bytes | NDArray[Any]) -> str:
    """Of everything that the solution depends on, this code and the solver's version included."""
    return fingerprint(_code(), *parts)


def outcome_key(*parts: bytes | NDArray[Any]) -> str:
    """Of everything that a simulation depends on, all code of this package and the simulator's version included."""
    return fingerprint(_package(), *parts)


def remembered(key: str) -> dict[str, Array] | None:
    """The arrays kept under a key; None if there are none, or if their file is damaged."""
    path = _folder() / f"{key}.npz"
    try:
        return read_arrays(path, FastMimicError, "a solution") if path.is_file() else None
    except FastMimicError:
        return None


def keep(key: str, arrays: dict[str, Array]) -> None:
    """Keeps arrays under a key; nothing happens where the user's cache folder cannot be written."""
    folder = _folder()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        replace_file(folder / f"{key}.npz", lambda stream: np.savez(stream, **arrays))  # type: ignore[arg-type]
        for path in sorted(folder.glob("*.npz"), key=lambda path: path.stat().st_mtime)[:-MOST]:
            path.unlink(missing_ok=True)
    except OSError:
        pass


def _folder() -> Path:
    import pooch

    return Path(pooch.os_cache("fastmimic")) / "executable"


@cache
def _code() -> bytes:
    import casadi

    files = sorted(Path(__file__).parent.glob("*.py"))
    return casadi.__version__.encode() + b"".join(path.read_bytes() for path in files)


@cache
def _package() -> bytes:
    import mujoco

    files = sorted(Path(__file__).parents[1].glob("**/*.py"))
    return mujoco.__version__.encode() + b"".join(path.read_bytes() for path in files)
