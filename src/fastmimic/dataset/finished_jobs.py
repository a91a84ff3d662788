"""Which motions were whole when they were last read, so that a build need not read all of them whenever it starts.

A file is told by its size and its time. Where either differs, it is read; what the file system loses without a trace,
`fastmimic.dataset.folder.check` finds.
"""

import json
from pathlib import Path
from typing import Final

from fastmimic.base.files import write_text
from fastmimic.dataset.records import FAILED, load_record, record_file

FILE: Final = "work/seen.json"


class FinishedJobs:
    """What of a library was whole."""

    def __init__(self, folder: Path) -> None:
        """As it was kept last; nothing, if that is not there or damaged."""
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
        """Whether a record is there whose motion could be made, and both are whole.

        Args:
            identity: of the record.
            motion_file: of its motion, relative to the library.
        """
        state = self._state(identity, motion_file)
        if state is not None and self._states.get(identity) == state:
            return True
        record = load_record(self._folder, identity)
        found = record is not None and record["status"] != FAILED
        if found:
            self.add(identity, motion_file)
        return found

    def add(self, identity: str, motion_file: str) -> None:
        """Takes both as they are now for whole."""
        state = self._state(identity, motion_file)
        if state is not None:
            self._states[identity] = state
            self._changed = True

    def save(self) -> None:
        """Keeps it for the next time; raises `OutputError` if it cannot."""
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
