"""What a simulated robot really did, for whoever scores it afterwards."""

from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fastmimic.base.errors import OutputError
from fastmimic.base.files import replace_file
from fastmimic.robot.state import COMMAND, OBSERVATION

FORMAT_VERSION: Final = 1
_CHUNK: Final = 4096


class GroundTruth(NamedTuple):
    """Of each state that a simulated robot measured, whether or not it arrived anywhere.

    Attributes:
        time: (t,) s since it began, by its own clock.
        tick: (t,) of the state message; what drivers call its sequence.
        observation: (t,) of `OBSERVATION`: the true state.
        command: (t,) of `COMMAND`: what the motors went by.
        damped: (t,) whether they damped because no command came.
        service: (t,) whether its own motion service moved it.
    """

    time: NDArray[np.float64]
    tick: NDArray[np.int64]
    observation: NDArray[Any]
    command: NDArray[Any]
    damped: NDArray[np.bool_]
    service: NDArray[np.bool_]


def load_ground_truth(path: str | Path) -> GroundTruth:
    """Reads what `GroundTruthLog.save` wrote.

    Raises:
        OutputError: not such a file.
    """
    try:
        with np.load(path, allow_pickle=False) as file:
            if int(file["format_version"]) != FORMAT_VERSION:
                raise OutputError(f"{path}: version {int(file['format_version'])}, expected {FORMAT_VERSION}")
            observation = np.zeros(len(file["time"]), OBSERVATION)
            command = np.zeros(len(file["time"]), COMMAND)
            for name in OBSERVATION.names or ():
                observation[name] = file[name]
            for name in COMMAND.names or ():
                command[name] = file[f"command_{name}"]
            return GroundTruth(file["time"], file["tick"], observation, command, file["damped"], file["service"])
    except (OSError, ValueError, KeyError) as error:
        raise OutputError(f"{path}: not a log of 'fastmimic robot-sim' ({type(error).__name__})") from None


class GroundTruthLog:
    """Gathers a `GroundTruth`.

    The file is an `.npz` without pickles: `format_version`; `time`, `tick`, `damped`, `service` (t,); the fields of
    `OBSERVATION` under their names, such as `root_pos` (t, 3); those of `COMMAND` with `command_` before them.
    """

    def __init__(self) -> None:
        self._full: list[NDArray[Any]] = []
        self._row = np.dtype(
            [
                ("time", "f8"),
                ("tick", "i8"),
                ("observation", OBSERVATION),
                ("command", COMMAND),
                ("damped", "?"),
                ("service", "?"),
            ]
        )
        self._chunk = np.zeros(_CHUNK, self._row)
        self._used = 0

    def add(
        self, time: float, tick: int, observation: NDArray[Any], command: NDArray[Any], damped: bool, service: bool
    ) -> None:
        """One measurement; the arrays are (1,) and copied."""
        if self._used == _CHUNK:
            self._full.append(self._chunk)
            self._chunk, self._used = np.zeros(_CHUNK, self._row), 0
        row = self._chunk[self._used]
        row["time"], row["tick"], row["damped"], row["service"] = time, tick, damped, service
        row["observation"], row["command"] = observation[0], command[0]
        self._used += 1

    def truth(self) -> GroundTruth:
        """What was gathered so far."""
        rows = np.concatenate([*self._full, self._chunk[: self._used]])
        return GroundTruth(*(rows[name] for name in GroundTruth._fields))

    def save(self, path: str | Path) -> None:
        """Writes the file, whole or not at all.

        Raises:
            OutputError: it cannot be written.
        """
        truth = self.truth()
        arrays: dict[str, NDArray[Any]] = {
            "format_version": np.array(FORMAT_VERSION),
            "time": truth.time,
            "tick": truth.tick,
            "damped": truth.damped,
            "service": truth.service,
            **{name: truth.observation[name] for name in OBSERVATION.names or ()},
            **{f"command_{name}": truth.command[name] for name in COMMAND.names or ()},
        }
        replace_file(path, lambda file: np.savez(file, **arrays))  # type: ignore[arg-type]
