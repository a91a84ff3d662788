"""`fastmimic motions`: what has a name."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import arg

from fastmimic.commands.console import note, put, table


@dataclass(frozen=True, kw_only=True)
class Motions:
    """Lists the motions that have a name: built-in gaits, and recordings of a dog."""

    folder: Annotated[Path | None, arg(metavar="FOLDER")] = None
    """Where the recordings are; by default $FASTMIMIC_DATA, else the user's cache."""

    def run(self) -> int:
        """Prints the list; returns the exit status."""
        from fastmimic.clips.catalogue import describe

        rows = describe(self.folder)
        cells = [(r.name, r.speed, "yes" if r.available else "no", r.about, r.source) for r in rows]
        for line in table([("name", "speed", "here", "what it is", "source"), *cells]):
            put(line)
        for licence in dict.fromkeys(r.licence for r in rows if r.source != "built in"):
            note(f"licence of the recordings: {licence}")
        if not all(r.available for r in rows):
            note("'fastmimic data fetch' brings what is not here")
        return 0
