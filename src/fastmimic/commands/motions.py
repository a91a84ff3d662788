"""`fastmimic motions`: lists the named motions."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from fastmimic.commands import options as opt
from fastmimic.commands.console import note, put_table


@dataclass(frozen=True, kw_only=True)
class Motions:
    """Lists the named motions: built-in gaits and recordings of a dog."""

    folder: Annotated[Path | None, opt.option("FOLDER")] = None
    """Folder of the recordings. Default: $FASTMIMIC_DATA, else the user's cache."""

    def run(self) -> int:
        """Prints the list; returns the exit status."""
        from fastmimic.clips.catalogue import describe

        rows = describe(self.folder)
        cells = [(r.name, r.speed, "yes" if r.available else "no", r.about, r.source) for r in rows]
        put_table([("name", "speed", "here", "description", "source"), *cells])
        for licence in dict.fromkeys(r.licence for r in rows if r.source != "built in"):
            note(f"licence of the recordings: {licence}")
        if not all(r.available for r in rows):
            note("'fastmimic data fetch' downloads what is missing here")
        return 0
