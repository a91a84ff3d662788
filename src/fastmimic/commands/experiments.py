"""`fastmimic compare`, `stress` and `transfer`: the paper's methods; disturbances; other robots and simulators."""

import hashlib
import os
import platform
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict
from datetime import timedelta
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from tyro.conf import Positional

from fastmimic.base.errors import ConfigError, FastMimicError
from fastmimic.base.files import check_folder, write_json
from fastmimic.base.machine import available_cores, versions
from fastmimic.base.progress import note, share_progress, slow_start
from fastmimic.commands import options as opt
from fastmimic.commands.console import KEPT, put
from fastmimic.control.config import controller_config
from fastmimic.executors import check_workers
from fastmimic.imitation.methods import METHODS, PAPER_METHODS, RL
from fastmimic.motion.motion import Motion
from fastmimic.robot import ROBOT_NAMES, Robot
from fastmimic.runs.work_folder import ENVIRONMENT, MOTIONS, TABLE, WorkFolder, of_finished
from fastmimic.simulation.simulators import FIRST_SIMULATOR, SECOND_SIMULATOR, SIMULATORS

if TYPE_CHECKING:  # loads the compiler
    from fastmimic.episode.loop import MakeController
    from fastmimic.experiments.compare import ComparisonPlan, Prepared, ReportProgress
    from fastmimic.experiments.comparison_run import ComparisonFolder, Row
    from fastmimic.experiments.experiment import Subject


@opt.command
class Compare:
    """Runs several methods on several motions with several seeds, and writes tables and figures."""

    motions: Annotated[tuple[str, ...] | None, opt.option("MOTION ...")] = None
    builtin: opt.Flag = False
    methods: Annotated[tuple[str, ...] | None, opt.option("METHOD ...")] = None
    policy: Annotated[tuple[Path, ...], opt.option("FILE|FOLDER ...")] = ()
    seeds: int = 8
    ablations: opt.Flag = False
    duration: Annotated[float, opt.option("S")] = 5.0
    robot: opt.RobotName = opt.DEFAULT_ROBOT
    config: opt.ConfigName = "default"
    workers: opt.Workers = None
    out: Annotated[Path, opt.option("FOLDER")] = opt.RUNS / "comparison"
    search: opt.Searching
    folder: opt.Folder

    def run(self) -> None:
        opt.check_duration(self.duration)
        plan = self._plan()
        from fastmimic.experiments.compare import prepare
        from fastmimic.experiments.comparison_run import ABLATION_TABLE, ComparisonFolder
        from fastmimic.report.experiment_figures import write_comparison

        check_workers(self.workers)
        workers = self.workers or available_cores()
        total = len(plan.runs)
        resume, overwrite = self.folder.resume, self.folder.overwrite
        folder = ComparisonFolder.at(self.out)
        with folder.opened(plan.settings.as_dict(), resume=resume, overwrite=overwrite):
            note(f"{total} runs in {self.out}, {workers} at a time")
            prepared = prepare(plan, self.out, keep=not overwrite, prepared=lambda name: note(f"{name}: retargeted"))
            folder.begin(_environment(plan, workers, prepared.kept), overwrite=overwrite)
            if prepared.kept:
                note(f"the results include {len(prepared.kept)} more finished runs from the folder")
            try:
                with _progress(total, total - len(prepared.tasks)) as report:
                    prepared.perform(workers, report)
            except (KeyboardInterrupt, FastMimicError):
                if folder.begun:
                    _leave(folder, prepared)
                raise
            of_finished(self.out)(write_comparison)(folder, plan, prepared.finished())
        put(*folder.read(TABLE, ABLATION_TABLE).splitlines(), f"results in {self.out}")

    def _plan(self) -> "ComparisonPlan":
        from fastmimic.experiments.compare import BUILT_IN_MOTIONS, PAPER_MOTIONS, ComparisonPlan, choose_policies
        from fastmimic.experiments.comparison_run import ComparisonSettings

        if self.builtin and self.motions is not None:
            raise ConfigError("--builtin selects the four built-in motions; give it or --motions, not both")
        robot = self.robot if self.robot in ROBOT_NAMES else os.path.abspath(self.robot)
        robot = robot if os.path.exists(robot) else self.robot
        settings = opt.apply(ComparisonSettings, self, self.search, robot=robot, duration_s=self.duration)
        default = BUILT_IN_MOTIONS if self.builtin else PAPER_MOTIONS
        motions = self.motions if self.motions is not None else default
        methods = self.methods if self.methods is not None else (*PAPER_METHODS, *([RL] if self.policy else []))
        policies = choose_policies(self.policy, motions) if self.policy else {}
        return ComparisonPlan(settings, motions, methods, self.seeds, self.ablations, policies)


def _leave(folder: "ComparisonFolder", prepared: "Prepared") -> None:
    """Writes the results so far of an interrupted or failed comparison, and prints how to continue."""
    from fastmimic.report.experiment_figures import write_comparison

    try:
        if rows := prepared.finished():
            of_finished(folder.path)(write_comparison)(folder, prepared.plan, rows)
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
        "controllers": {name: METHODS[name].configure(config).as_dict() for name in methods}
        | {name: ablation_named(name).change(config).as_dict() for name in variants},
    }


def _processor() -> str:
    """Name of the processor, else its architecture."""
    with suppress(OSError), open("/proc/cpuinfo", encoding="utf-8") as file:
        for line in file:
            if line.startswith("model name"):
                return line.split(":", 1)[1].strip()
    return platform.processor() or platform.machine()


@contextmanager
def _progress(total: int, finished: int) -> "Iterator[ReportProgress]":
    """A bar on a terminal, otherwise a line for each finished run."""
    from fastmimic.experiments.comparison_run import run_of

    began = time.perf_counter()
    with share_progress("comparing") as tell:

        def report(share: float, row: "Row | None") -> None:
            nonlocal finished
            remaining_s = (time.perf_counter() - began) * (1.0 - share) / share if share > 0 else None
            left = "" if remaining_s is None else f", {timedelta(seconds=round(remaining_s))} left"
            line = ""
            if row is not None:
                finished += 1
                fell = ", fell" if row["fell"] else ""
                line = f"{finished}/{total} {run_of(row)}: reward {row['reward_mean']:.3f}{fell}{left}"
            tell(share, f"{finished}/{total} runs{left}", line)

        yield report


ResultsFolder = Annotated[Path, opt.shared("FOLDER", "results")]


@opt.command
class ExperimentOptions:
    """What experiments over methods share."""

    robot: opt.RobotChoice = None
    seed: int = 0
    config: opt.ConfigName = "default"
    policy: Annotated[Path | None, opt.option("FILE")] = None
    out: ResultsFolder
    clip: opt.ClipReading
    search: opt.Searching
    folder: opt.Folder

    def checked_policy(self, robot: Robot, motion: Motion) -> "tuple[MakeController, str] | None":
        """The controllers of the policy and the hash of its file; None without a policy."""
        if self.policy is None:
            return None
        controller = opt.policy_controller(self.policy, robot, motion)
        return controller, hashlib.sha256(self.policy.read_bytes()).hexdigest()

    def opened(self, experiment: str, parts: str, written: tuple[str, ...], about: dict[str, Any]) -> WorkFolder:
        """The folder of the results, checked before long work, with its `environment.json`. `parts` is the subfolder of
        finished parts, `written` are the files made from them, `about` the settings that must equal the earlier ones to
        resume. Raises `ConfigError` and `OutputError` as `WorkFolder.check`."""
        files = (*written, f"{parts}/*.json", f"{MOTIONS}/*.npz")
        folder = WorkFolder(self.out, "an experiment", ENVIRONMENT, "settings", files, experiment)
        folder.check(about, resume=self.folder.resume, overwrite=self.folder.overwrite)
        check_folder(self.out)
        if self.folder.overwrite:
            folder.clear()
        write_json(self.out / ENVIRONMENT, {"experiment": experiment, "settings": about, "versions": versions()})
        return folder

    def subject(
        self, method: str, motion: Motion, robot: Robot, policy: "tuple[MakeController, str] | None"
    ) -> "Subject":
        """The method with its motion, optimised first if the method does that."""
        from fastmimic.experiments.experiment import make_subject
        from fastmimic.optimize.cma_es import CmaSettings, optimisation_progress

        search = opt.apply(CmaSettings, self, self.search)
        folder, config = self.out / MOTIONS, self.config
        with optimisation_progress() as progress:
            return make_subject(method, motion, robot, search, folder, config=config, policy=policy, progress=progress)

    @contextmanager
    def writing(self, folder: WorkFolder, write: Callable[[], None]) -> Iterator[None]:
        """Writes the results after the block or a Ctrl-C in it, and prints the table."""
        write = of_finished(folder.path)(write)
        try:
            yield
        except KeyboardInterrupt:
            write()
            note(KEPT)
            raise
        write()
        put(folder.read(TABLE), f"results in {self.out}")


@opt.command
class Stress(ExperimentOptions):
    """Runs a motion over a range of each disturbance and measures how much it tolerates."""

    motion: Annotated[Positional[str], opt.option("MOTION")]
    methods: Annotated[tuple[str, ...], opt.option("METHOD ...")] = ("mbc", "mbc-dmp", "raibert")
    disturbances: Annotated[tuple[str, ...] | None, opt.shared("NAME ...", "swept")] = None
    episodes: int = 20
    duration: Annotated[float, opt.option("S")] = 6.0
    simulator: opt.Simulator = FIRST_SIMULATOR
    observe: opt.Observation = "truth"
    ideal: opt.Ideal = False
    out: ResultsFolder = opt.RUNS / "stress"

    def run(self) -> None:
        opt.check_duration(self.duration)
        from fastmimic.experiments.experiment import check_methods, finish_part, part_file
        from fastmimic.experiments.stress import SWEEPS, StressSettings, check_length, disturbances_of, sweep
        from fastmimic.report.experiment_figures import STRESS_FILES, write_stress

        check_methods(self.methods, self.policy is not None)
        names = disturbances_of(self.disturbances, self.simulator, self.observe)
        robot, motion = self.clip.load(self.motion, self.robot)
        settings = opt.apply(StressSettings, self, self.search, robot=robot.name, duration_s=self.duration)
        policy = self.checked_policy(robot, motion)
        check_length(motion, names, settings)
        SIMULATORS[self.simulator].check(robot)
        folder = self.opened("stress", SWEEPS, STRESS_FILES, {"motion": motion.name, **asdict(settings)})
        planned = [(method, name) for method in self.methods for name in names]
        with self.writing(folder, lambda: write_stress(folder, settings, planned)):
            for i, method in enumerate(self.methods):
                subject = self.subject(method, motion, robot, policy)
                with share_progress("sweeps") as tell, slow_start(f"{method}: first sweep"):
                    for k, name in enumerate(names, i * len(names) + 1):
                        path = part_file(self.out / SWEEPS, method, name)
                        finish_part(path, subject.digest, partial(sweep, subject, name, robot, settings))
                        tell(k / len(planned), f"{method}, {name}", f"{k}/{len(planned)} {method}, {name}")


@opt.command
class Transfer(ExperimentOptions):
    """Optimises motions in MuJoCo with the true state, then runs them without change under conditions that differ more
    and more."""

    motions: Annotated[Positional[tuple[str, ...]], opt.option("MOTION ...")]
    methods: Annotated[tuple[str, ...], opt.option("METHOD ...")] = ("mbc", "mbc-dmp")
    trials: int = 3
    duration: Annotated[float, opt.option("S")] = 10.0
    identify: opt.Flag = False
    out: ResultsFolder = opt.RUNS / "transfer"

    def run(self) -> None:
        opt.check_duration(self.duration)
        from fastmimic.experiments.experiment import check_methods, finish_part, part_file
        from fastmimic.experiments.transfer import PARTS, TransferSettings, run_trials
        from fastmimic.report.experiment_figures import TRANSFER_FILES, write_transfer

        if not self.motions:
            raise ConfigError("give at least one motion, such as dog:right-turn")
        if self.policy is not None and len(self.motions) > 1:
            raise ConfigError("a policy is for one motion; run the motions one after another")
        check_methods(self.methods, self.policy is not None)
        settings = opt.apply(TransferSettings, self, self.search, duration_s=self.duration)
        loaded = [self.clip.load(source, self.robot) for source in self.motions]
        names = [motion.name for _, motion in loaded]
        if len(set(names)) < len(names):
            raise ConfigError(f"two motions have the same name: {', '.join(names)}")
        robots = {robot.name: robot for robot, _ in loaded}
        if len(robots) > 1:
            raise ConfigError(f"the motions are for different robots: {', '.join(robots)}")
        SIMULATORS[SECOND_SIMULATOR].check(loaded[0][0])
        policy = self.checked_policy(*loaded[0])
        folder = self.opened("transfer", PARTS, TRANSFER_FILES, {"robot": loaded[0][0].name, **asdict(settings)})
        planned = [(name, method) for name in names for method in self.methods]
        with self.writing(folder, lambda: write_transfer(folder, planned)):
            for robot, motion in loaded:
                for method in self.methods:
                    subject = self.subject(method, motion, robot, policy)
                    path = part_file(self.out / PARTS, motion.name, method)
                    with slow_start(f"{motion.name}, {method}: running"):
                        finish_part(path, subject.digest, partial(run_trials, subject, robot, settings))
                    note(f"{motion.name}, {method}: done")
