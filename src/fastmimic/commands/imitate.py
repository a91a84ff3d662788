"""`fastmimic imitate` and `fastmimic stitch`: turn motions into one that the robot can execute."""

import dataclasses
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

from tyro.conf import Positional

from fastmimic.base.errors import ConfigError
from fastmimic.base.machine import versions
from fastmimic.base.progress import note
from fastmimic.commands import options as opt
from fastmimic.commands.console import put_table
from fastmimic.commands.show import note_origin, put_result, write_run, yes_no
from fastmimic.control.config import controller_config
from fastmimic.executors import check_workers
from fastmimic.imitation.methods import METHODS, check_controller
from fastmimic.motion.motion import Motion
from fastmimic.robot import Robot
from fastmimic.runs.loading import MotionSource, find_motion
from fastmimic.runs.work_folder import MOTION, RunFolder, default_folder, open_run

if TYPE_CHECKING:  # loads the compiler
    from fastmimic.imitation.imitate import Imitation
    from fastmimic.imitation.stitch import Stitching
    from fastmimic.optimize.cma_es import Progress

_NOT_THE_PROBLEM: Final = ("workers", "out", "resume", "overwrite", "no_video", "quality")
"""Arguments that change where and how a run happens, but not its result."""


@opt.command
class SearchRun:
    """The options of a search and of the folder that it writes."""

    robot: opt.RobotChoice = None
    method: opt.MethodName = "mbc-dmp"
    config: opt.ConfigName = "default"
    seed: int = 0
    workers: opt.Workers = None
    out: Annotated[Path | None, opt.option("FOLDER")] = None
    folder: opt.Folder
    video: opt.Video

    def check_search(self, method: str) -> None:
        """Raises `ConfigError` for options that a method without a search does not take."""
        if not METHODS[method].optimises and self.folder.resume:
            raise ConfigError(f"method '{method}' does not search, so there is nothing to resume; drop --resume")

    @contextmanager
    def opened(self, robot: Robot, name: str, method: str, **about: Any) -> Iterator[tuple[RunFolder, dict[str, Any]]]:
        """The folder of the run, by default named after the motion's `name`, and the content of its `config.json`, with
        `about`; a note tells how to continue after Ctrl-C."""
        resume = self.folder.resume
        default = opt.folder_name(name, robot.name, method, self.seed)
        out = self.out or default_folder(opt.RUNS, default, resume=resume)
        arguments = opt.recorded(self) | {"method": method}
        config = {
            "arguments": arguments,
            "robot": robot.name,
            **about,
            "controller": METHODS[method].configure(controller_config(self.config)).as_dict(),
            "versions": versions(),
        }
        same = {key: value for key, value in arguments.items() if key not in _NOT_THE_PROBLEM}
        with open_run(out, config, same, resume=resume, overwrite=self.folder.overwrite) as folder:
            if folder.finished and not resume:
                note(f"replacing the run in {out}")
            try:
                yield folder, config
            except KeyboardInterrupt:
                if folder.checkpoints:
                    note(f"to continue from the checkpoint: the same command with --out {folder.path} --resume")
                raise


@opt.command
class Imitate(SearchRun):
    """Turns a motion into one that the robot can execute: retargets it, fits DMPs, and optimises them in closed-loop
    simulation. A motion that is run once is optimised with --iterations only."""

    motion: Annotated[Positional[str], opt.option("MOTION")]
    duration: Annotated[float, opt.option("S")] = 5.0
    no_optimize: opt.Flag = False
    search: opt.Searching
    clip: opt.ClipReading

    def run(self) -> int:
        return self.make()[1]

    def make(self) -> tuple[Path, int]:
        """The folder of the run, and the exit status."""
        opt.check_duration(self.duration)
        video = self.video.wanted
        method = self._method()
        began = time.perf_counter()
        robot, motion = self.clip.load(self.motion, self.robot)
        loading_s = time.perf_counter() - began
        if self._is_left_as_it_is(motion, method):
            method = METHODS[method].unoptimised.name
            note(f"{motion.name} is run once, so nothing is searched; --iterations N optimises it for N iterations")
        told = motion.provenance.as_dict()
        about = {"motion": motion.name, "source": told.get("source"), "licence": told["licence"]}
        with self.opened(robot, motion.name, method, **about) as (folder, config):
            note_origin(robot, motion)
            for bound in motion.provenance.retargeted.bounds:
                if not bound.met:
                    note(f"retargeting does not keep {bound}")
            result = self._imitate(robot, motion, method, folder)
            result = dataclasses.replace(result, wall_s=result.wall_s + loading_s)
            write_run(result, folder, config)
        clip = None if video is None else self.clip.animal(self.motion, robot)
        return folder.path, put_result(result, folder, self.search.iterations, video=video, clip=clip)

    def _method(self) -> str:
        """Name of the method that runs; raises `ConfigError` if the options do not fit it."""
        from fastmimic.optimize.cma_es import CmaSettings  # loads the compiler

        CmaSettings(self.search.iterations, self.search.population, self.seed)
        check_workers(self.workers)
        method = self.method
        if self.no_optimize:
            method = METHODS[method].unoptimised.name
        check_controller(METHODS[method], False)
        self.check_search(method)
        return method

    def _is_left_as_it_is(self, motion: Motion, method: str) -> bool:
        """Whether a motion that is run once is not optimised: a search takes minutes and gains nothing that shows. One
        that is asked for takes place."""
        once = motion.target.cycle is None and not motion.target.parts
        asked = opt.given(self.search) or self.folder.resume
        return once and not asked and METHODS[method].optimises

    def _imitate(self, robot: Robot, motion: Motion, method: str, folder: RunFolder) -> "Imitation":
        from fastmimic.imitation.imitate import imitate
        from fastmimic.optimize.cma_es import optimisation_progress

        given = {"source": motion, "robot": robot, "method": method, "duration_s": self.duration}
        with optimisation_progress() as progress:
            own = {"checkpoint": folder.checkpoint, "progress": progress}
            return opt.apply(imitate, self, self.search, self.folder, **given, **own)


@opt.command
class Stitch(SearchRun):
    """Joins motions into one, each repeated for several cycles, and optimises the DMPs of all of them together. The
    search starts from the optimum of each motion; motions that are not optimised yet are optimised first."""

    motions: Annotated[Positional[tuple[str, ...]], opt.option("MOTION MOTION ...")]
    cycles: Annotated[tuple[int, ...], opt.option("N [N ...]")] = ()
    iterations: opt.Generations = None
    population: Annotated[int | None, opt.option("N")] = None
    part_iterations: opt.Generations = None

    def run(self) -> int:
        if len(self.motions) < 2:
            raise ConfigError(f"stitch takes at least two motions, found {len(self.motions)}")
        if len(self.cycles) not in (0, 1, len(self.motions)):
            takes = f"--cycles takes one number, or one for each of the {len(self.motions)} motions"
            raise ConfigError(f"{takes}; found {len(self.cycles)}")
        video = self.video.wanted
        self.check_search(self.method)
        sources = list(map(cache(find_motion), self.motions))  # the same name is the same motion
        robot = opt.choose_robot(self.robot, *sources)
        names = "+".join(_name_of(source) for source in sources)
        with self.opened(robot, names, self.method, motion="+".join(self.motions)) as (folder, config):
            result = self._stitch(sources, robot, folder)
            made = result.motion.provenance.as_dict()
            write_run(result, folder, config | {name: made[name] for name in ("source", "licence")})
        put_table(segment_rows(result), right=range(1, 8))
        return put_result(result, folder, self.iterations, video=video)

    def _stitch(self, sources: list[MotionSource], robot: Robot, folder: RunFolder) -> "Stitching":
        from fastmimic.imitation.stitch import stitch
        from fastmimic.optimize.cma_es import optimisation_progress

        with ExitStack() as stack:
            bar: Callable[[Progress], None]

            def stage(what: str) -> None:
                nonlocal bar
                stack.close()
                note(what)
                bar = stack.enter_context(optimisation_progress())

            return opt.apply(
                stitch,
                self,
                self.folder,
                sources=sources,
                robot=robot,
                cycles=self.cycles[0] if len(self.cycles) == 1 else self.cycles or None,
                folder=folder.path,
                progress=lambda step: bar(step),
                stage=stage,
            )


def _name_of(source: MotionSource) -> str:
    """The name of a motion in the name of the folder."""
    if source.folder is not None:
        return source.folder.resolve().name
    path = Path(source.name)
    if path.name == MOTION:
        return path.resolve().parent.name
    return path.stem if path.is_file() else source.name


def segment_rows(result: "Stitching") -> list[tuple[str, ...]]:
    """The figures of each segment as in `metrics.json`, for a table."""
    metrics = result.metrics()
    rows: list[tuple[str, ...]] = [("segment", "cycles", "from s", "to s", "before", "own optimum", "after", "fell")]
    for segment, own in zip(metrics["segments"], metrics["individual_optima"]["segments"], strict=True):
        times = (f"{segment[end]:.2f}" for end in ("first_s", "last_s"))
        rewards = (f"{reward:.3f}" for reward in (segment["reward"]["before"], own, segment["reward"]["after"]))
        rows.append((segment["motion"], str(segment["cycles"]), *times, *rewards, yes_no(segment["fell"]["after"])))
    return rows
