"""`fastmimic stress`: measures how much of each disturbance a motion tolerates under several methods."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

from tyro.conf import Positional

from fastmimic.commands import options as opt
from fastmimic.commands.console import FIRST_USE, note, share_progress, slow_start
from fastmimic.robot import Robot

if TYPE_CHECKING:  # loads the compiler
    from fastmimic.experiments.stress import StressSettings
    from fastmimic.experiments.subject import Subject

OUT: Final = Path("runs/stress")


@dataclass(frozen=True, kw_only=True)
class Stress(opt.ExperimentOptions):
    """Runs a motion over a range of each disturbance and measures how much it tolerates.

    A method that optimises does so first, without disturbance; an optimised motion is not re-optimised. Writes
    results.csv, table.md, success.png and reward.png. Each finished sweep (one method, one disturbance) is kept: after
    Ctrl-C, --resume runs the others, also with more methods or disturbances.
    """

    motion: Annotated[Positional[str], opt.option("MOTION")]
    """A robot motion (.npz), a clip, a name from 'fastmimic motions', or the folder of a run."""
    methods: Annotated[tuple[str, ...], opt.option("METHOD ...")] = ("mbc", "mbc-dmp", "raibert")
    """Methods to run."""
    disturbances: Annotated[
        tuple[str, ...] | None, opt.option("NAME ...", lambda: f"Disturbances: {opt.disturbances()}. Default: all.")
    ] = None
    episodes: int = 20
    """Episodes at each level: the first starts at the motion's start, the others at random phases."""
    duration: Annotated[float, opt.option("S")] = 6.0
    """Length of an episode."""
    simulator: opt.Simulator = "mujoco"
    observe: opt.Observation = "truth"
    out: Annotated[Path, opt.option("FOLDER")] = OUT
    """Folder of the results. One with results needs --resume or --overwrite."""

    def run(self) -> int:
        """Runs the sweeps and writes the folder; returns the exit status."""
        opt.check_duration(self.duration)
        from fastmimic.experiments.results import open_results
        from fastmimic.experiments.stress import SWEEPS, StressSettings, check_length, disturbances_of
        from fastmimic.experiments.subject import check_methods
        from fastmimic.report.experiment_figures import STRESS_FILES, write_stress
        from fastmimic.simulation.simulators import check_simulator

        check_methods(self.methods, self.policy is not None)
        names = disturbances_of(self.disturbances, self.simulator)
        robot, motion = self.clip.load(self.motion, self.robot)
        settings = StressSettings(
            robot=robot.name,
            simulator=self.simulator,
            observe=self.observe,
            episodes=self.episodes,
            duration_s=self.duration,
            seed=self.seed,
            config=self.config,
            iterations=self.search.iterations,
            population=self.search.population,
        )
        policy = opt.policy_with_digest(self.policy, robot, motion)
        check_length(motion, names, settings)
        check_simulator(robot, self.simulator)
        about = {"motion": motion.name, **asdict(settings)}
        resume, overwrite = self.folder.resume, self.folder.overwrite
        folder = open_results(self.out, "stress", SWEEPS, STRESS_FILES, about, resume=resume, overwrite=overwrite)
        planned = [(method, name) for method in self.methods for name in names]
        with self.writing(folder, lambda: write_stress(folder, settings, planned)):
            for k, method in enumerate(self.methods):
                subject = self.subject(method, motion, robot, policy)
                self._sweeps(subject, names, robot, settings, k * len(names), len(planned))
        return 0

    def _sweeps(
        self,
        subject: "Subject",
        names: Sequence[str],
        robot: Robot,
        settings: "StressSettings",
        done: int,
        total: int,
    ) -> None:
        """Runs the sweeps of one method that are not finished yet."""
        from fastmimic.experiments.results import load_part, save_part
        from fastmimic.experiments.stress import sweep, sweep_file

        with share_progress("sweeps") as bar, slow_start(f"{subject.method.name}: first sweep; {FIRST_USE}"):
            for k, name in enumerate(names, done + 1):
                path = sweep_file(self.out, subject.method.name, name)
                if load_part(path, subject.digest) is None:
                    save_part(path, sweep(subject, name, robot, settings), subject.digest)
                if bar is not None:
                    bar(k / total, f"{subject.method.name}, {name}")
                else:
                    note(f"{k}/{total} {subject.method.name}, {name}")
