"""The true states of a simulated robot, for scoring a deployment."""

from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from fastmimic.base.errors import OutputError
from fastmimic.base.files import replace_file
from fastmimic.deploy.log import columns, from_columns
from fastmimic.robot.state import COMMAND, OBSERVATION

FORMAT_VERSION: Final = 1
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
_SINGLE: Final = ("time", "tick", "damped", "service")


def load_ground_truth(path: str | Path) -> NDArray[Any]:
    """(t,) of `GROUND_TRUTH` as `GroundTruthLog.save` wrote it; raises `OutputError` for another file."""
    try:
        with np.load(path, allow_pickle=False) as file:
            if int(file["format_version"]) != FORMAT_VERSION:
                raise OutputError(f"{path}: version {int(file['format_version'])}, expected {FORMAT_VERSION}")
            rows = np.zeros(len(file["time"]), GROUND_TRUTH)
            rows["observation"] = from_columns("", OBSERVATION, file)
            rows["command"] = from_columns("command_", COMMAND, file)
            for name in _SINGLE:
                rows[name] = file[name]
            return rows
    except (OSError, ValueError, KeyError) as error:
        raise OutputError(f"{path}: not a log of 'fastmimic robot-sim' ({type(error).__name__})") from None


class GroundTruthLog:
    """Collects rows of `GROUND_TRUTH`.

    The file is an `.npz` without pickles: `format_version`; `time`, `tick`, `damped`, `service` (t,); the fields of
    `OBSERVATION` under their names, such as `root_pos` (t, 3); those of `COMMAND` prefixed by `command_`.
    """

    def __init__(self) -> None:
        self._rows: list[NDArray[Any]] = []

    def add(
        self, time: float, tick: int, observation: NDArray[Any], command: NDArray[Any], damped: bool, service: bool
    ) -> None:
        """Adds a measurement; the arrays are (1,) and copied."""
        row = np.zeros(1, GROUND_TRUTH)
        row["time"], row["tick"], row["damped"], row["service"] = time, tick, damped, service
        row["observation"], row["command"] = observation, command
        self._rows.append(row)

    def rows(self) -> NDArray[Any]:
        """(t,) of `GROUND_TRUTH`."""
        return np.concatenate([np.zeros(0, GROUND_TRUTH), *self._rows])

    def save(self, path: str | Path) -> None:
        """Writes the file; raises `OutputError`."""
        rows = self.rows()
        arrays: dict[str, Any] = {"format_version": np.array(FORMAT_VERSION)}
        arrays |= {name: rows[name] for name in _SINGLE}
        arrays |= columns("", rows["observation"]) | columns("command_", rows["command"])
        replace_file(path, lambda file: np.savez(file, **arrays))
