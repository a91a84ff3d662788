"""The comparison: the list of runs, their inputs, and their rows.

Runs go to all cores, one single-threaded process for each. With more runs than cores this is faster than the threads of
`imitate`, which wait for the slowest of them in every iteration, share one interpreter, and run fitting, logged
episodes and CMA-ES on one thread. Runs share nothing, so the rows do not depend on the number of processes.
`benchmarks/comparison.py --scaling` measures both ways.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from fastmimic.base.errors import ConfigError, OutputError
from fastmimic.clips.catalogue import open_clip
from fastmimic.clips.formats import detect_format
from fastmimic.control.config import controller_config
from fastmimic.executors.local import LocalExecutor
from fastmimic.experiments import comparison_run as compared
from fastmimic.experiments.ablations import ABLATED, ablation_named, ablations_of
from fastmimic.experiments.comparison_run import RUNS, ComparisonSettings, Row, Run, RunTask, finished_row
from fastmimic.imitation.methods import METHODS, PAPER_METHODS, RL
from fastmimic.learning.policy import POLICY_FILE, Policy, policy_for
from fastmimic.motion.motion import Motion
from fastmimic.optimize.cma_es import CmaSettings
from fastmimic.optimize.problem import Objective
from fastmimic.retargeting.config import RetargetConfig
from fastmimic.retargeting.retarget import retarget
from fastmimic.robot import Robot, load_robot
from fastmimic.runs.loading import load_motion
from fastmimic.runs.work_folder import MOTIONS

PAPER_MOTIONS: Final = ("dog:trot", "dog:pace", "dog:right-turn", "anim:side-steps")
"""The public ones among the paper's motions."""
BUILT_IN_MOTIONS: Final = ("trot", "pace", "turn", "side-step")


@dataclass(frozen=True)
class ComparisonPlan:
    """All runs of a comparison, in order of execution."""

    settings: ComparisonSettings
    motions: tuple[str, ...]  # names, or files
    methods: tuple[str, ...]
    seeds: int  # number of seeds of the methods that optimise
    ablations: bool  # whether to run the variants of `ABLATED` as well
    policies: Mapping[Run, Path] = field(default_factory=dict)  # files of the learned method; see `choose_policies`

    def __post_init__(self) -> None:
        if not self.motions:
            raise ConfigError("a comparison needs at least one motion")
        if not self.methods:
            raise ConfigError(f"a comparison needs at least one method; there are {', '.join(PAPER_METHODS)}")
        if self.seeds < 1:
            raise ConfigError(f"seeds must be at least 1, found {self.seeds}")
        for name in self.methods:
            _ = METHODS[name]
        if RL in self.methods and not self.policies:
            needs = f"method '{RL}' needs a trained policy for each motion"
            raise ConfigError(f"{needs}: --policy FILE or FOLDER ...; 'fastmimic train' makes one")
        if self.policies and RL not in self.methods:
            raise ConfigError(f"policies are for the method '{RL}', which is not among {', '.join(self.methods)}")
        compared.check_unique("motion", [_stem(motion) for motion in self.motions])
        compared.check_unique("method", self.methods)
        controller_config(self.settings.config)
        CmaSettings(self.settings.iterations, self.settings.population)
        Objective(self.settings.duration_s)

    @property
    def variants(self) -> tuple[str, ...]:
        if not self.ablations:
            return ()
        return tuple(ablation.name for ablation in ablations_of(controller_config(self.settings.config)))

    @property
    def runs(self) -> list[Run]:
        """Fast runs first, then seed by seed, so that an unfinished one covers all. Ablations include their method."""
        methods = [*self.methods, *([ABLATED] if self.ablations and ABLATED not in self.methods else [])]
        optimising = [name for name in methods if METHODS[name].optimises]
        once = [name for name in methods if name not in optimising and name != RL]
        runs = [Run(motion, name, "", 0) for motion in self.motions for name in once]
        runs += self.policies
        for seed in range(self.seeds):
            runs += [Run(motion, name, "", seed) for motion in self.motions for name in optimising]
        for seed in range(self.seeds):
            runs += [Run(motion, ABLATED, variant, seed) for motion in self.motions for variant in self.variants]
        return runs


ReportProgress = Callable[[float, Row | None], None]
"""Takes the finished share of the simulated time, in [0, 1], after each iteration, and the row of each finished run."""


@dataclass(frozen=True, eq=False)
class Prepared:
    """A plan with all its inputs, loaded and checked; nothing is written yet."""

    plan: ComparisonPlan
    out: Path  # folder of motions and runs
    files: Mapping[Path, Motion]  # the motions to write
    tasks: tuple[RunTask, ...]
    found: Mapping[Run, Row]  # rows of the runs of the same settings that were finished before

    @property
    def kept(self) -> tuple[Row, ...]:
        """Rows of finished runs that are not the plan's."""
        return tuple(row for run, row in self.found.items() if run not in self.plan.runs)

    def perform(self, workers: int, report: ReportProgress) -> list[Row]:
        """Performs the remaining runs, one worker's in this process; returns the rows of all runs of the plan, in its
        order. Raises `FastMimicError` as the first failed run, and stops the others, `KeyboardInterrupt` for Ctrl-C;
        finished runs and checkpoints stay in the folder."""
        for path, motion in self.files.items():
            motion.save(path)
        tasks, rows = self.tasks, dict(self.found)
        done_s: dict[int, float] = {}
        total_s = sum(task.simulated_s for task in tasks)

        def progress(index: int, share: float, row: Row | None = None) -> None:
            done_s[index] = share * tasks[index].simulated_s
            report(min(1.0, sum(done_s.values()) / total_s), row)

        executor = LocalExecutor(max(1, min(workers, len(tasks))))
        with closing(executor.run(compared.perform, tasks, progress)) as outcomes:
            for outcome in outcomes:
                if outcome.error is not None:
                    raise outcome.error
                rows[tasks[outcome.index].run] = outcome.result
                progress(outcome.index, 1.0, outcome.result)
        return [rows[run] for run in self.plan.runs]

    def finished(self) -> list[Row]:
        """Rows of all runs that are finished now."""
        now = (finished_row(task.folder) for task in self.tasks)
        return [*self.found.values(), *(row for row in now if row is not None)]


def prepare(plan: ComparisonPlan, out: Path, *, keep: bool, prepared: Callable[[str], None]) -> Prepared:
    """Loads robot and motions, and checks them and the finished runs in the folder `out`; writes nothing. With `keep`,
    finished runs in the folder count; otherwise they are about to be replaced. Calls `prepared` with the name of each
    retargeted motion. Raises `FastMimicError` for a missing robot or motion, or a finished run of other content."""
    robot = load_robot(plan.settings.robot)
    files = {_file(out, *key): motion for key, motion in _demonstrations(plan, robot, prepared)}
    policies = {
        run: policy_for(file, robot, files[_file(out, run.motion, consistent=True)])
        for run, file in plan.policies.items()
    }
    rows = compared.finished_rows(out) if keep else {}
    # copies, which have other names, do not count
    found = {run: row for name, row in rows.items() if (run := compared.run_of(row)).folder == name}
    known = dict(files)
    for run, row in found.items():
        path = _motion_file(out, run)
        if path not in known:
            known[path] = Motion.load(path)
        if run.method == RL and run not in policies:
            policies[run] = policy_for(out / RUNS / run.folder / POLICY_FILE, robot, known[path])
        if row.get("digest") != compared.digest(run, plan.settings, robot, known[path], policies.get(run)):
            other = f"another {'policy' if run in policies else 'controller'}, motion or robot than this installation's"
            said = f"{out / RUNS / run.folder}: a finished run of {other}"
            raise OutputError(f"{said}; choose another --out, or --overwrite it")
    tasks = (
        RunTask(run, plan.settings, _motion_file(out, run), out / RUNS / run.folder, plan.policies.get(run))
        for run in plan.runs
        if run not in found
    )
    return Prepared(plan, out, files, tuple(tasks), found)


def choose_policies(places: Sequence[Path], motions: Sequence[str]) -> dict[Run, Path]:
    """The policies' runs and files for each motion, in the order of the motions and of the training seeds. `places` are
    policy files, and folders to search at any depth, in which policies for other motions are ignored. Raises
    `PolicyError` for a file without a policy, `ConfigError` for a motion without a policy, a file for another motion,
    or two policies for one motion and seed."""
    files: dict[Path, bool] = {}  # whether the caller named it
    for place in places:
        files.update(dict.fromkeys(sorted(place.rglob(POLICY_FILE)), False) if place.is_dir() else {place: True})
    names = {_own_name(motion): motion for motion in motions}
    found: dict[Run, Path] = {}
    for file, named in files.items():
        policy = Policy.load(file)
        if policy.motion not in names:
            if named:
                raise ConfigError(f"{file}: a policy for '{policy.motion}', not among {', '.join(motions)}")
            continue
        run = Run(names[policy.motion], RL, "", policy.seed)
        if run in found and Policy.load(found[run]).digest == policy.digest:
            continue  # a copy
        if run in found:
            raise ConfigError(f"{found[run]} and {file}: two policies for '{run.motion}', both of seed {run.seed}")
        found[run] = file
    missing = [motion for motion in motions if all(run.motion != motion for run in found)]
    if missing:
        said = f"no policy for {', '.join(missing)} in {', '.join(str(p) for p in places)}"
        raise ConfigError(f"{said}; 'fastmimic train' makes one, or leave the motion out with --motions")
    return {run: found[run] for run in sorted(found, key=lambda run: (motions.index(run.motion), run.seed))}


def _own_name(motion: str) -> str:
    path = Path(motion)
    if not path.is_file():
        return motion
    return Motion.load(path).name if detect_format(path) == "npz" else path.stem


def _stem(name: str) -> str:
    return compared.slug(name).removesuffix(".npz")


def _file(out: Path, name: str, consistent: bool) -> Path:
    return out / MOTIONS / f"{_stem(name)}{'' if consistent else '-raw'}.npz"


def _motion_file(out: Path, run: Run) -> Path:
    return _file(out, run.motion, ablation_named(run.variant).consistent)


def _demonstrations(
    plan: ComparisonPlan, robot: Robot, prepared: Callable[[str], None]
) -> Iterator[tuple[tuple[str, bool], Motion]]:
    """Every motion; with ablations also without the consistency step."""
    raw = any(not ablation_named(name).consistent for name in plan.variants)
    for name in plan.motions:
        yield (name, True), load_motion(name, robot).target
        if raw:
            if Path(name).is_file() and detect_format(name) == "npz":
                raise ConfigError(f"--ablations need the clip: '{name}' is already a robot motion")
            config = RetargetConfig(consistent=False)
            yield (name, False), retarget(open_clip(name, robot=robot), robot, config=config)[0]
        prepared(name)
