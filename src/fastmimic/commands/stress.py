"""`fastmimic stress`: how much of each disturbance a motion withstands under several methods."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

from tyro.conf import Positional, arg

from fastmimic.commands.console import FIRST_USE, note, optimisation_progress, put, share_progress, slow_start
from fastmimic.commands.options import ExperimentOptions, check_duration, policy_with_digest
from fastmimic.robot import Robot

if TYPE_CHECKING:
    from fastmimic.experiments.stress import StressSettings
    from fastmimic.experiments.subject import Subject

OUT: Final = Path("runs/stress")


@dataclass(frozen=True, kw_only=True)
class Stress(ExperimentOptions):
    """Runs a motion over the range of each disturbance, and says what it withstands.

    A method that optimises does so first, undisturbed; a motion that is optimised already is run as it is. Writes
    results.csv, table.md, success.png and reward.png. Each finished sweep, one method under one disturbance, is kept:
    after Ctrl-C, --resume does the rest, and may be given more methods or disturbances.
    """

    motion: Annotated[Positional[str], arg(metavar="MOTION")]
    """A robot motion (.npz), a clip, a name of 'fastmimic motions', or the folder of a run."""
    methods: Annotated[tuple[str, ...], arg(metavar="METHOD ...")] = ("mbc", "mbc-dmp", "raibert")
    """Which methods."""
    disturbances: Annotated[tuple[str, ...] | None, arg(metavar="NAME ...")] = None
    """Which disturbances; by default all. An unknown NAME lists them."""
    episodes: int = 20
    """Of each level of a disturbance: one from the motion's start, the others from random phases of it."""
    duration: Annotated[float, arg(metavar="S")] = 6.0
    """Length of each."""
    simulator: Annotated[str, arg(metavar="mujoco|pybullet")] = "mujoco"
    """Where the robot is; PyBullet is some ten times slower."""
    observe: Annotated[str, arg(metavar="truth|sensors")] = "truth"
    """What the controller sees."""
    out: Annotated[Path, arg(metavar="FOLDER")] = OUT
    """Where everything goes. A folder with sweeps is refused unless --resume or --overwrite."""

    def run(self) -> int:
        """Runs it, and writes the folder; returns the exit status."""
        check_duration(self.duration)
        from fastmimic.experiments.stress import SWEEPS, StressSettings, check_length, disturbances_of
        from fastmimic.experiments.subject import MOTIONS, check_methods, make_subject
        from fastmimic.report.result_folder import ResultFolder
        from fastmimic.report.stress_figures import WRITTEN, write_stress
        from fastmimic.simulation.simulators import check_simulator

        check_methods(self.methods, self.policy is not None)
        names = disturbances_of(self.disturbances, self.simulator)
        robot, motion = self.load(self.motion)
        settings = StressSettings(
            robot=robot.name,
            simulator=self.simulator,
            observe=self.observe,
            episodes=self.episodes,
            duration_s=self.duration,
            seed=self.seed,
            config=self.config,
            iterations=self.iterations,
            population=self.population,
        )
        policy = None if self.policy is None else policy_with_digest(self.policy, robot, motion)
        check_length(motion, names, settings)
        check_simulator(robot, self.simulator)
        about = {"motion": motion.name, **asdict(settings)}
        folder = ResultFolder(self.out, "stress", SWEEPS, WRITTEN, about)
        folder.open(resume=self.resume, overwrite=self.overwrite)
        planned = [(method, name) for method in self.methods for name in names]
        try:
            for k, method in enumerate(self.methods):
                with optimisation_progress() as progress:
                    subject = make_subject(
                        method, motion, robot, self.search(), self.out / MOTIONS, policy=policy, progress=progress
                    )
                self._sweeps(subject, names, robot, settings, k * len(names), len(planned))
        except KeyboardInterrupt:
            write_stress(folder, settings, planned)
            note("what is finished is kept; the same command with --resume goes on")
            raise
        write_stress(folder, settings, planned)
        put(folder.table())
        put(f"results in {self.out}")
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
        """The sweeps of one method that are not there yet."""
        from fastmimic.experiments.parts import load_part, save_part
        from fastmimic.experiments.stress import sweep, sweep_file

        with share_progress("sweeps") as bar, slow_start(f"{subject.method.name}: the first sweep runs; {FIRST_USE}"):
            for k, name in enumerate(names, done + 1):
                path = sweep_file(self.out, subject.method.name, name)
                if load_part(path, subject.digest) is None:
                    save_part(path, sweep(subject, name, robot, settings), subject.digest)
                if bar is not None:
                    bar(k / total, f"{subject.method.name}, {name}")
                else:
                    note(f"{k}/{total} {subject.method.name}, {name}")
