"""`fastmimic transfer`: what motions are worth on a robot that they were not optimised on."""

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

from tyro.conf import Positional, arg

from fastmimic.base.errors import ConfigError
from fastmimic.commands.console import FIRST_USE, note, optimisation_progress, put, slow_start
from fastmimic.commands.options import ExperimentOptions, check_duration, policy_with_digest
from fastmimic.motion.motion import Motion
from fastmimic.robot import Robot

if TYPE_CHECKING:
    from fastmimic.episode.rollout import MakeController
    from fastmimic.experiments.transfer import TransferSettings

OUT: Final = Path("runs/transfer")


@dataclass(frozen=True, kw_only=True)
class Transfer(ExperimentOptions):
    """Optimises motions in MuJoCo with the truth, then runs them unchanged on robots that differ more and more.

    (a) MuJoCo with sensors and an estimator; (b) PyBullet with the truth; (c) PyBullet with sensors, an estimator,
    motors with delay, friction and a torque-speed curve, and friction 0.6. Writes results.csv, table.md and
    transfer.png. The trials of each motion and method are kept: after Ctrl-C, --resume does the rest.
    """

    motions: Annotated[Positional[tuple[str, ...]], arg(metavar="MOTION ...")]
    """Robot motions (.npz), which are run as they are if they are optimised, clips, names of
    'fastmimic motions', or folders of runs."""
    methods: Annotated[tuple[str, ...], arg(metavar="METHOD ...")] = ("mbc", "mbc-dmp")
    """Which methods."""
    trials: int = 3
    """Of each motion and method in each of the conditions."""
    duration: Annotated[float, arg(metavar="S")] = 10.0
    """Length of each."""
    identify: bool = False
    """Run (c) once more with friction and payload identified from one run there, as one would on a robot."""
    out: Annotated[Path, arg(metavar="FOLDER")] = OUT
    """Where everything goes. A folder with trials is refused unless --resume or --overwrite."""

    def run(self) -> int:
        """Runs it, and writes the folder; returns the exit status."""
        check_duration(self.duration)
        from fastmimic.experiments.subject import check_methods
        from fastmimic.experiments.transfer import PARTS, TransferSettings
        from fastmimic.report.result_folder import ResultFolder
        from fastmimic.report.transfer_figures import WRITTEN, write_transfer
        from fastmimic.simulation.simulators import check_simulator

        if not self.motions:
            raise ConfigError("give at least one motion, such as dog:right-turn")
        if self.policy is not None and len(self.motions) > 1:
            raise ConfigError("a policy is for one motion; run the motions one after another")
        check_methods(self.methods, self.policy is not None)
        settings = TransferSettings(
            self.trials, self.duration, self.seed, self.config, self.iterations, self.population, self.identify
        )
        loaded = [self.load(source) for source in self.motions]
        names = [motion.name for _, motion in loaded]
        if len(set(names)) < len(names):
            raise ConfigError(f"two of the motions have one name: {', '.join(names)}")
        robots = {robot.name: robot for robot, _ in loaded}
        if len(robots) > 1:
            raise ConfigError(f"the motions are for different robots: {', '.join(robots)}")
        check_simulator(loaded[0][0], "pybullet")
        policy = None if self.policy is None else policy_with_digest(self.policy, *loaded[0])
        about = {"robot": loaded[0][0].name, **asdict(settings)}
        folder = ResultFolder(self.out, "transfer", PARTS, WRITTEN, about)
        folder.open(resume=self.resume, overwrite=self.overwrite)
        planned = [(name, method) for name in names for method in self.methods]
        try:
            for robot, motion in loaded:
                for method in self.methods:
                    self._one(method, motion, robot, settings, policy)
        except KeyboardInterrupt:
            write_transfer(folder, planned)
            note("what is finished is kept; the same command with --resume goes on")
            raise
        write_transfer(folder, planned)
        put(folder.table())
        put(f"results in {self.out}")
        return 0

    def _one(
        self,
        method: str,
        motion: Motion,
        robot: Robot,
        settings: "TransferSettings",
        policy: "tuple[MakeController, str] | None",
    ) -> None:
        """The trials of a method on a motion, unless they are there."""
        from fastmimic.experiments.parts import load_part, save_part
        from fastmimic.experiments.subject import MOTIONS, make_subject
        from fastmimic.experiments.transfer import part_file, run_trials

        with optimisation_progress() as progress:
            subject = make_subject(
                method, motion, robot, self.search(), self.out / MOTIONS, policy=policy, progress=progress
            )
        path = part_file(self.out, motion.name, method)
        if load_part(path, subject.digest) is None:
            with slow_start(f"{motion.name}, {method}: running; {FIRST_USE}"):
                save_part(path, run_trials(subject, robot, settings), subject.digest)
        note(f"{motion.name}, {method}: done")
