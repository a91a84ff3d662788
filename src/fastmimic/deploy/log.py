"""The files of a deployment: its log, one row per period, and the true states of a simulated robot.

Its folder holds `log.npz`, `motion.npz`, and `deployment.json`, which is written last.
"""

import io
import json
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from fastmimic.base.errors import DeploymentError, MotionError, OutputError
from fastmimic.base.files import read_arrays, replace_file
from fastmimic.episode.run_log import RunLog
from fastmimic.motion.motion import Motion
from fastmimic.robot.state import COMMAND, OBSERVATION, READING
from fastmimic.runs.work_folder import created

LOG: Final = "log.npz"
RESULT: Final = "deployment.json"
FORMAT_VERSION: Final = 1  # of the log, and of the true states
_MARK: Final = "deployment_version"
_MOTION: Final = "motion_npz"

ROW: Final = np.dtype(
    [
        *((name, "f8") for name in ("time_s", "late_s", "read_s", "control_s", "write_s", "round_trip_s", "age_s")),
        ("sequence", "i8"),
        ("fresh", "?"),
        ("phase", "i1"),
        ("in_motion", "?"),
        ("sample", "i8"),
        ("origin", "f8", (3,)),
        ("haste", "f8"),
        ("reading", READING),
        ("estimate", OBSERVATION),
        ("command", COMMAND),
        ("sent", "?"),
        ("cut", "i4"),
        ("stance", "?", (4,)),
        ("force", "f8", (4, 3)),
        ("solve_s", "f8"),
        ("early_touchdowns", "i8"),
        ("qp_failures", "i8"),
    ]
)
"""One period: its start since the run's start, and its delay; durations of reading, control and writing, and from the
state's arrival to the command's departure; the state's age, sequence number and novelty; the `DeploymentPhase`, whether
in the motion itself, the reference's sample, origin and haste; state, estimate, command, whether sent, and how many
numbers were cut; stance legs, commanded ground reaction forces (heading frame, N), planning time and counts."""

GROUND_TRUTH: Final = np.dtype(
    [
        ("time", "f8"),
        ("tick", "i8"),
        ("observation", OBSERVATION),
        ("command", COMMAND),
        ("damped", "?"),
        ("service", "?"),
    ]
)
"""One measured state, whether or not it arrived: time since the start, s; tick (the driver's sequence number); true
state; command of the motors; whether they damped for lack of commands; whether the motion service was active."""


class Recorder:
    """Rows in preallocated memory; when it is full, the oldest are overwritten, but still counted in `periods`."""

    def __init__(self, capacity: int) -> None:
        self._rows = np.zeros(capacity, ROW)
        self._rows.view(np.uint8)[:] = 0  # touches the memory now
        self.periods = 0

    def next_row(self) -> Any:
        """The row of this period, to be filled in."""
        row = self._rows[self.periods % len(self._rows)]
        self.periods += 1
        return row

    def rows(self) -> NDArray[Any]:
        n = len(self._rows)
        if self.periods <= n:
            return self._rows[: self.periods]
        return np.roll(self._rows, -(self.periods % n))


@dataclass(frozen=True, eq=False)
class DeploymentLog:
    """A finished deployment. `meta` holds `rate_hz`, `robot`, `motion`, `driver`, `method`, `result` and more."""

    rows: NDArray[Any]  # (t,) of `ROW`
    motion: Motion
    meta: dict[str, Any]  # JSON-serialisable
    truth: NDArray[Any] | None = None  # (t,) of `OBSERVATION`, at the states used; of a simulated robot

    @property
    def rate_hz(self) -> float:
        return float(self.meta["rate_hz"])

    def run_log(self) -> RunLog:
        """The part in the motion itself, to identify from; raises `DeploymentError` if the robot did not reach it."""
        at = np.flatnonzero(self.rows["in_motion"])
        if len(at) < 2:
            raise DeploymentError("the robot did not reach the motion, so there is nothing to identify")
        step, after = self.rows[at[:-1]], self.rows[at[1:]]
        return RunLog(
            robot=str(self.meta["robot"]),
            motion=str(self.meta["motion"]),
            rate_hz=self.rate_hz,
            latency_s=float(self.meta["latency_s"]),
            reading=np.ascontiguousarray(after["reading"]),
            command=np.ascontiguousarray(step["command"]),
            estimate=np.ascontiguousarray(after["estimate"]),
            stance=np.ascontiguousarray(step["stance"]),
        )

    def save(self, path: str | Path) -> None:
        """Writes an `.npz` without pickles; raises `OutputError`."""
        with tempfile.TemporaryDirectory() as folder:
            motion = Path(folder) / "motion.npz"
            self.motion.save(motion)
            content = motion.read_bytes()
        arrays: dict[str, Any] = {
            _MARK: np.int64(FORMAT_VERSION),
            "meta_json": np.str_(json.dumps(self.meta, sort_keys=True)),
            _MOTION: np.frombuffer(content, np.uint8),
            **columns("", self.rows),
        }
        if self.truth is not None:
            arrays |= columns("truth_", self.truth)
        replace_file(path, lambda file: np.savez_compressed(file, **arrays))

    @classmethod
    def load(cls, path: str | Path) -> "DeploymentLog":
        """Reads what `save` wrote; raises `DeploymentError` for any other or a damaged file."""
        arrays = read_arrays(path, DeploymentError, ".npz")
        if _MARK not in arrays:
            raise DeploymentError(f"{path}: not the log of a deployment ('{_MARK}' is missing)")
        if int(arrays[_MARK]) != FORMAT_VERSION:
            raise DeploymentError(
                f"{path}: version {int(arrays[_MARK])} of the log; this release reads version {FORMAT_VERSION}"
            )
        try:
            truth = from_columns("truth_", OBSERVATION, arrays) if "truth_root_pos" in arrays else None
            motion = Motion.load(io.BytesIO(arrays[_MOTION].tobytes()))
            return cls(from_columns("", ROW, arrays), motion, json.loads(str(arrays["meta_json"])), truth)
        except (KeyError, ValueError, MotionError) as error:
            raise DeploymentError(f"{path}: the log is damaged ({error})") from None


def is_deployment_log(path: str | Path) -> bool:
    if Path(path).suffix != ".npz" or not Path(path).is_file():
        return False
    try:
        with np.load(path, allow_pickle=False) as file:
            return _MARK in file.files
    except Exception:  # noqa: BLE001 - the reader reports a damaged archive
        return False


def columns(prefix: str, rows: NDArray[Any]) -> dict[str, Any]:
    """A structured array's fields as plain arrays; nested fields join both names."""
    found: dict[str, Any] = {}
    for name in rows.dtype.names or ():
        column = rows[name]
        if column.dtype.names:
            found |= columns(f"{prefix}{name}_", column)
        else:
            found[f"{prefix}{name}"] = np.ascontiguousarray(column)
    return found


def from_columns(prefix: str, dtype: np.dtype[Any], arrays: Mapping[str, Any]) -> NDArray[Any]:
    """The inverse of `columns`; raises `KeyError` and `ValueError`."""
    parts = {
        name: from_columns(f"{prefix}{name}_", dtype[name], arrays) if dtype[name].names else arrays[f"{prefix}{name}"]
        for name in dtype.names or ()
    }
    rows = np.zeros(len(next(iter(parts.values()))), dtype)
    for name, part in parts.items():
        rows[name] = part
    return rows


def load_ground_truth(path: str | Path) -> NDArray[Any]:
    """(t,) of `GROUND_TRUTH` as `GroundTruthLog.save` wrote it; raises `OutputError` for another file."""
    try:
        with np.load(path, allow_pickle=False) as file:
            if int(file["format_version"]) != FORMAT_VERSION:
                raise OutputError(f"{path}: version {int(file['format_version'])}, expected {FORMAT_VERSION}")
            observation = {f"observation_{name}": file[name] for name in OBSERVATION.names or ()}
            return from_columns("", GROUND_TRUTH, dict(file) | observation)
    except (OSError, ValueError, KeyError) as error:
        raise OutputError(f"{path}: not a log of 'fastmimic robot-sim' ({type(error).__name__})") from None


class GroundTruthLog:
    """Collects rows of `GROUND_TRUTH`. The file is an `.npz` without pickles: `format_version`; `time`, `tick`,
    `damped`, `service` (t,); the fields of `OBSERVATION` under their names, such as `root_pos` (t, 3); those of
    `COMMAND` prefixed by `command_`."""

    def __init__(self) -> None:
        self._rows: list[NDArray[Any]] = []

    def add(
        self, time: float, tick: int, observation: NDArray[Any], command: NDArray[Any], damped: bool, service: bool
    ) -> None:
        """Adds a measurement; the arrays are (1,) and copied."""
        self._rows.append(np.array([(time, tick, observation[0], command[0], damped, service)], GROUND_TRUTH))

    def rows(self) -> NDArray[Any]:
        """(t,) of `GROUND_TRUTH`."""
        return np.concatenate([np.zeros(0, GROUND_TRUTH), *self._rows])

    def save(self, path: str | Path) -> None:
        """Writes the file; raises `OutputError`."""
        arrays = {name.removeprefix("observation_"): column for name, column in columns("", self.rows()).items()}
        replace_file(path, lambda file: np.savez(file, format_version=FORMAT_VERSION, **arrays))


@contextmanager
def open_deployment(folder: Path) -> Iterator[None]:
    """Prepares a folder, which may hold an earlier deployment; unchanged if the block fails. Raises `OutputError`."""
    if folder.is_dir() and any(folder.iterdir()) and not (folder / RESULT).is_file():
        raise OutputError(f"{folder} holds something else than a deployment; choose another --out")
    with created(folder):
        yield
