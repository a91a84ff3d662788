"""`fastmimic imitate`: the whole way from a motion to a motion that the robot can execute."""

import dataclasses
import re
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

from tyro.conf import Positional, arg

from fastmimic.base.errors import ConfigError
from fastmimic.commands.console import note, optimisation_progress
from fastmimic.commands.options import MotionOptions, RandomizeOptions, check_duration
from fastmimic.commands.outcome import about, report
from fastmimic.motion.motion import Motion
from fastmimic.robot import Robot

if TYPE_CHECKING:
    from fastmimic.imitation.imitate import Imitation
    from fastmimic.report.run_folder import RunFolder

RUNS: Final = Path("runs")
_NOT_THE_PROBLEM: Final = ("workers", "out", "resume", "overwrite", "no_video", "quality")
"""Arguments that change where and how a run happens, not what comes out."""


@dataclass(frozen=True, kw_only=True)
class Imitate(MotionOptions, RandomizeOptions):
    """Turns a motion into one that the robot can execute: retargets it, fits DMPs, and optimises them with
    the robot and its controller in the loop.

    Writes motion.npz, metrics.json, config.json, convergence.png, tracking.png and video.mp4. Ctrl-C stops
    the search and keeps the best motion so far.
    """

    motion: Annotated[Positional[str], arg(metavar="MOTION")]
    """A name of 'fastmimic motions', a file, or the folder of a run."""
    method: Annotated[str, arg(metavar="NAME")] = "mbc-dmp"
    """mbc-dmp, lh-dmp: the motion's DMPs are optimised; mbc, lh: not; raibert: feet step by a rule. lh looks ahead."""
    config: Annotated[str, arg(metavar="default|robust|paper|FILE")] = "default"
    """The controller's parameters: ours, ours for another robot than the model, or the paper's form."""
    duration: Annotated[float, arg(metavar="S")] = 5.0
    """Length of an episode."""
    iterations: int = 200
    """Generations of CMA-ES."""
    population: int = 10
    """Candidates in each."""
    seed: int = 0
    """Of the optimiser. The same seed gives the same result, whatever the number of workers."""
    warm_start: Annotated[Path | None, arg(metavar="FILE.npz")] = None
    """Begin the search like an optimised motion, such as one of another speed."""
    workers: Annotated[int | None, arg(metavar="INT")] = None
    """Threads; by default one for each core."""
    out: Annotated[Path | None, arg(metavar="FOLDER")] = None
    """By default runs/MOTION-ROBOT-METHOD-SEED, numbered if taken. A folder with another run is refused."""
    resume: bool = False
    """Go on from the checkpoint in the folder (by default the last of its name)."""
    overwrite: bool = False
    """Replace a run of other arguments."""
    no_optimize: bool = False
    """The method without its optimisation: mbc for mbc-dmp, lh for lh-dmp."""
    no_video: bool = False
    """Leave out the video."""
    quality: Annotated[str, arg(metavar="preview|high")] = "preview"
    """Of the video: quick, or with shadows, reflections and smooth edges."""

    def run(self) -> int:
        """Runs it, and writes the folder; returns the exit status."""
        check_duration(self.duration)
        from fastmimic.imitation.methods import check_controller, method_named
        from fastmimic.motion.motion import Motion
        from fastmimic.optimize.parameters import moved_by
        from fastmimic.render.quality import quality_named
        from fastmimic.report.run_folder import default_folder, open_run

        quality_named(self.quality)
        method = self.method
        if self.no_optimize:  # the method's own controller, on the motion as it is
            method = method_named(method).name.removesuffix("-dmp")
        check_controller(method_named(method), False)
        if not method_named(method).optimises and self.resume:
            raise ConfigError("--resume goes on with an optimisation; without one there is nothing to resume")
        if self.randomization() is not None and not method_named(method).optimises:
            raise ConfigError(f"--randomize is of a search, and method '{method}' has none; leave it out")
        if self.warm_start is not None:
            if not method_named(method).optimises:
                raise ConfigError(f"--warm-start is of a search, and method '{method}' has none; leave it out")
            moved_by(Motion.load(self.warm_start))
        began = time.perf_counter()
        robot, motion = self.load(self.motion)
        loading_s = time.perf_counter() - began
        name = re.sub(r"[^\w.-]+", "-", f"{motion.name}-{robot.name}-{method}-{self.seed}")
        out = self.out or default_folder(RUNS, name, resume=self.resume)
        config = self._record(robot, motion, method)
        same = {k: v for k, v in config["arguments"].items() if k not in _NOT_THE_PROBLEM}
        with open_run(out, config, same, resume=self.resume, overwrite=self.overwrite) as folder:
            for line in about(robot, motion):
                note(line)
            if folder.finished and not self.resume:
                note(f"replacing the run in {out}")
            result = self._imitate(robot, motion, method, folder)
            result = dataclasses.replace(result, wall_s=result.wall_s + loading_s)
            folder.write(result, config)
        return report(result, folder, self.iterations, video=None if self.no_video else self.quality)

    def _imitate(self, robot: Robot, motion: Motion, method: str, folder: "RunFolder") -> "Imitation":
        from fastmimic.imitation.imitate import imitate

        try:
            with optimisation_progress() as progress:
                return imitate(
                    motion,
                    robot,
                    method=method,
                    config=self.config,
                    duration_s=self.duration,
                    iterations=self.iterations,
                    population=self.population,
                    seed=self.seed,
                    workers=self.workers,
                    checkpoint=folder.checkpoint,
                    resume=self.resume,
                    progress=progress,
                    randomize=self.randomization(),
                    warm_start=self.warm_start,
                )
        except KeyboardInterrupt:
            if folder.checkpoint.exists():
                note(f"to go on from the checkpoint: the same command with --out {folder.path} --resume")
            raise

    def _record(self, robot: Robot, motion: Motion, method: str) -> dict[str, Any]:
        """Everything that the run depends on, JSON-serialisable."""
        from fastmimic.control.config import controller_config
        from fastmimic.imitation.imitate import versions
        from fastmimic.imitation.methods import method_named

        arguments = {k: str(v) if isinstance(v, Path) else v for k, v in dataclasses.asdict(self).items()}
        arguments = self.recorded(arguments)
        arguments.pop("no_optimize")
        arguments["discrete"] = self.discrete or None  # as in the runs from before there was a choice
        return {
            "arguments": arguments | {"method": method},
            "robot": robot.name,
            "motion": motion.name,
            "source": motion.meta.get("source"),
            "licence": motion.meta.get("licence"),
            "controller": method_named(method).configure(controller_config(self.config)).as_dict(),
            "versions": versions(),
        }
