"""Checkpoints of an optimisation, without pickles.

CMA-ES is deterministic given its seed and the scores, so the history is its state: resuming replays the history without
running an episode and checks that the replayed candidates equal the recorded ones, bit for bit.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from fastmimic.base.arrays import Array
from fastmimic.base.errors import CheckpointError
from fastmimic.base.files import UNREADABLE, open_arrays, replace_file

FILE_NAME: Final = "checkpoint.npz"
_VERSION: Final = 1


@dataclass(frozen=True, eq=False)
class Checkpoint:
    """The course of an optimisation so far: `candidates` (i, p, k), scaled to [0, 1] within their bounds, with their
    `scores` (i, p), greater is better. `identity` is a digest of the problem and the optimiser's settings."""

    identity: str
    candidates: Array
    scores: Array
    elapsed_s: float

    def save(self, path: str | Path) -> None:
        """Writes the checkpoint and replaces an earlier one; raises `OutputError` if it cannot."""
        about: dict[str, Any] = {"version": np.int64(_VERSION), "identity": np.str_(self.identity)}
        about |= {"candidates": self.candidates, "scores": self.scores, "elapsed_s": np.float64(self.elapsed_s)}
        replace_file(path, lambda file: np.savez(file, **about))

    @classmethod
    def load(cls, path: str | Path, identity: str | None = None) -> "Checkpoint":
        """Reads a checkpoint; raises `CheckpointError` if it is missing, damaged, or not of the problem `identity`."""
        try:
            with open_arrays(path) as file:
                version = int(file["version"])
                found = cls(str(file["identity"]), file["candidates"], file["scores"], float(file["elapsed_s"]))
        except FileNotFoundError:
            raise CheckpointError(f"{path}: no checkpoint to resume from; leave out --resume to start anew") from None
        except UNREADABLE as error:
            raise CheckpointError(f"{path}: damaged checkpoint ({error}); leave out --resume to start anew") from None
        if version != _VERSION:
            raise CheckpointError(f"{path}: checkpoint version {version}; this release reads version {_VERSION}")
        if identity not in (None, found.identity):
            raise CheckpointError(
                f"{path}: this checkpoint is of another problem (motion, robot, configuration, duration,"
                " randomisation, seed or population differ); resume with the same arguments or choose another output"
                " folder"
            )
        if found.candidates.ndim != 3 or found.scores.shape != found.candidates.shape[:2]:
            raise CheckpointError(f"{path}: damaged checkpoint (shapes {found.candidates.shape}, {found.scores.shape})")
        return found
