"""Solutions that were found before, and what came of running them: a motion is made executable once.

Those of the built-in motions come with the package (`benchmarks/keep_solutions.py` makes the file); others are kept in
the user's cache folder.
"""

from functools import cache
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from fastmimic.base.arrays import Array, fingerprint
from fastmimic.base.errors import FastMimicError
from fastmimic.base.files import read_arrays, replace_file, user_cache

MOST_BYTES: Final = 500_000_000
"""Of what is kept, the oldest goes: a solution has about 20 kB, a robot's functions and ten seconds of motion 1 MB."""
PACKAGED = Path(__file__).with_name("solutions.npz")
_NEAR: Final = 1e-6
"""Most that a problem's probe differs from the package's: another machine's numbers differ in the last digits."""
_CHUNKS: Final = 64


class Remembered:
    """What is known of one question: a problem of optimal control, or what came of running a motion.

    `said` and `arrays` are all that the answer depends on but for the code: that of this folder, and of the solver; for
    an outcome that of the whole package, and of the simulator.
    """

    def __init__(self, said: str, arrays: list[NDArray[Any]], *, outcome: bool = False) -> None:
        given = [np.ascontiguousarray(array) for array in arrays]
        shapes = repr([array.shape for array in given])
        self._key = fingerprint(_package() if outcome else _solver(), said.encode(), *given)
        self._general = fingerprint(_folder_code(), said.encode(), shapes.encode())
        self._probe = _probe(given)

    def read(self) -> dict[str, Array] | None:
        """The answer; None if there is none yet, or its file is damaged."""
        path = _folder() / f"{self._key}.npz"
        try:
            if path.is_file():
                return read_arrays(path, FastMimicError, "a solution")
        except FastMimicError:
            pass
        for answer in _packaged(self._general):
            if np.abs(answer["probe"] - self._probe).max() < _NEAR:
                return answer
        return None

    def keep(self, answer: dict[str, Array], *, packaged: bool = True) -> None:
        """Keeps the answer, and with `packaged` records it for the package; nothing happens where the user's cache
        folder cannot be written."""
        if recorded is not None and packaged:
            recorded.append((self._general, answer | {"probe": self._probe}))
        folder = _folder()
        try:
            folder.mkdir(parents=True, exist_ok=True)
            replace_file(folder / f"{self._key}.npz", lambda stream: np.savez_compressed(stream, **answer))  # type: ignore[arg-type]
            files = sorted(folder.glob("*.npz"), key=lambda path: path.stat().st_mtime, reverse=True)
            room = np.cumsum([path.stat().st_size for path in files])
            for path in files[int(np.searchsorted(room, MOST_BYTES, "right")) :]:
                path.unlink(missing_ok=True)
        except OSError:
            pass


def _probe(arrays: list[NDArray[Any]]) -> Array:
    """(64,) weighted sums over all numbers, by which two problems are told apart."""
    numbers = np.concatenate([np.clip(array.astype(float).ravel(), -1e3, 1e3) for array in arrays])
    weighed = np.concatenate([numbers, np.zeros(_CHUNKS)]) * np.sin(1.0 + np.arange(len(numbers) + _CHUNKS))
    starts = np.linspace(0, len(weighed), _CHUNKS, endpoint=False).astype(int)
    return np.asarray(np.add.reduceat(weighed, starts))


recorded: list[tuple[str, dict[str, Array]]] | None = None
"""Where a process records what it keeps, for the package."""


@cache
def _packaged(general: str) -> list[dict[str, Array]]:
    """The package's answers to questions of a general key; no others are unpacked."""
    if not PACKAGED.is_file():
        return []
    answers: dict[str, dict[str, Array]] = {}
    with np.load(PACKAGED, allow_pickle=False) as file:
        for name in file:
            key, number, part = name.split(" ")
            if key == general:
                answers.setdefault(number, {})[part] = file[name]
    return list(answers.values())


def _folder() -> Path:
    return user_cache() / "executable"


@cache
def _folder_code() -> bytes:
    return b"".join(path.read_bytes() for path in sorted(Path(__file__).parent.glob("*.py")))


@cache
def _solver() -> bytes:
    from importlib.metadata import version

    return version("casadi").encode() + _folder_code()


@cache
def _package() -> bytes:
    from importlib.metadata import version

    files = sorted(Path(__file__).parents[1].glob("**/*.py"))
    return version("mujoco").encode() + b"".join(path.read_bytes() for path in files)
