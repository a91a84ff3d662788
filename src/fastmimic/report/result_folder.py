"""The folder of an experiment whose parts are kept as they are finished: what may be written over, and what goes on."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from fastmimic.base.files import check_folder, check_resumable, remove_file, replace_file
from fastmimic.experiments.subject import MOTIONS
from fastmimic.report.run_folder import write_json

ENVIRONMENT: Final = "environment.json"
RESULTS_CSV: Final = "results.csv"
TABLE: Final = "table.md"


@dataclass(frozen=True)
class ResultFolder:
    """Where an experiment keeps its files.

    Attributes:
        path: the folder.
        experiment: which one, such as "stress".
        parts: name of the folder of the finished parts.
        written: names of the files that are made of them.
        settings: what must be the same to go on.
    """

    path: Path
    experiment: str
    parts: str
    written: tuple[str, ...]
    settings: Mapping[str, Any]

    def open(self, *, resume: bool, overwrite: bool) -> None:
        """Checks the folder before anything takes long, and begins the experiment there.

        Args:
            resume: whether to go on with what is in the folder.
            overwrite: whether to replace it.

        Raises:
            ConfigError: both `resume` and `overwrite`.
            OutputError: the folder holds results of other settings, or something else, or cannot be written to.
        """
        path = self.path
        found = [name for name in (ENVIRONMENT, *self.written, self.parts, MOTIONS) if (path / name).exists()]
        earlier = self._earlier()
        check_resumable(path, "an experiment", found, earlier, self.settings, resume=resume, overwrite=overwrite)
        check_folder(path)
        if overwrite:
            self._clear()
        from fastmimic.imitation.imitate import versions

        about = {"experiment": self.experiment, "settings": dict(self.settings), "versions": versions()}
        write_json(path / ENVIRONMENT, about)

    def write(self, name: str, text: str) -> None:
        """Writes one of the files made of the parts."""
        replace_file(self.path / name, lambda file: file.write(text.encode()))

    def table(self) -> str:
        """The table as it was written."""
        return (self.path / TABLE).read_text(encoding="utf-8")

    def _earlier(self) -> dict[str, Any] | None:
        try:
            found = json.loads((self.path / ENVIRONMENT).read_text(encoding="utf-8"))
            return dict(found["settings"]) if found.get("experiment") == self.experiment else None
        except (OSError, ValueError, KeyError, TypeError, AttributeError):
            return None

    def _clear(self) -> None:
        """Removes earlier results and their motions: its own files, and nothing else."""
        files = [self.path / name for name in (*self.written, ENVIRONMENT)]
        files += [*(self.path / self.parts).glob("*.json"), *(self.path / MOTIONS).glob("*.npz")]
        for file in files:
            remove_file(file)
