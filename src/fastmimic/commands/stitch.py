"""`fastmimic stitch`: several motions in a row as one that the robot can execute."""

from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tyro.conf import Positional

from fastmimic.base.errors import ConfigError
from fastmimic.commands import options as opt
from fastmimic.commands.console import note, optimisation_progress, put_table
from fastmimic.commands.search_run import SearchRun
from fastmimic.commands.show import put_result, write_run, yes_no
from fastmimic.robot import Robot

if TYPE_CHECKING:  # loads the compiler
    from fastmimic.imitation.stitch import Stitching
    from fastmimic.optimize.cma_es import Progress
    from fastmimic.runs.loading import MotionSource
    from fastmimic.runs.work_folder import RunFolder


@dataclass(frozen=True, kw_only=True)
class Stitch(SearchRun):
    """Joins motions into one, each repeated for several cycles, and optimises the DMPs of all of them together. The
    search starts from the optimum of each motion; motions that are not optimised yet are optimised first.

    Writes what 'imitate' writes, with figures for each segment. Ctrl-C stops the search and keeps the best motion so
    far, if the joint search had started.
    """

    motions: Annotated[Positional[tuple[str, ...]], opt.option("MOTION MOTION ...")]
    """Two or more names from 'fastmimic motions', files, or folders of runs. A name takes precedence over a folder of
    the same name (use ./NAME)."""
    cycles: Annotated[tuple[int, ...], opt.option("N [N ...]")] = ()
    """Cycles of each motion: one number for all, or one for each. Default: about 3 s each."""
    iterations: int = 200
    """Generations of CMA-ES in the joint search."""
    population: Annotated[int | None, opt.option("N")] = None
    """Candidates in a generation. Default: the usual number of CMA-ES for the number of parameters."""
    part_iterations: Annotated[int | None, opt.option("N")] = None
    """Generations for each motion alone. Default: as many as in the joint search, or as it had before."""

    def run(self) -> int:
        """Runs the searches and writes the folder; returns the exit status."""
        if len(self.motions) < 2:
            raise ConfigError(f"stitch takes at least two motions, found {len(self.motions)}")
        if len(self.cycles) not in (0, 1, len(self.motions)):
            raise ConfigError(
                f"--cycles takes one number, or one for each of the {len(self.motions)} motions; found"
                f" {len(self.cycles)}"
            )
        video = self.video.wanted
        from fastmimic.robot import load_robot
        from fastmimic.runs.loading import find_motion

        self.check_search(self.method)
        sources = [find_motion(motion) for motion in self.motions]
        own = next((source.robot for source in sources if source.robot is not None), None)
        robot = load_robot(self.robot or own or opt.DEFAULT_ROBOT)
        names = "+".join(_name_of(source) for source in sources)
        with self.opened(robot, names, self.method, motion="+".join(self.motions)) as (folder, config):
            result = self._stitch(sources, robot, folder)
            made = result.motion.provenance
            write_run(result, folder, config | {"source": made.source, "licence": made.licence})
        put_table(segment_rows(result), right=range(1, 8))
        return put_result(result, folder, self.iterations, video=video)

    def _stitch(self, sources: "list[MotionSource]", robot: Robot, folder: "RunFolder") -> "Stitching":
        from fastmimic.imitation.stitch import stitch

        with ExitStack() as stack:
            bar: Callable[[Progress], None] = _ignore

            def stage(what: str) -> None:
                nonlocal bar
                stack.close()
                note(what)
                bar = stack.enter_context(optimisation_progress())

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
                resume=self.folder.resume,
                progress=lambda step: bar(step),
                stage=stage,
                randomize=self.randomization.chosen(),
                choice=self.choice,
            )


def _name_of(source: "MotionSource") -> str:
    """The name of a motion in the name of the folder."""
    from fastmimic.runs.loading import MOTION

    if source.folder is not None:
        return source.folder.resolve().name
    path = Path(source.name)
    if path.name == MOTION:
        return path.resolve().parent.name
    return path.stem if path.is_file() else source.name


def _ignore(step: "Progress") -> None:
    """Progress before the first stage is not shown."""


def segment_rows(result: "Stitching") -> list[tuple[str, ...]]:
    """The figures of each segment as in `metrics.json`, for a table."""
    metrics = result.metrics()
    rows: list[tuple[str, ...]] = [("segment", "cycles", "from s", "to s", "before", "own optimum", "after", "fell")]
    for segment, own in zip(metrics["segments"], metrics["individual_optima"]["segments"], strict=True):
        rows.append(
            (
                segment["motion"],
                str(segment["cycles"]),
                f"{segment['first_s']:.2f}",
                f"{segment['last_s']:.2f}",
                f"{segment['reward']['before']:.3f}",
                f"{own:.3f}",
                f"{segment['reward']['after']:.3f}",
                yes_no(segment["fell"]["after"]),
            )
        )
    return rows
