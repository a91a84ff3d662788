"""The record of a motion (description, source, figures, and the motion's file), and its grade.

Records keep only figures; grades are computed on demand by one table, so that other thresholds need no new run.
"""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import msgspec

from fastmimic.base.files import packaged, write_text

Record = dict[str, Any]

RECORDS: Final = "records"
MOTIONS: Final = "motions"
FINISHED: Final = "work/seen.json"

DONE: Final = "done"
FAILED: Final = "failed"

_TYPES: Final = {"text": str, "whole": int, "number": float, "truth": bool}
_GROUPS: Final = {
    group: {name: _TYPES[kind] for name, kind in columns.items()}
    for group, columns in packaged("fastmimic.dataset", "columns.json", dict[str, dict[str, str]]).items()
}
FIGURES: Final = _GROUPS["figures"]
"""Columns of a finished motion; figures of episodes have the names of `Metrics`, of the nominal episode where a name
says no more. `limits_exceeded` is from `fastmimic.episode.feasibility.reasons`; `warm_start` is the record that the
search began from."""
COSTS: Final = _GROUPS["costs"]  # differ between repetitions
COLUMNS: Final[dict[str, type]] = {**_GROUPS["identity"], **FIGURES, **COSTS}
"""Name → type. A record has a value or None in each. `source` is a record's place, `piece` the digest of the excerpt's
content, `robot_file` a user's MJCF, `robot_digest` that of the robot's description, `reason` that of a failure."""
_KINDS: Final[dict[type, Any]] = {str: str, int: int, float: (int, float), bool: (bool, int, float)}  # as JSON has them
_NEEDED: Final = ("name", "piece", "robot", "robot_digest", "seed", "recipe", "status")


def empty() -> Record:
    return dict.fromkeys(COLUMNS)


def sha256(path: Path) -> str:
    """Digest of a file's content; raises `OSError`."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def record_file(folder: Path, identity: str) -> Path:
    """A record's file in a library."""
    return folder / RECORDS / f"{identity}.json"


def save_record(folder: Path, record: Mapping[str, Any]) -> None:
    """Writes a record, after its motion; raises `OutputError` if it cannot."""
    write_text(record_file(folder, record["id"]), json.dumps(record, indent=1, allow_nan=False))


def load_record(folder: Path, identity: str) -> Record | None:
    """A record, or None unless it and its motion are intact. A new build repairs damaged or changed ones."""
    return None if (found := read_record(record_file(folder, identity))) is None or damage(folder, found) else found


def read_record(path: Path) -> Record | None:
    """The record in a file; None if there is none. Columns that came after it are None."""
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    if not isinstance(found, dict) or not found.keys() <= COLUMNS.keys() or found.get("id") != path.stem:
        return None
    found = empty() | found
    whole = all(value is None or isinstance(value, _KINDS[COLUMNS[name]]) for name, value in found.items())
    return found if whole and all(found[name] is not None for name in _NEEDED) else None


def damage(folder: Path, record: Mapping[str, Any]) -> str | None:
    """The defect of a record's motion; None if it is intact."""
    name = record["motion_file"]
    if name is None:
        return None if record["status"] == FAILED else "it names no motion"
    try:
        return None if sha256(folder / name) == record["motion_sha256"] else f"{name} is not what was written"
    except OSError as error:
        return f"{name}: {error.strerror or error}"


class FinishedJobs:
    """A cache of intact records and motions, so that a build need not read all of them at its start.

    It compares sizes and times of files, and reads a file only if they differ. `fastmimic.dataset.repair.check` finds
    other damage.
    """

    def __init__(self, folder: Path) -> None:
        """Loads the saved state; empty if that is missing or damaged."""
        self._folder, self._changed = folder, False
        try:
            self._states = msgspec.json.decode((folder / FINISHED).read_bytes(), type=dict[str, list[int]])
        except (OSError, ValueError):
            self._states = {}

    def finished(self, identity: str, motion_file: str) -> bool:
        """Whether the record of a successful job and its motion (`motion_file`, relative to the library) are intact."""
        state = self._state(identity, motion_file)
        if state is not None and self._states.get(identity) == state:
            return True
        record = load_record(self._folder, identity)
        found = record is not None and record["status"] != FAILED
        if found:
            self.add(identity, motion_file)
        return found

    def add(self, identity: str, motion_file: str) -> None:
        """Marks the record and its motion as intact."""
        state = self._state(identity, motion_file)
        if state is not None:
            self._states[identity] = state
            self._changed = True

    def save(self) -> None:
        """Saves the state; raises `OutputError` if it cannot."""
        if self._changed:
            write_text(self._folder / FINISHED, json.dumps(self._states))
            self._changed = False

    def _state(self, identity: str, motion_file: str) -> list[int] | None:
        try:
            states = [path.stat() for path in (record_file(self._folder, identity), self._folder / motion_file)]
        except OSError:
            return None
        return [number for state in states for number in (state.st_size, state.st_mtime_ns)]


REJECTED: Final = "rejected"
FAILURE: Final = "failed"


@dataclass(frozen=True)
class Demand:
    """Inclusive bounds on a figure."""

    figure: str  # of the record; ignored if the record lacks it, because it was not evaluated
    least: float | None = None
    most: float | None = None
    says: str = ""
    numbered: bool = True  # whether a violation states the figure and its bound

    def unmet(self, record: Mapping[str, Any]) -> str | None:
        """The violation in words; None if the record meets the demand."""
        value = record[self.figure]
        if value is None:
            return None
        if self.least is not None and value < self.least:
            return f"{self.says} {value:.3g}, below {self.least:g}"
        if self.most is not None and value > self.most:
            return f"{self.says} {value:.3g}, above {self.most:g}" if self.numbered else self.says
        return None


GRADES: Final = packaged("fastmimic.dataset", "grades.json", dict[str, tuple[Demand, ...]])
"""From the best grade to the lowest; a grade includes the demands of those below it."""
KEPT: Final = tuple(GRADES)
RANKS: Final = (FAILURE, REJECTED, *reversed(KEPT))


def grade(record: Mapping[str, Any]) -> tuple[str, str]:
    """The grade of a record (`GRADES`, `REJECTED` or `FAILURE`), and why it is not better; empty for the best."""
    if record["status"] == FAILED:
        return FAILURE, str(record["reason"])
    reached, lacks = REJECTED, ""
    for name, demands in reversed(GRADES.items()):
        unmet = [said for demand in demands if (said := demand.unmet(record)) is not None]
        if unmet:
            lacks = "; ".join(unmet)
            break
        reached = name
    if reached == REJECTED and record["limits_exceeded"]:
        lacks += f" ({record['limits_exceeded']})"
    return reached, lacks
