"""`fastmimic compare`: runs the paper's comparison and its ablations."""

import os
import platform
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from tyro.conf import Suppress

from fastmimic.base.errors import ConfigError, FastMimicError
from fastmimic.base.machine import available_cores, versions
from fastmimic.commands import options as opt
from fastmimic.commands.console import KEPT, note, put, share_progress
from fastmimic.control.config import controller_config
from fastmimic.imitation.methods import METHODS, PAPER_METHODS, RL, method_named
from fastmimic.optimize.parameters import FinalChoice
from fastmimic.robot import ROBOT_NAMES
from fastmimic.runs.work_folder import TABLE

if TYPE_CHECKING:
    from fastmimic.experiments.compare import ComparisonPlan, Prepared
    from fastmimic.experiments.comparison_run import ComparisonFolder, Row
    from fastmimic.experiments.parallel import ReportProgress, RunProgress


@dataclass(frozen=True, kw_only=True)
class Compare:
    """Runs several methods on several motions with several seeds, and writes tables and figures.

    Writes results.csv, table.md, comparison.png, tracking.png and environment.json; with --ablations also ablations.md
    and ablations.png. Each finished run is kept: after Ctrl-C or a crash, --resume runs the others, also with more
    motions, methods or seeds. The results cover everything that is finished in the folder.
    """

    motions: Annotated[tuple[str, ...] | None, opt.option("MOTION ...")] = None
    """Names from 'fastmimic motions', or files. Default: the paper's four recordings."""
    builtin: opt.Flag = False
    """Use the built-in trot, pace, turn and side-step, which need no data."""
    methods: Annotated[tuple[str, ...] | None, opt.option("METHOD ...")] = None
    """Methods to run. Default: all but those that optimise more than the paper does; rl if policies are given."""
    policy: Annotated[tuple[Path, ...], opt.option("FILE|FOLDER ...")] = ()
    """Trained policies for the method rl (policy.npz of 'fastmimic train') or folders with policies; one or more for
    each motion."""
    seeds: int = 8
    """Number of CMA-ES seeds, from 0. Methods without a search are deterministic and run once."""
    ablations: opt.Flag = False
    """Also run variants of mbc-dmp, each with one part removed or changed."""
    duration: Annotated[float, opt.option("S")] = 5.0
    """Length of the search's episodes."""
    robot: opt.RobotName = opt.DEFAULT_ROBOT
    config: opt.ConfigName = "default"
    workers: opt.Workers = None
    out: Annotated[Path, opt.option("FOLDER")] = opt.RUNS / "comparison"
    """Folder of the results. One with a comparison needs --resume or --overwrite."""
    search: opt.Searching
    folder: opt.Folder
    choice: opt.Choice = FinalChoice()
    evaluation_s: Annotated[float, Suppress] = 10.0

    def run(self) -> int:
        opt.check_duration(self.duration)
        plan = self._plan()
        from fastmimic.experiments.compare import prepare
        from fastmimic.experiments.comparison_run import ABLATION_TABLE, open_comparison
        from fastmimic.report.comparison_figures import write_comparison

        workers = self.workers if self.workers is not None else available_cores()
        if workers < 1:
            raise ConfigError(f"workers must be at least 1, found {workers}")
        total = len(plan.runs)
        resume, overwrite = self.folder.resume, self.folder.overwrite
        with open_comparison(self.out, plan.settings.as_dict(), resume=resume, overwrite=overwrite) as folder:
            note(f"{total} runs in {self.out}, {workers} at a time")
            prepared = prepare(plan, self.out, keep=not overwrite, prepared=lambda name: note(f"{name}: retargeted"))
            folder.begin(_environment(plan, workers, prepared.kept), overwrite=overwrite)
            if prepared.kept:
                note(f"the results include {len(prepared.kept)} more finished runs from the folder")
            try:
                with _progress(total) as report:
                    rows = prepared.perform(workers, report)
            except (KeyboardInterrupt, FastMimicError):
                if folder.begun:
                    _leave(folder, prepared)
                raise
            write_comparison(folder, plan, rows, prepared.kept)
        put(*folder.read(TABLE, ABLATION_TABLE).splitlines(), f"results in {self.out}")
        return 0

    def _plan(self) -> "ComparisonPlan":
        from fastmimic.experiments.compare import BUILT_IN_MOTIONS, PAPER_MOTIONS, ComparisonPlan, choose_policies
        from fastmimic.experiments.comparison_run import ComparisonSettings

        if self.builtin and self.motions is not None:
            raise ConfigError("--builtin selects the four built-in motions; give it or --motions, not both")
        robot = self.robot if self.robot in ROBOT_NAMES else os.path.abspath(self.robot)
        settings = ComparisonSettings(
            robot=robot if os.path.exists(robot) else self.robot,
            config=self.config,
            duration_s=self.duration,
            iterations=self.search.iterations,
            population=self.search.population,
            evaluation_s=self.evaluation_s,
            choice=self.choice,
        )
        default = BUILT_IN_MOTIONS if self.builtin else PAPER_MOTIONS
        motions = self.motions if self.motions is not None else default
        methods = self.methods if self.methods is not None else (*PAPER_METHODS, *([RL] if self.policy else []))
        policies = choose_policies(self.policy, motions) if self.policy else {}
        return ComparisonPlan(settings, motions, methods, self.seeds, self.ablations, policies)


def _leave(folder: "ComparisonFolder", prepared: "Prepared") -> None:
    """Writes the results so far of an interrupted or failed comparison, and prints how to continue."""
    from fastmimic.report.comparison_figures import write_comparison

    try:
        rows = prepared.finished()
        if rows or prepared.kept:
            write_comparison(folder, prepared.plan, rows, prepared.kept)
    except FastMimicError as error:  # the interruption or the run's failure is reported
        note(f"the tables could not be written: {error}")
    note(KEPT)


def _environment(plan: "ComparisonPlan", workers: int, kept: "Sequence[Row]") -> dict[str, Any]:
    """Everything that the results depend on, JSON-serialisable; `kept` are the rows of other runs."""
    from fastmimic.experiments.ablations import ABLATIONS, ablation_named
    from fastmimic.experiments.comparison_run import run_of

    config = controller_config(plan.settings.config)
    runs = [*(run_of(row) for row in kept), *plan.runs]
    methods = [name for name in METHODS if any(run.method == name for run in runs)]
    variants = [name for name in ABLATIONS if any(run.variant == name for run in runs)]
    return {
        "settings": plan.settings.as_dict(),
        "motions": list(dict.fromkeys(run.motion for run in runs)),
        "methods": methods,
        "seeds": max(run.seed for run in runs) + 1,
        "ablations": variants,
        **({"policies": {str(run): str(file) for run, file in plan.policies.items()}} if plan.policies else {}),
        "workers": workers,
        "machine": {"system": platform.platform(), "processor": _processor(), "cores": os.cpu_count()},
        "versions": versions(),
        "controllers": {name: method_named(name).configure(config).as_dict() for name in methods}
        | {name: ablation_named(name).change(config).as_dict() for name in variants},
    }


def _processor() -> str:
    """Name of the processor, else its architecture."""
    try:
        with open("/proc/cpuinfo", encoding="utf-8") as file:
            names = [line.split(":", 1)[1].strip() for line in file if line.startswith("model name")]
    except OSError:
        names = []
    return names[0] if names else platform.processor() or platform.machine()


@contextmanager
def _progress(total: int) -> "Iterator[ReportProgress]":
    """A bar on a terminal, otherwise a line for each finished run."""
    with share_progress("comparing") as bar:

        def report(effort: "RunProgress", row: "Row | None") -> None:
            finished = total - len(effort.tasks) + effort.finished
            left = "" if effort.remaining_s is None else f", {_clock(effort.remaining_s)} left"
            if bar is not None:
                bar(effort.share, f"{finished}/{total} runs{left}")
            elif row is not None:
                run = row["method"] + (f" ({row['variant']})" if row["variant"] else "") + f" seed {row['seed']}"
                fell = ", fell" if row["fell"] else ""
                note(f"{finished}/{total} {row['motion']} {run}: reward {row['reward']:.3f}{fell}{left}")

        yield report


def _clock(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{rest:02d}"
