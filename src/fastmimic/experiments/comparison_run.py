"""A run of a comparison (a method on a motion with a seed, and its row of results), and the comparison's folder.

The seed of an optimised method is that of CMA-ES. Other methods are deterministic in simulation (paper) and run once,
as seed 0. All runs have the same evaluation: one nominal episode from the motion's start (`reward_mean`), and episodes
from the same perturbed starts (`reward_mean_perturbed`, `reward_std_perturbed`), which no optimisation has seen.
"""

import json
import re
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final, TypeVar

import msgspec
import numpy as np

from fastmimic.base.arrays import fingerprint
from fastmimic.base.errors import ConfigError, OutputError
from fastmimic.base.files import from_json, read_json, replace_file, write_json, write_text
from fastmimic.base.machine import versions
from fastmimic.base.text import plain
from fastmimic.control.config import ControllerConfig, controller_config
from fastmimic.episode.loop import MakeController, run_episodes
from fastmimic.episode.plan import episode_duration
from fastmimic.episode.rollout import Rollout
from fastmimic.executors import Report
from fastmimic.experiments import measurement
from fastmimic.experiments.ablations import ABLATIONS, ablation_named
from fastmimic.experiments.measurement import Row
from fastmimic.imitation.evaluate import EVALUATION_S, PERTURBED_EPISODES
from fastmimic.imitation.imitate import Imitation
from fastmimic.imitation.methods import METHODS
from fastmimic.learning.policy import POLICY_FILE, Policy, controlled_by
from fastmimic.motion.motion import Motion
from fastmimic.optimize.cma_es import MOST_ITERATIONS, Progress
from fastmimic.optimize.parameters import FinalChoice, SearchSettings
from fastmimic.optimize.problem import Objective
from fastmimic.robot import Robot, load_robot
from fastmimic.runs.work_folder import CHECKPOINT, ENVIRONMENT, MOTION, MOTIONS, RESULTS_CSV, TABLE, WorkFolder, created

Kind = TypeVar("Kind")
ROW: Final = "row.json"
TRACKING: Final = "tracking.npz"
RUN_FILES: Final = (ROW, MOTION, TRACKING, CHECKPOINT, POLICY_FILE)
RUNS: Final = "runs"
COMPARISON: Final = "comparison.png"
TRACKING_FIGURE: Final = "tracking.png"
ABLATION_TABLE: Final = "ablations.md"
ABLATION_FIGURE: Final = "ablations.png"
WRITTEN: Final = (RESULTS_CSV, TABLE, COMPARISON, TRACKING_FIGURE, ABLATION_TABLE, ABLATION_FIGURE)
"""Files made from the finished runs."""

_TRACKED_CYCLES: Final = 2
_WARM_UP_S: Final = 0.01


@dataclass(frozen=True)
class ComparisonSettings(SearchSettings):
    """Settings of all runs of a comparison."""

    robot: str = "a1"  # its name, or the path of its MJCF
    config: str = "default"
    duration_s: float = 5.0  # length of the optimisation's episodes, s
    iterations: int | None = None  # of the optimisation; None until it gains nothing more
    population: int = 10
    evaluation_s: float = EVALUATION_S  # length of the evaluation's episodes, s; at most a motion that does not repeat
    perturbed_episodes: int = PERTURBED_EPISODES  # number of evaluation episodes from perturbed starts
    choice: FinalChoice = FinalChoice()  # how a search chooses its result


@dataclass(frozen=True)
class Run:
    """Motion, method, variant of the method (empty for none) and seed."""

    motion: str
    method: str
    variant: str
    seed: int

    @property
    def folder(self) -> str:
        parts = (self.motion, self.method, *([self.variant] if self.variant else []), f"seed{self.seed}")
        return slug("-".join(parts))

    def __str__(self) -> str:
        variant = f" ({self.variant})" if self.variant else ""
        return f"{self.motion} {self.method}{variant} seed {self.seed}"


@dataclass(frozen=True)
class RunTask:
    """A run with its files: the motion retargeted for its variant, its folder, and a learned method's policy."""

    run: Run
    settings: ComparisonSettings
    demonstration: Path
    folder: Path
    policy: Path | None = None

    @property
    def simulated_s(self) -> float:
        """Estimated simulated time, s, as the measure of its length."""
        s = self.settings
        evaluated_s = s.evaluation_s * (2 + s.perturbed_episodes)
        optimises = METHODS[self.run.method].optimises
        return evaluated_s + s.choice.simulated_s + self.searched_s if optimises else evaluated_s

    @property
    def searched_s(self) -> float:
        """The part of it in the search of a method that has one, s."""
        return self.settings.duration_s * self.settings.population * (self.settings.iterations or MOST_ITERATIONS)


def slug(text: str) -> str:
    return re.sub(r"[^\w.-]+", "_", text)


def check_unique(what: str, names: Sequence[str]) -> None:
    """Raises `ConfigError` if a name is given twice."""
    twice = sorted({name for name in names if list(names).count(name) > 1})
    if twice:
        raise ConfigError(f"{what} {', '.join(twice)} is given twice")


def controller_of(run: Run, settings: ComparisonSettings) -> ControllerConfig:
    """The run's controller before its method changes it."""
    return ablation_named(run.variant).change(controller_config(settings.config))


def digest(
    run: Run, settings: ComparisonSettings, robot: Robot, demonstration: Motion, policy: Policy | None = None
) -> str:
    """16 hexadecimal digits of everything that determines a run but the seed; `policy` is that of a learned method."""
    arrays = (getattr(demonstration, name) for name in ("root_pos_w", "root_quat_wxyz", "joint_pos", "contact"))
    method = METHODS[run.method]
    said = {
        "method": method.name,
        "parameters": method.parameters,
        "controller": method.configure(controller_of(run, settings)).as_dict(),
        "n_basis": ablation_named(run.variant).n_basis,
        "objective": asdict(Objective(settings.duration_s)),
        "settings": {k: v for k, v in settings.as_dict().items() if k != "robot"},
    }
    if policy is not None:
        said["policy"] = policy.digest
    return fingerprint(robot.content, *arrays, said)


def perform(task: RunTask, report: Report) -> Row:
    """Optimises if the method does, evaluates, and writes the run's folder; resumes from a checkpoint in it. Returns
    the row, of `COLUMNS`. The folder keeps a copy of a learned method's policy. Raises `FastMimicError` as `imitate`;
    the checkpoint survives Ctrl-C."""

    def progress(step: Progress) -> None:
        report(step.iteration / step.iterations * task.searched_s / task.simulated_s)

    run, settings, folder, method = task.run, task.settings, task.folder, METHODS[task.run.method]
    robot, policy, controller = load_robot(settings.robot), None, None
    if task.policy is not None:
        policy = Policy.load(task.policy)
        controller = controlled_by(policy)
    demonstration = Motion.load(task.demonstration)
    resumed = (folder / CHECKPOINT).is_file()
    config = controller_of(run, settings)
    # compile or load before the clock starts
    run_episodes(robot, demonstration, duration_s=_WARM_UP_S, config=method.configure(config), controller=controller)
    busy = time.process_time()
    result = measurement.searched(
        demonstration,
        robot,
        settings,
        folder / CHECKPOINT,
        method=run.method,
        config=config,
        duration_s=episode_duration(demonstration, settings.duration_s),
        seed=run.seed,
        workers=1,
        progress=progress,
        n_basis=ablation_named(run.variant).n_basis,
        controller=controller,
    )
    began = time.perf_counter()
    row = _row(task, result, controller)
    row |= {
        "wall_s": result.wall_s + time.perf_counter() - began,
        "cpu_s": None if resumed else time.process_time() - busy,
        "digest": digest(run, settings, robot, demonstration, policy),
    }
    if policy is not None:
        row |= _with_training(row, policy)
        policy.save(folder / POLICY_FILE)
    if method.optimises:
        result.motion.save(folder / MOTION)
    write_text(folder / ROW, json.dumps(row, indent=1, allow_nan=False))
    return row


def read_part(path: Path, kind: Callable[[Any], Kind]) -> Kind:
    """What `kind` makes of a finished part's JSON; raises `OutputError` if it is damaged or missing."""
    try:
        return kind(from_json(path.read_text(encoding="utf-8")))
    except (OSError, ValueError, TypeError, KeyError) as error:
        raise OutputError(f"{path}: cannot be read ({error}); remove it, and --resume makes it anew") from None


def finished_row(folder: Path) -> Row | None:
    """The row of a finished run, or None; raises `OutputError` if its file is damaged."""
    path = folder / ROW
    return read_part(path, lambda row: dict(row) | asdict(run_of(row))) if path.is_file() else None


def finished_rows(out: Path) -> dict[str, Row]:
    """The rows of all finished runs of a comparison by the names of their folders; raises as `finished_row`."""
    rows = {path.parent.name: finished_row(path.parent) for path in sorted((out / RUNS).glob(f"*/{ROW}"))}
    return {name: row for name, row in rows.items() if row is not None}


def run_of(row: Row) -> Run:
    return msgspec.convert(row, Run, strict=False)


def _with_training(row: Row, policy: Policy) -> Row:
    """Adds the cost of the policy's training, if recorded, and the policy's digest as parameters."""
    training = policy.training
    costs = {name: (row[name], training.get(name)) for name in ("wall_s", "cpu_s", "simulated_s")}
    return {
        "parameters": f"policy={policy.digest} steps={training.get('steps')}",
        "evaluations": training.get("episodes"),
        **{name: None if None in pair else sum(pair) for name, pair in costs.items()},
    }


def _row(task: RunTask, result: Imitation, controller: MakeController | None) -> Row:
    robot, demonstration, run, settings = result.robot, result.demonstration, task.run, task.settings
    measured = measurement.measure(result, settings.evaluation_s, settings.perturbed_episodes, controller)
    _save_tracking(task.folder / TRACKING, demonstration, measured.before, measured.after, robot)
    found = {
        **asdict(run),
        **measured.figures,
        "evaluations": result.evaluations,
        "iterations": result.iterations,
        "simulated_s": result.simulated_s + measured.simulated_s,
        "robot": robot.name,
        "config": settings.config,
        "duration_s": settings.duration_s,
        "population": settings.population,
        "evaluation_s": measured.seconds,
        "perturbed_episodes": settings.perturbed_episodes,
        "parameters": measurement.named_values(result),
        **{f"{name}_version": v for name, v in versions().items()},
    }
    return dict(plain(found))


def _save_tracking(path: Path, demonstration: Motion, before: Rollout, after: Rollout, robot: Robot) -> None:
    """Saves the feet in the last cycles that both rollouts completed, for the figure."""
    shown = _TRACKED_CYCLES * demonstration.n_samples
    end = max(int(before.steps[0]), int(after.steps[0]))
    window = slice(max(0, end - shown), end)
    wanted, realised = measurement.foot_courses(after, robot)
    unoptimised = measurement.foot_courses(before, robot)[1]
    found: dict[str, Any] = {"rate_hz": demonstration.rate_hz, "start_s": window.start / demonstration.rate_hz}
    found |= {"demonstration": wanted[window], "before": unoptimised[window], "after": realised[window]}
    replace_file(path, lambda file: np.savez_compressed(file, **found))


@dataclass(frozen=True)
class ComparisonFolder(WorkFolder):
    @classmethod
    def at(cls, path: Path) -> "ComparisonFolder":
        files = (*WRITTEN, *(f"{RUNS}/*/{name}" for name in RUN_FILES), f"{MOTIONS}/*.npz")
        return cls(path, "a comparison", ENVIRONMENT, "settings", files)

    @property
    def begun(self) -> bool:
        """Whether any run has written something."""
        return (self.path / RUNS).is_dir()

    @contextmanager
    def opened(self, settings: Mapping[str, Any], *, resume: bool, overwrite: bool) -> Iterator[None]:
        """Prepares the folder before long work begins; restores it if no run finishes. `settings` must equal those of
        `environment.json` to resume. Raises `ConfigError` for both `resume` and `overwrite`, `OutputError` if the
        folder holds other files or cannot be written."""
        new = not self.found()
        self.check(settings, resume=resume, overwrite=overwrite)
        with created(self.path):
            try:
                yield
            except BaseException:
                if new and not self.begun:
                    self.clear()
                raise

    def begin(self, environment: Mapping[str, Any], *, overwrite: bool) -> None:
        """Writes `environment.json`; with `overwrite`, removes the comparison in the folder first. Motions of an
        earlier `environment.json` keep their places. Raises `OutputError` if a file cannot be removed or written."""
        if overwrite:
            self.clear()
        motions = [*(name for name in self.motions() if name in environment["motions"]), *environment["motions"]]
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
            kind = (bool(row["variant"]), METHODS[row["method"]].optimises, row["seed"])
            return (*kind, motions.index(row["motion"]), methods.index(row["method"]), variants.index(row["variant"]))

        return sorted(rows, key=place)
