"""`fastmimic imitate`: from a motion to one that the robot can execute."""

import dataclasses
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tyro.conf import Positional

from fastmimic.base.errors import ConfigError
from fastmimic.commands import options as opt
from fastmimic.commands.console import note, optimisation_progress
from fastmimic.commands.search_run import SearchRun
from fastmimic.commands.show import note_origin, put_result, unmet_bounds, write_run
from fastmimic.motion.motion import Motion
from fastmimic.robot import Robot

if TYPE_CHECKING:  # loads the compiler
    from fastmimic.imitation.imitate import Imitation
    from fastmimic.runs.work_folder import RunFolder


@dataclass(frozen=True, kw_only=True)
class Imitate(SearchRun):
    """Turns a motion into one that the robot can execute: retargets it, fits DMPs, and optimises them in closed-loop
    simulation.

    Writes motion.npz, metrics.json, config.json, convergence.png, tracking.png and video.mp4. Ctrl-C stops the search
    and keeps the best motion so far.
    """

    motion: Annotated[Positional[str], opt.option("MOTION")]
    """A name from 'fastmimic motions', a file, or the folder of a run."""
    duration: Annotated[float, opt.option("S")] = 5.0
    """Length of an episode."""
    warm_start: Annotated[Path | None, opt.option("FILE.npz")] = None
    """Start the search from the parameters of an optimised motion."""
    no_optimize: opt.Flag = False
    """Run the method without its search: mbc for mbc-dmp, lh for lh-dmp."""
    search: opt.Searching
    clip: opt.ClipReading

    def run(self) -> int:
        """Runs the search and writes the folder; returns the exit status."""
        opt.check_duration(self.duration)
        video = self.video.wanted
        method = self._method()
        began = time.perf_counter()
        robot, motion = self.clip.load(self.motion, self.robot)
        loading_s = time.perf_counter() - began
        about = {
            "motion": motion.name,
            "source": motion.provenance.source,
            "licence": motion.provenance.licence,
        }
        with self.opened(robot, motion.name, method, **about) as (folder, config):
            note_origin(robot, motion)
            for sentence in unmet_bounds(motion):
                note(f"retargeting: {sentence}")
            result = self._imitate(robot, motion, method, folder)
            result = dataclasses.replace(result, wall_s=result.wall_s + loading_s)
            write_run(result, folder, config)
        return put_result(result, folder, self.search.iterations, video=video)

    def _method(self) -> str:
        """Name of the method that runs; raises `ConfigError` if the options do not fit it."""
        from fastmimic.imitation.methods import check_controller, method_named
        from fastmimic.optimize.parameters import moved_by

        method = self.method
        if self.no_optimize:
            method = method_named(method).unoptimised.name
        check_controller(method_named(method), False)
        self.check_search(method)
        if self.warm_start is not None:
            if not method_named(method).optimises:
                raise ConfigError(f"method '{method}' does not search, so --warm-start has no effect; drop it")
            moved_by(Motion.load(self.warm_start))
        return method

    def _imitate(self, robot: Robot, motion: Motion, method: str, folder: "RunFolder") -> "Imitation":
        from fastmimic.imitation.imitate import imitate

        with optimisation_progress() as progress:
            return imitate(
                motion,
                robot,
                method=method,
                config=self.config,
                duration_s=self.duration,
                iterations=self.search.iterations,
                population=self.search.population,
                seed=self.seed,
                workers=self.workers,
                checkpoint=folder.checkpoint,
                resume=self.folder.resume,
                progress=progress,
                randomize=self.randomization.chosen(),
                choice=self.choice,
                warm_start=self.warm_start,
            )
