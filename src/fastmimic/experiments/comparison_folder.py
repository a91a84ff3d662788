"""The folder of a comparison: its runs, its motions, and the tables and figures made of them."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from fastmimic.base.errors import ConfigError
from fastmimic.base.files import read_json, write_json
from fastmimic.experiments.ablations import ABLATIONS
from fastmimic.experiments.comparison_run import RUN_FILES, Row
from fastmimic.imitation.methods import METHODS, method_named
from fastmimic.runs.work_folder import ENVIRONMENT, MOTIONS, RESULTS_CSV, TABLE, WorkFolder, created

RUNS: Final = "runs"
COMPARISON: Final = "comparison.png"
TRACKING_FIGURE: Final = "tracking.png"
ABLATION_TABLE: Final = "ablations.md"
ABLATION_FIGURE: Final = "ablations.png"
WRITTEN: Final = (RESULTS_CSV, TABLE, COMPARISON, TRACKING_FIGURE, ABLATION_TABLE, ABLATION_FIGURE)
"""Files made from the finished runs."""


@dataclass(frozen=True)
class ComparisonFolder(WorkFolder):
    """The files of a comparison."""

    @classmethod
    def at(cls, path: Path) -> "ComparisonFolder":
        files = (*WRITTEN, *(f"{RUNS}/*/{name}" for name in RUN_FILES), f"{MOTIONS}/*.npz")
        return cls(path, "a comparison", ENVIRONMENT, "settings", files)

    @property
    def begun(self) -> bool:
        """Whether any run has written something."""
        return (self.path / RUNS).is_dir()

    def begin(self, environment: Mapping[str, Any], *, overwrite: bool) -> None:
        """Writes `environment.json`; with `overwrite`, removes the comparison in the folder first. Motions of an
        earlier `environment.json` keep their places. Raises `OutputError` if a file cannot be removed or written."""
        earlier = [] if overwrite else self.motions()
        if overwrite:
            self.clear()
        motions = [*(name for name in earlier if name in environment["motions"]), *environment["motions"]]
        write_json(self.path / ENVIRONMENT, {**environment, "motions": list(dict.fromkeys(motions))})

    def motions(self) -> list[str]:
        """The motions in `environment.json`, if it exists."""
        try:
            return [str(name) for name in read_json(self.path / ENVIRONMENT)["motions"]]
        except (ConfigError, KeyError, TypeError):
            return []

    def in_order(self, rows: Sequence[Row]) -> list[Row]:
        """Rows in the order of a plan that has all of them."""
        motions = list(dict.fromkeys([*self.motions(), *(row["motion"] for row in rows)]))
        methods, variants = list(METHODS), ["", *ABLATIONS]

        def place(row: Row) -> tuple[int, ...]:
            kind = (bool(row["variant"]), method_named(row["method"]).optimises, row["seed"])
            return (*kind, motions.index(row["motion"]), methods.index(row["method"]), variants.index(row["variant"]))

        return sorted(rows, key=place)


@contextmanager
def open_comparison(
    path: Path, settings: Mapping[str, Any], *, resume: bool, overwrite: bool
) -> Iterator[ComparisonFolder]:
    """Prepares a folder for a comparison before long work begins; restores it if no run finishes.

    Args:
        settings: must equal those of `environment.json` to resume.

    Raises `ConfigError` for both `resume` and `overwrite`, `OutputError` if the folder holds other files or cannot be
    written.
    """
    folder = ComparisonFolder.at(path)
    new = not folder.found()
    folder.check(settings, resume=resume, overwrite=overwrite)
    with created(path):
        try:
            yield folder
        except BaseException:
            if new and not folder.begun:
                folder.clear()
            raise
