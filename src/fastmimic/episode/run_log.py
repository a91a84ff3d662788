"""The log of a run: only what a robot's computer knows of it."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from fastmimic.base.errors import LogError
from fastmimic.base.files import from_json, read_arrays, replace_file
from fastmimic.robot.state import COMMAND, OBSERVATION, READING

FORMAT: Final = "fastmimic run log"
VERSION: Final = 1

_RECORDS: Final = {"reading": READING, "command": COMMAND, "estimate": OBSERVATION}
_ABOUT: Final = {"robot": str, "motion": str, "rate_hz": float, "latency_s": float}
_NOT_KNOWN: Final = ("other_contact",)  # fields of an observation that no sensor gives


@dataclass(frozen=True, eq=False)
class RunLog:
    """One run over t control steps, as the robot's computer saw it. There is no field for the truth."""

    robot: str
    motion: str
    rate_hz: float  # control steps a second
    latency_s: float  # age of the readings of IMU and joints on arrival
    reading: NDArray[Any]  # (t,) of `READING`, the latest at the end of each step
    command: NDArray[Any]  # (t,) of `COMMAND`, the motors' commands for the step
    estimate: NDArray[Any]  # (t,) of `OBSERVATION`, the estimator's result
    stance: NDArray[np.bool_]  # (t, 4) legs that the gait planner let stand in the step

    @property
    def duration_s(self) -> float:
        """Length, s."""
        return len(self.reading) / self.rate_hz

    def save(self, path: str | Path) -> None:
        """Writes an `.npz` without pickles: `about` (JSON), `stance`, and `reading_…`, `command_…`, `estimate_…` by
        field, each with a row per control step. Raises `OutputError` if it cannot be written."""
        about = {"format": FORMAT, "version": VERSION, **{name: getattr(self, name) for name in _ABOUT}}
        arrays: dict[str, Any] = {"about": np.array(json.dumps(about)), "stance": self.stance}
        for name, dtype in _RECORDS.items():
            record = getattr(self, name)
            for field in _fields(dtype):
                arrays[f"{name}_{field}"] = record[field].astype(np.float32)
        replace_file(path, lambda file: np.savez_compressed(file, **arrays))

    @classmethod
    def load(cls, path: str | Path) -> "RunLog":
        """Inverse of `save`; raises `LogError` for no such file or log, damage, or missing or infinite rows."""
        path = Path(path)
        if not path.is_file():
            raise LogError(f"{path}: no such file; 'fastmimic evaluate MOTION --observe sensors --log FILE' writes one")
        found = read_arrays(path, LogError, "log of a run, perhaps cut off while it was copied")
        try:
            about = from_json(str(found["about"]))
            right = about["format"] == FORMAT and about["version"] == VERSION
        except (KeyError, ValueError, TypeError):
            right = False
        if not right:
            raise LogError(f"{path}: not the log of a run (version {VERSION}); 'fastmimic evaluate … --log' writes one")
        return cls._of(path, about, found)

    @classmethod
    def _of(cls, path: Path, about: dict[str, Any], found: dict[str, NDArray[Any]]) -> "RunLog":
        stood = found.get("stance")
        if stood is None or stood.ndim != 2 or stood.shape[1] != 4:
            raise LogError(f"{path}: 'stance' is missing or does not have a column for each leg")
        steps = len(stood)
        records: dict[str, Any] = {}
        for name, dtype in _RECORDS.items():
            record = np.zeros(steps, dtype)
            for field in _fields(dtype):
                value = found.get(f"{name}_{field}")
                shape = (steps, *dtype[field].shape)
                if value is None or value.shape != shape or value.dtype.kind not in "biuf":
                    was = "is missing" if value is None else f"is {value.dtype}{value.shape}"
                    raise LogError(f"{path}: '{name}_{field}' {was}; expected {shape}, a row for each control step")
                if not np.isfinite(value).all():
                    row = int(np.argwhere(~np.isfinite(value))[0, 0])
                    raise LogError(f"{path}: '{name}_{field}' is not finite in row {row}; cut the log off before it")
                record[field] = value
            records[name] = record
        try:
            known = {name: kind(about[name]) for name, kind in _ABOUT.items()}
        except (KeyError, ValueError, TypeError) as error:
            raise LogError(f"{path}: its description lacks a name or a number ({error})") from None
        log = cls(**known, **records, stance=stood.astype(bool))
        if not (log.rate_hz > 0 and log.latency_s >= 0):
            raise LogError(
                f"{path}: rate_hz must be positive and latency_s not negative, found {log.rate_hz:g} and"
                f" {log.latency_s:g}"
            )
        return log


def _fields(dtype: np.dtype[Any]) -> list[str]:
    return [name for name in dtype.names or () if name not in _NOT_KNOWN]
