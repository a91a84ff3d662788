"""`fastmimic stitch`: several motions, one after another, as one that the robot can execute."""

import dataclasses
import re
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

from tyro.conf import Positional, arg

from fastmimic.base.errors import ConfigError
from fastmimic.commands.console import note, optimisation_progress, put, table
from fastmimic.commands.options import DEFAULT_ROBOT, RandomizeOptions
from fastmimic.commands.outcome import report
from fastmimic.robot import ROBOT_CHOICES, Robot

if TYPE_CHECKING:
    from fastmimic.imitation.stitch import Stitching
    from fastmimic.optimize.cma_es import Progress
    from fastmimic.report.run_folder import RunFolder
    from fastmimic.runs.loading import MotionSource

RUNS: Final = Path("runs")
_NOT_THE_PROBLEM: Final = ("workers", "out", "resume", "overwrite", "no_video", "quality")
"""Arguments that change where and how a run happens, not what comes out."""


@dataclass(frozen=True, kw_only=True)
class Stitch(RandomizeOptions):
    """Joins motions to one, each repeated several times, and optimises the DMPs of all of them together, starting
    from each one's own optimum. Motions that are not optimised yet are optimised by themselves first.

    Writes what 'imitate' writes, with figures for each segment. Ctrl-C stops the search and keeps the best motion
    so far, if the optimisation of the whole had begun.
    """

    motions: Annotated[Positional[tuple[str, ...]], arg(metavar="MOTION MOTION ...")]
    """Two or more: names of 'fastmimic motions', files, or folders of runs, which are taken as they were optimised.
    A name goes before a folder of the same name (use ./NAME)."""
    cycles: Annotated[tuple[int, ...], arg(metavar="N [N ...]")] = ()
    """How often each motion is repeated: one number for all, or one for each; by default about 3 s each."""
    robot: Annotated[
        str | None,
        arg(metavar="NAME|FILE.xml", help=f"{ROBOT_CHOICES}; by default that of the first optimised motion, or a1."),
    ] = None
    method: Annotated[str, arg(metavar="NAME")] = "mbc-dmp"
    """mbc-dmp and lh-dmp optimise; mbc, lh and raibert follow the stitched motion as its motions are."""
    config: Annotated[str, arg(metavar="default|robust|paper|FILE")] = "default"
    """The controller's parameters: ours, ours for another robot than the model, or the paper's form."""
    iterations: int = 200
    """Generations of CMA-ES on the whole."""
    population: int | None = None
    """Candidates in each; by default CMA-ES's usual number for so many parameters."""
    part_iterations: Annotated[int | None, arg(metavar="INT")] = None
    """Generations on each motion by itself; by default as many as on the whole, or as it had before."""
    seed: int = 0
    """Of the optimiser. The same seed gives the same result, whatever the number of workers."""
    workers: Annotated[int | None, arg(metavar="INT")] = None
    """Threads; by default one for each core."""
    out: Annotated[Path | None, arg(metavar="FOLDER")] = None
    """By default runs/MOTION+MOTION-ROBOT-METHOD-SEED, numbered if taken. A folder with another run is refused."""
    resume: bool = False
    """Go on from the checkpoints in the folder (by default the last of its name)."""
    overwrite: bool = False
    """Replace a run of other arguments."""
    no_video: bool = False
    """Leave out the video."""
    quality: Annotated[str, arg(metavar="preview|high")] = "preview"
    """Of the video: quick, or with shadows, reflections and smooth edges."""

    def run(self) -> int:
        """Runs it, and writes the folder; returns the exit status."""
        if len(self.motions) < 2:
            raise ConfigError(f"stitch takes at least two motions, found {len(self.motions)}")
        if len(self.cycles) not in (0, 1, len(self.motions)):
            raise ConfigError(
                f"--cycles takes one number, or one for each of the {len(self.motions)} motions; found"
                f" {len(self.cycles)}"
            )
        from fastmimic.imitation.methods import method_named
        from fastmimic.render.quality import quality_named
        from fastmimic.report.run_folder import default_folder, open_run
        from fastmimic.robot import load_robot
        from fastmimic.runs.loading import find_motion

        quality_named(self.quality)
        if not method_named(self.method).optimises and self.resume:
            raise ConfigError("--resume goes on with an optimisation; without one there is nothing to resume")
        if self.randomization() is not None and not method_named(self.method).optimises:
            raise ConfigError(f"--randomize is of a search, and method '{self.method}' has none; leave it out")
        sources = {motion: find_motion(motion) for motion in self.motions}
        own = next((source.robot for source in sources.values() if source.robot is not None), None)
        robot = load_robot(self.robot or own or DEFAULT_ROBOT)
        names = "+".join(_name_of(sources[motion]) for motion in self.motions)
        name = re.sub(r"[^\w.+-]+", "-", f"{names}-{robot.name}-{self.method}-{self.seed}")
        out = self.out or default_folder(RUNS, name, resume=self.resume)
        config = self._record(robot)
        same = {k: v for k, v in config["arguments"].items() if k not in _NOT_THE_PROBLEM}
        with open_run(out, config, same, resume=self.resume, overwrite=self.overwrite) as folder:
            if folder.finished and not self.resume:
                note(f"replacing the run in {out}")
            result = self._stitch([sources[motion] for motion in self.motions], robot, folder)
            meta = result.motion.meta
            folder.write(result, config | {"source": meta.get("source"), "licence": meta.get("licence")})
        for line in segments(result):
            put(line)
        return report(result, folder, self.iterations, video=None if self.no_video else self.quality)

    def _stitch(self, sources: "list[MotionSource]", robot: Robot, folder: "RunFolder") -> "Stitching":
        from fastmimic.imitation.stitch import stitch

        with ExitStack() as stack:
            bar: Callable[[Progress], None] = _nowhere

            def stage(what: str) -> None:
                nonlocal bar
                stack.close()
                note(what)
                bar = stack.enter_context(optimisation_progress())

            try:
                return stitch(
                    sources,
                    robot,
                    cycles=self.cycles[0] if len(self.cycles) == 1 else self.cycles or None,
                    method=self.method,
                    config=self.config,
                    iterations=self.iterations,
                    population=self.population,
                    part_iterations=self.part_iterations,
                    seed=self.seed,
                    workers=self.workers,
                    folder=folder.path,
                    resume=self.resume,
                    progress=lambda step: bar(step),
                    stage=stage,
                    randomize=self.randomization(),
                )
            except KeyboardInterrupt:
                if folder.checkpoints:
                    note(f"to go on from the checkpoints: the same command with --out {folder.path} --resume")
                raise

    def _record(self, robot: Robot) -> dict[str, Any]:
        """Everything that the run depends on, JSON-serialisable."""
        from fastmimic.control.config import controller_config
        from fastmimic.imitation.imitate import versions
        from fastmimic.imitation.methods import method_named

        arguments = {k: str(v) if isinstance(v, Path) else v for k, v in dataclasses.asdict(self).items()}
        arguments = self.recorded(arguments)
        arguments |= {"motions": list(self.motions), "cycles": list(self.cycles)}
        return {
            "arguments": arguments,
            "robot": robot.name,
            "motion": "+".join(self.motions),
            "controller": method_named(self.method).configure(controller_config(self.config)).as_dict(),
            "versions": versions(),
        }


def _name_of(source: "MotionSource") -> str:
    """The name of a motion in the name of the folder."""
    from fastmimic.runs.loading import MOTION

    if source.folder is not None:
        return source.folder.resolve().name
    path = Path(source.name)
    if path.name == MOTION:
        return path.resolve().parent.name
    return path.stem if path.is_file() else source.name


def _nowhere(step: "Progress") -> None:
    """Where nothing is shown yet."""


def segments(result: "Stitching") -> list[str]:
    """The figures of each segment, for a human; those of `metrics.json`."""
    metrics = result.metrics()
    rows = [["segment", "cycles", "from s", "to s", "before", "own optimum", "after", "fell"]]
    for segment, own in zip(metrics["segments"], metrics["individual_optima"]["segments"], strict=True):
        rows.append(
            [
                segment["motion"],
                str(segment["cycles"]),
                f"{segment['first_s']:.2f}",
                f"{segment['last_s']:.2f}",
                f"{segment['reward']['before']:.3f}",
                f"{own:.3f}",
                f"{segment['reward']['after']:.3f}",
                "yes" if segment["fell"]["after"] else "no",
            ]
        )
    return table(rows, right=range(1, len(rows[0])))
