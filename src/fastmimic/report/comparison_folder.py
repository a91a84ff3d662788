"""The folder of a comparison: what lies in it, what may be written over, and what goes on."""

import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from fastmimic.base.errors import OutputError
from fastmimic.base.files import check_folder, check_resumable, read_section, remove_file, replace_file
from fastmimic.experiments.ablations import ABLATED, ABLATIONS
from fastmimic.experiments.compare import MOTIONS, RUNS
from fastmimic.experiments.comparison_run import RUN_FILES, TRACKING, Row, Run, run_of
from fastmimic.experiments.tables import ablation_table, comparison_table, summaries, to_csv
from fastmimic.imitation.methods import ALL_METHODS, method_named
from fastmimic.report.run_folder import write_json

if TYPE_CHECKING:
    from fastmimic.experiments.compare import ComparisonPlan

ENVIRONMENT: Final = "environment.json"
RESULTS_CSV: Final = "results.csv"
TABLE: Final = "table.md"
COMPARISON: Final = "comparison.png"
TRACKING_FIGURE: Final = "tracking.png"
ABLATION_TABLE: Final = "ablations.md"
ABLATION_FIGURE: Final = "ablations.png"
WRITTEN: Final = (RESULTS_CSV, TABLE, COMPARISON, TRACKING_FIGURE, ABLATION_TABLE, ABLATION_FIGURE)
SHOWN: Final = "dog:pace"
"""The motion whose foot the tracking figure follows, as the paper's does; the first one if it is not among them."""


@dataclass(frozen=True)
class ComparisonFolder:
    """Where a comparison keeps its files."""

    path: Path

    @property
    def begun(self) -> bool:
        """Whether any run has left something."""
        return (self.path / RUNS).is_dir()

    def begin(self, environment: Mapping[str, Any], *, overwrite: bool) -> None:
        """Removes the comparison that is to be replaced, and writes `environment.json`.

        Args:
            environment: what goes into it; motions that were there before keep their places.
            overwrite: whether to replace the comparison in the folder.

        Raises:
            OutputError: something cannot be removed or written.
        """
        earlier = [] if overwrite else self._motions()
        if overwrite:
            self.clear()
        motions = [*(name for name in earlier if name in environment["motions"]), *environment["motions"]]
        write_json(self.path / ENVIRONMENT, {**environment, "motions": list(dict.fromkeys(motions))})

    def write(self, plan: "ComparisonPlan", rows: Sequence[Row], kept: Sequence[Row] = ()) -> None:
        """Writes the tables and figures of all rows, in place of earlier ones; says so where runs are missing.

        Args:
            plan: what was asked for.
            rows: of its finished runs.
            kept: of the other finished runs in the folder.

        Raises:
            OutputError: something cannot be written.
        """
        missing = {*plan.runs} - {run_of(row) for row in rows}
        found = self._in_order([*kept, *rows])
        written = [RESULTS_CSV]
        self._write_text(RESULTS_CSV, to_csv(found))
        whole = [row for row in found if not row["variant"]]
        if whole:
            written += self._write_comparison(whole, len(whole) + sum(not run.variant for run in missing))
        of = {row["motion"] for row in found if row["variant"]} | {*(plan.motions if plan.ablations else ())}
        own = [row for row in found if row["method"] == ABLATED and row["motion"] in of]
        if own:
            left = sum(run.method == ABLATED and run.motion in of for run in missing)
            written += self._write_ablations(own, len(own) + left)
        self._remove(*(name for name in WRITTEN if name not in written))

    def _in_order(self, rows: Sequence[Row]) -> list[Row]:
        """As a plan of all of them would have them."""
        motions = list(dict.fromkeys([*self._motions(), *(row["motion"] for row in rows)]))
        methods, variants = list(ALL_METHODS), ["", *ABLATIONS]

        def place(row: Row) -> tuple[int, ...]:
            kind = (bool(row["variant"]), method_named(row["method"]).optimises, row["seed"])
            return (*kind, motions.index(row["motion"]), methods.index(row["method"]), variants.index(row["variant"]))

        return sorted(rows, key=place)

    def _motions(self) -> list[str]:
        """Those of `environment.json`, if there is one."""
        try:
            return [str(name) for name in json.loads((self.path / ENVIRONMENT).read_text(encoding="utf-8"))["motions"]]
        except (OSError, ValueError, KeyError, TypeError):
            return []

    def table(self) -> str:
        """The tables as they were written."""
        names = [name for name in (TABLE, ABLATION_TABLE) if (self.path / name).is_file()]
        return "\n".join((self.path / name).read_text(encoding="utf-8") for name in names)

    def _write_comparison(self, rows: Sequence[Row], expected: int) -> list[str]:
        from fastmimic.render.figure_style import save
        from fastmimic.report.comparison_figures import comparison_figure

        self._write_text(TABLE, comparison_table(rows, expected))
        found = summaries(rows)
        save(comparison_figure(found, f"Reward by method, {rows[0]['robot']}"), self.path / COMPARISON)
        return [TABLE, COMPARISON, *self._write_tracking(rows)]

    def _write_tracking(self, rows: Sequence[Row]) -> list[str]:
        """Of the paper's method, or of the first one that optimises; nothing if there is none."""
        import numpy as np

        from fastmimic.render.figure_style import save
        from fastmimic.report.comparison_figures import tracking_bars

        methods = [row["method"] for row in rows if method_named(row["method"]).optimises]
        if not methods:
            return []
        method = ABLATED if ABLATED in methods else methods[0]
        own = [row for row in rows if row["method"] == method]
        row = next((row for row in own if row["motion"] == SHOWN), own[0])
        run = Run(row["motion"], method, "", row["seed"])
        try:
            with np.load(self.path / RUNS / run.folder / TRACKING, allow_pickle=False) as file:
                courses = {name: file[name] for name in ("demonstration", "before", "after")}
                rate_hz, start_s = float(file["rate_hz"]), float(file["start_s"])
        except (OSError, ValueError, KeyError) as error:
            raise OutputError(
                f"{self.path / RUNS / run.folder / TRACKING}: cannot be read ({error}); remove that folder, and"
                " --resume makes it anew"
            ) from None
        title = f"Tracking before and after {method_named(method).label}, {row['robot']} (course: {run.motion})"
        save(tracking_bars(summaries(own), courses, rate_hz, start_s, title), self.path / TRACKING_FIGURE)
        return [TRACKING_FIGURE]

    def _write_ablations(self, rows: Sequence[Row], expected: int) -> list[str]:
        from fastmimic.render.figure_style import save
        from fastmimic.report.comparison_figures import ablation_figure

        self._write_text(ABLATION_TABLE, ablation_table(rows, expected))
        title = f"What the parts of {method_named(ABLATED).label} are worth, {rows[0]['robot']}"
        save(ablation_figure(summaries(rows), title), self.path / ABLATION_FIGURE)
        return [ABLATION_TABLE, ABLATION_FIGURE]

    def _write_text(self, name: str, text: str) -> None:
        replace_file(self.path / name, lambda file: file.write(text.encode()))

    def _remove(self, *names: str) -> None:
        for name in names:
            remove_file(self.path / name)

    def clear(self) -> None:
        """Removes an earlier comparison: its own files, and nothing else."""
        self._remove(*WRITTEN, ENVIRONMENT)
        runs = self.path / RUNS
        folders = [folder for folder in runs.iterdir() if folder.is_dir()] if runs.is_dir() else []
        for folder in folders:
            for name in RUN_FILES:
                remove_file(folder / name)
            _remove_empty(folder)
        motions = self.path / MOTIONS
        for file in motions.glob("*.npz"):
            remove_file(file)
        for folder in (runs, motions):
            _remove_empty(folder)


@contextmanager
def open_comparison(
    path: Path, settings: Mapping[str, Any], *, resume: bool, overwrite: bool
) -> Iterator[ComparisonFolder]:
    """Checks a folder for a comparison, before anything takes long; `begin` writes. If nothing was done, it is as it
    was.

    Args:
        path: the folder.
        settings: must be those of `environment.json` to resume.
        resume: whether to go on with the comparison in the folder.
        overwrite: whether to replace it.

    Raises:
        ConfigError: both `resume` and `overwrite`.
        OutputError: the folder holds another comparison, or something else, or cannot be written to.
    """
    folder = ComparisonFolder(path)
    found = [name for name in (ENVIRONMENT, *WRITTEN, RUNS, MOTIONS) if (path / name).exists()]
    earlier = read_section(path / ENVIRONMENT, "settings")
    check_resumable(path, "a comparison", found, earlier, settings, resume=resume, overwrite=overwrite)
    created = [p for p in (path, *path.parents) if not p.exists()]
    check_folder(path)
    try:
        yield folder
    except BaseException:
        if not found and not folder.begun:
            folder.clear()
            for made in created:
                _remove_empty(made)
        raise


def _remove_empty(path: Path) -> None:
    try:
        path.rmdir()
    except OSError:  # not empty, or gone
        return
