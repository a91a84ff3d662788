"""The log of a deployment, one row per period in preallocated memory, and its file."""

import io
import json
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from fastmimic.base.errors import DeploymentError, MotionError
from fastmimic.base.files import read_arrays, replace_file
from fastmimic.episode.run_log import RunLog
from fastmimic.estimation.reading import READING
from fastmimic.motion.motion import Motion
from fastmimic.robot.state import COMMAND, OBSERVATION

FORMAT_VERSION: Final = 1
_MARK: Final = "deployment_version"
_MOTION: Final = "motion_npz"

ROW: Final = np.dtype(
    [
        ("time_s", "f8"),
        ("late_s", "f8"),
        ("read_s", "f8"),
        ("control_s", "f8"),
        ("write_s", "f8"),
        ("round_trip_s", "f8"),
        ("age_s", "f8"),
        ("sequence", "i8"),
        ("fresh", "?"),
        ("phase", "i1"),
        ("in_motion", "?"),
        ("sample", "i8"),
        ("origin", "f8", (3,)),
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
in the motion itself, the reference's sample and origin; state, estimate, command, whether sent, and how many numbers
were cut; stance legs, commanded ground reaction forces (heading frame, N), planning time and counts."""

LOST_ROWS: Final = "the first {:.0f} s are not in the log, which holds the last {:.0f} s"


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
        """The rows kept, in order."""
        n = len(self._rows)
        if self.periods <= n:
            return self._rows[: self.periods]
        return np.roll(self._rows, -(self.periods % n))


@dataclass(frozen=True, eq=False)
class DeploymentLog:
    """A finished deployment.

    Attributes:
        rows: (t,) of `ROW`.
        meta: `rate_hz`, `robot`, `motion`, `driver`, `method`, `result` and more, JSON-serialisable.
        truth: (t,) of `OBSERVATION`, a simulated robot's true states at the states used; None of a real robot.
    """

    rows: NDArray[Any]
    motion: Motion
    meta: dict[str, Any]
    truth: NDArray[Any] | None = None

    @property
    def rate_hz(self) -> float:
        return float(self.meta["rate_hz"])

    def run_log(self) -> RunLog:
        """The part in the motion itself, for `fastmimic.identification.identify.identify`. Raises `DeploymentError` if
        the robot did not reach the motion."""
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
        arrays: dict[str, Any] = {
            _MARK: np.int64(FORMAT_VERSION),
            "meta_json": np.str_(json.dumps(self.meta, sort_keys=True)),
        }
        arrays[_MOTION] = np.frombuffer(_as_bytes(self.motion), np.uint8)
        arrays |= columns("", self.rows)
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


def _as_bytes(motion: Motion) -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "motion.npz"
        motion.save(path)
        return path.read_bytes()


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
