"""`fastmimic compare`: the paper's comparison, and its ablations."""

import os
import platform
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

from tyro.conf import arg

from fastmimic.base.errors import ConfigError, FastMimicError
from fastmimic.commands.console import note, put, share_progress
from fastmimic.commands.options import DEFAULT_ROBOT, check_duration
from fastmimic.robot import ROBOT_CHOICES

if TYPE_CHECKING:
    from fastmimic.experiments.compare import ComparisonPlan, Prepared
    from fastmimic.experiments.comparison_run import Row
    from fastmimic.experiments.parallel import ReportProgress, RunProgress
    from fastmimic.report.comparison_folder import ComparisonFolder

OUT: Final = Path("runs/comparison")


@dataclass(frozen=True, kw_only=True)
class Compare:
    """Runs several methods on several motions, several seeds each, and writes tables and figures.

    Writes results.csv, table.md, comparison.png, tracking.png and environment.json; with --ablations ablations.md and
    ablations.png as well. Each finished run is kept: after Ctrl-C or a crash, --resume does the rest, and may be given
    more motions, methods or seeds; the results cover them and all that is finished in the folder.
    """

    motions: Annotated[tuple[str, ...] | None, arg(metavar="MOTION ...")] = None
    """Names of 'fastmimic motions', or files; by default the paper's four recordings."""
    builtin: bool = False
    """The built-in trot, pace, turn and side-step instead, which need no data."""
    methods: Annotated[tuple[str, ...] | None, arg(metavar="METHOD ...")] = None
    """By default raibert, mbc, lh, mbc-dmp, lh-dmp, and rl if policies are given."""
    policy: Annotated[tuple[Path, ...], arg(metavar="FILE|FOLDER ...")] = ()
    """Trained policies for the method rl (policy.npz of 'fastmimic train'), one or more for each motion, or folders
    that hold them."""
    seeds: int = 8
    """Of CMA-ES, 0 to SEEDS - 1. Methods that optimise nothing are deterministic and run once."""
    ablations: bool = False
    """Also variants of mbc-dmp, each with one part taken away or changed."""
    robot: Annotated[str, arg(metavar="NAME|FILE.xml", help=f"{ROBOT_CHOICES}.")] = DEFAULT_ROBOT
    config: Annotated[str, arg(metavar="default|robust|paper|FILE")] = "default"
    """The controller's parameters: ours, ours for another robot than the model, or the paper's form."""
    iterations: int = 200
    """Generations of CMA-ES."""
    population: int = 10
    """Candidates in each."""
    duration: Annotated[float, arg(metavar="S")] = 5.0
    """Length of the optimisation's episodes."""
    workers: Annotated[int | None, arg(metavar="INT")] = None
    """Processes; by default one for each core. The rows do not depend on it."""
    out: Annotated[Path, arg(metavar="FOLDER")] = OUT
    """Where everything goes. A folder with a comparison is refused unless --resume or --overwrite."""
    resume: bool = False
    """Keep what is finished in the folder, go on with what is not."""
    overwrite: bool = False
    """Replace the comparison in the folder."""

    def run(self) -> int:
        """Runs it, and writes the folder; returns the exit status."""
        check_duration(self.duration)
        plan = self._plan()
        from fastmimic.base.machine import available_cores
        from fastmimic.experiments.compare import prepare
        from fastmimic.report.comparison_folder import open_comparison

        workers = self.workers if self.workers is not None else available_cores()
        if workers < 1:
            raise ConfigError(f"workers must be at least 1, found {workers}")
        total = len(plan.runs)
        with open_comparison(self.out, asdict(plan.settings), resume=self.resume, overwrite=self.overwrite) as folder:
            note(f"{total} runs in {self.out}, {workers} at a time")
            prepared = prepare(
                plan, self.out, keep=not self.overwrite, prepared=lambda name: note(f"{name}: retargeted")
            )
            folder.begin(_environment(plan, workers, prepared.kept), overwrite=self.overwrite)
            if prepared.kept:
                note(f"{len(prepared.kept)} more finished runs there are kept in the results")
            try:
                with _progress(total) as report:
                    rows = prepared.perform(workers, report)
            except (KeyboardInterrupt, FastMimicError):
                if folder.begun:
                    _leave(folder, prepared)
                raise
            folder.write(plan, rows, prepared.kept)
        for line in folder.table().splitlines():
            put(line)
        put(f"results in {self.out}")
        return 0

    def _plan(self) -> "ComparisonPlan":
        from fastmimic.experiments.compare import BUILT_IN_MOTIONS, PAPER_MOTIONS, ComparisonPlan, choose_policies
        from fastmimic.experiments.comparison_run import EVALUATION_S, ComparisonSettings
        from fastmimic.imitation.methods import METHODS, RL
        from fastmimic.robot import ROBOT_NAMES

        if self.builtin and self.motions is not None:
            raise ConfigError("--builtin stands for the four built-in motions; give it or --motions")
        robot = self.robot if self.robot in ROBOT_NAMES else os.path.abspath(self.robot)
        settings = ComparisonSettings(
            robot=robot if os.path.exists(robot) else self.robot,
            config=self.config,
            duration_s=self.duration,
            iterations=self.iterations,
            population=self.population,
            evaluation_s=EVALUATION_S,
        )
        default = BUILT_IN_MOTIONS if self.builtin else PAPER_MOTIONS
        motions = self.motions if self.motions is not None else default
        methods = self.methods if self.methods is not None else (*METHODS, *([RL] if self.policy else []))
        policies = choose_policies(self.policy, motions) if self.policy else ()
        return ComparisonPlan(settings, motions, methods, self.seeds, self.ablations, policies)


def _leave(folder: "ComparisonFolder", prepared: "Prepared") -> None:
    """Writes what an interrupted comparison, or one with a run that failed, has so far, and says how to go on."""
    try:
        rows = prepared.finished()
        if rows or prepared.kept:
            folder.write(prepared.plan, rows, prepared.kept)
    except FastMimicError as error:  # the interruption, or the run's failure, is what is reported
        note(f"tables of what is finished could not be written: {error}")
    note("what is finished is kept; the same command with --resume goes on")


def _environment(plan: "ComparisonPlan", workers: int, kept: "Sequence[Row]") -> dict[str, Any]:
    """What the results depend on, and what they were made with, JSON-serialisable; `kept` are other runs' rows."""
    from fastmimic.control.config import controller_config
    from fastmimic.experiments.ablations import ABLATIONS, ablation_named
    from fastmimic.experiments.comparison_run import run_of
    from fastmimic.imitation.imitate import versions
    from fastmimic.imitation.methods import ALL_METHODS, method_named

    config = controller_config(plan.settings.config)
    runs = [*(run_of(row) for row in kept), *plan.runs]
    methods = [name for name in ALL_METHODS if any(run.method == name for run in runs)]
    variants = [name for name in ABLATIONS if any(run.variant == name for run in runs)]
    return {
        "settings": asdict(plan.settings),
        "motions": list(dict.fromkeys(run.motion for run in runs)),
        "methods": methods,
        "seeds": max(run.seed for run in runs) + 1,
        "ablations": variants,
        **({"policies": {str(p.run): str(p.file) for p in plan.policies}} if plan.policies else {}),
        "workers": workers,
        "machine": {
            "system": platform.platform(),
            "processor": _processor(),
            "cores": os.cpu_count(),
        },
        "versions": versions(),
        "controllers": {name: method_named(name).configure(config).as_dict() for name in methods}
        | {name: ablation_named(name).change(config).as_dict() for name in variants},
    }


def _processor() -> str:
    """Its name as the system tells it, or its architecture."""
    try:
        with open("/proc/cpuinfo", encoding="utf-8") as file:
            names = [line.split(":", 1)[1].strip() for line in file if line.startswith("model name")]
    except OSError:
        names = []
    return names[0] if names else platform.processor() or platform.machine()


@contextmanager
def _progress(total: int) -> "Iterator[ReportProgress]":
    """A bar on a terminal, and in any case a line for each run that was finished."""
    with share_progress("comparing") as bar:

        def report(effort: "RunProgress", row: "Row | None") -> None:
            finished = total - len(effort.tasks) + effort.finished
            left = "" if effort.remaining_s is None else f", {_clock(effort.remaining_s)} left"
            if bar is not None:
                bar(effort.share, f"{finished}/{total} runs{left}")
            elif row is not None:
                note(f"{finished}/{total} {_said(row)}{left}")

        yield report


def _said(row: "Row") -> str:
    variant = f" ({row['variant']})" if row["variant"] else ""
    fell = ", fell" if row["fell"] else ""
    return f"{row['motion']} {row['method']}{variant} seed {row['seed']}: reward {row['reward']:.3f}{fell}"


def _clock(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{rest:02d}"
