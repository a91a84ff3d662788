"""`fastmimic transfer`: runs motions without change on robots that differ from the one they were optimised on."""

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

from tyro.conf import Positional

from fastmimic.base.errors import ConfigError
from fastmimic.commands import options as opt
from fastmimic.commands.console import FIRST_USE, note, slow_start

if TYPE_CHECKING:  # loads the compiler
    pass

OUT: Final = Path("runs/transfer")


@dataclass(frozen=True, kw_only=True)
class Transfer(opt.ExperimentOptions):
    """Optimises motions in MuJoCo with the true state, then runs them without change under conditions that differ more
    and more.

    (a) MuJoCo with sensors and an estimator; (b) PyBullet with the true state; (c) PyBullet with sensors, an estimator,
    motors with delay, friction and a torque-speed curve, and ground friction 0.6. Writes results.csv, table.md and
    transfer.png. The trials of each motion and method are kept: after Ctrl-C, --resume runs the others.
    """

    motions: Annotated[Positional[tuple[str, ...]], opt.option("MOTION ...")]
    """Robot motions (.npz; optimised ones are not re-optimised), clips, names from 'fastmimic motions', or folders of
    runs."""
    methods: Annotated[tuple[str, ...], opt.option("METHOD ...")] = ("mbc", "mbc-dmp")
    """Methods to run."""
    trials: int = 3
    """Trials of each motion and method under each condition."""
    duration: Annotated[float, opt.option("S")] = 10.0
    """Length of a trial."""
    identify: opt.Flag = False
    """Run (c) again with friction and payload identified from one run there, as on a real robot."""
    out: Annotated[Path, opt.option("FOLDER")] = OUT
    """Folder of the results. One with results needs --resume or --overwrite."""

    def run(self) -> int:
        """Runs the trials and writes the folder; returns the exit status."""
        opt.check_duration(self.duration)
        from fastmimic.experiments.results import load_part, open_results, save_part
        from fastmimic.experiments.subject import check_methods
        from fastmimic.experiments.transfer import PARTS, TransferSettings, part_file, run_trials
        from fastmimic.report.experiment_figures import TRANSFER_FILES, write_transfer
        from fastmimic.simulation.simulators import SECOND_SIMULATOR, check_simulator

        if not self.motions:
            raise ConfigError("give at least one motion, such as dog:right-turn")
        if self.policy is not None and len(self.motions) > 1:
            raise ConfigError("a policy is for one motion; run the motions one after another")
        check_methods(self.methods, self.policy is not None)
        search = self.search
        settings = TransferSettings(
            self.trials, self.duration, self.seed, self.config, search.iterations, search.population, self.identify
        )
        loaded = [self.clip.load(source, self.robot) for source in self.motions]
        names = [motion.name for _, motion in loaded]
        if len(set(names)) < len(names):
            raise ConfigError(f"two motions have the same name: {', '.join(names)}")
        robots = {robot.name: robot for robot, _ in loaded}
        if len(robots) > 1:
            raise ConfigError(f"the motions are for different robots: {', '.join(robots)}")
        check_simulator(loaded[0][0], SECOND_SIMULATOR)
        policy = opt.policy_with_digest(self.policy, *loaded[0])
        about = {"robot": loaded[0][0].name, **asdict(settings)}
        resume, overwrite = self.folder.resume, self.folder.overwrite
        folder = open_results(self.out, "transfer", PARTS, TRANSFER_FILES, about, resume=resume, overwrite=overwrite)
        planned = [(name, method) for name in names for method in self.methods]
        with self.writing(folder, lambda: write_transfer(folder, planned)):
            for robot, motion in loaded:
                for method in self.methods:
                    subject = self.subject(method, motion, robot, policy)
                    path = part_file(self.out, motion.name, method)
                    if load_part(path, subject.digest) is None:
                        with slow_start(f"{motion.name}, {method}: running; {FIRST_USE}"):
                            save_part(path, run_trials(subject, robot, settings), subject.digest)
                    note(f"{motion.name}, {method}: done")
        return 0
