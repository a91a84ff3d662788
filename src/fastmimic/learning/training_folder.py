"""The folder of a training: its files, and the rules to replace or resume it."""

import io
import json
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from fastmimic.base.errors import CheckpointError
from fastmimic.base.files import check_folder, replace_file
from fastmimic.learning.policy import POLICY_FILE
from fastmimic.runs.work_folder import CONFIG, WorkFolder

CHECKPOINT: Final = "checkpoint.pt"
ONNX: Final = "policy.onnx"
EVALUATIONS: Final = "evaluations.csv"
EVENTS: Final = "tensorboard"
_VERSION: Final = 1
_FILES: Final = (CHECKPOINT, ONNX, EVALUATIONS, POLICY_FILE, f"{EVENTS}/events.out.tfevents.*")


@dataclass(frozen=True)
class TrainingFolder(WorkFolder):
    """The files of a training."""

    @classmethod
    def at(cls, path: Path) -> "TrainingFolder":
        return cls(path, "a training", CONFIG, "training", _FILES)

    @property
    def begun(self) -> bool:
        """Whether there is a checkpoint."""
        return (self.path / CHECKPOINT).is_file()

    def begin(self, record: Mapping[str, Any]) -> None:
        """Writes `config.json`; raises `OutputError`."""
        self.write(CONFIG, json.dumps(record, indent=1, sort_keys=True) + "\n")

    def save(self, state: Mapping[str, Any]) -> None:
        """Writes the checkpoint and replaces an earlier one."""
        import torch

        out = io.BytesIO()
        torch.save({"version": _VERSION, **state}, out)
        replace_file(self.path / CHECKPOINT, lambda file: file.write(out.getbuffer()))

    def load(self) -> dict[str, Any]:
        """Reads the checkpoint, without executing code in it; raises `CheckpointError` if it is missing or damaged."""
        import torch

        path = self.path / CHECKPOINT
        try:
            state = torch.load(path, map_location="cpu", weights_only=True)
        except FileNotFoundError:
            raise CheckpointError(f"{path}: no checkpoint to resume from; leave out --resume to start anew") from None
        except Exception as error:  # noqa: BLE001  whatever a damaged archive makes PyTorch raise
            reason = str(error).splitlines()[0] if str(error) else type(error).__name__
            raise CheckpointError(f"{path}: damaged checkpoint ({reason}); --overwrite starts anew") from None
        if not isinstance(state, dict) or state.get("version") != _VERSION:
            raise CheckpointError(f"{path}: not a checkpoint of this release; --overwrite starts anew")
        return state


def open_training(path: Path, same: Mapping[str, Any], *, resume: bool, overwrite: bool) -> TrainingFolder:
    """Checks a folder before a training begins; writes nothing into it.

    Args:
        same: settings that must equal `training` in the folder's `config.json` to resume.

    Raises `ConfigError` for both `resume` and `overwrite`, `OutputError` if the folder holds other files or cannot be
    written.
    """
    folder = TrainingFolder.at(path)
    folder.check(same, resume=resume, overwrite=overwrite, begun=folder.begun)
    check_folder(path)
    return folder


class Stopwatch:
    """Wall and processor time of this process, added to earlier times."""

    def __init__(self, wall_s: float = 0.0, cpu_s: float = 0.0) -> None:
        self._wall_s, self._cpu_s = wall_s - time.perf_counter(), cpu_s - time.process_time()

    @property
    def wall_s(self) -> float:
        return self._wall_s + time.perf_counter()

    @property
    def cpu_s(self) -> float:
        return self._cpu_s + time.process_time()
