"""A cache of intact records and motions, so that a build need not read all of them at its start.

It compares sizes and times of files, and reads a file only if they differ. `fastmimic.dataset.folder.check` finds other
damage.
"""

import json
from pathlib import Path
from typing import Final

from fastmimic.base.files import write_text
from fastmimic.dataset.records import FAILED, load_record, record_file

FILE: Final = "work/seen.json"


class FinishedJobs:
    """The known intact files of a library."""

    def __init__(self, folder: Path) -> None:
        """Loads the saved state; empty if that is missing or damaged."""
        self._folder = folder
        self._states: dict[str, list[int]] = {}
        self._changed = False
        try:
            said = json.loads((folder / FILE).read_text(encoding="utf-8"))
        except (OSError, ValueError):
            return
        if isinstance(said, dict):
            self._states = said

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
            text = json.dumps(self._states)
            write_text(self._folder / FILE, text)
            self._changed = False

    def _state(self, identity: str, motion_file: str) -> list[int] | None:
        try:
            states = [path.stat() for path in (record_file(self._folder, identity), self._folder / motion_file)]
        except OSError:
            return None
        return [number for state in states for number in (state.st_size, state.st_mtime_ns)]
