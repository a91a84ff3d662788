"""The folder of an experiment whose parts are kept as they are finished: what may be written over, and what goes on."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from fastmimic.errors import ConfigError, OutputError
from fastmimic.experiments.entrants import MOTIONS
from fastmimic.files import check_folder, replace_file
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
        if resume and overwrite:
            raise ConfigError("--resume goes on with what is there and --overwrite replaces it: give one of them")
        path = self.path
        found = [name for name in (ENVIRONMENT, *self.written, self.parts, MOTIONS) if (path / name).exists()]
        earlier = self._earlier()
        if found and earlier is None:
            raise OutputError(f"{path} holds {', '.join(found)} of something else; choose another --out")
        if earlier is not None and not overwrite:
            self._check_same(earlier, resume)
        if resume and earlier is None:
            raise OutputError(f"{path} holds nothing to resume; leave out --resume to start")
        check_folder(path)
        if overwrite:
            self._clear()
        from fastmimic.pipeline import versions

        about = {"experiment": self.experiment, "settings": dict(self.settings), "versions": versions()}
        write_json(path / ENVIRONMENT, about)

    def write(self, name: str, text: str) -> None:
        """Writes one of the files made of the parts."""
        replace_file(self.path / name, lambda file: file.write(text.encode()))

    def table(self) -> str:
        """The table as it was written."""
        return (self.path / TABLE).read_text(encoding="utf-8")

    def _check_same(self, earlier: Mapping[str, Any], resume: bool) -> None:
        if not resume:
            raise OutputError(
                f"{self.path} holds results; --resume goes on with them, --overwrite replaces them, or choose another"
                " --out"
            )
        differ = [name for name, value in self.settings.items() if earlier.get(name) != value]
        if differ:
            old = ", ".join(f"{name.replace('_', '-')} {earlier.get(name)}" for name in differ)
            raise OutputError(
                f"{self.path} holds results of other settings ({old}); --resume with these, or choose another --out"
            )

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
            try:
                file.unlink(missing_ok=True)
            except OSError as error:
                raise OutputError(f"{file}: cannot be replaced ({error.strerror or error})") from None
