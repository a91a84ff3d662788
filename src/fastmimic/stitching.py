"""Stitching: from several motions to one that the robot can execute (paper, "Motion stitching")."""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from fastmimic.control.config import ControllerConfig, controller_config
from fastmimic.errors import ConfigError
from fastmimic.imitation.rollout import Rollout, run_episodes
from fastmimic.methods import method_named
from fastmimic.motion.clip import Clip
from fastmimic.motion.motion import Motion
from fastmimic.motion.stitch import stitch_motions
from fastmimic.optimize.cma_es import CmaSettings, Progress
from fastmimic.optimize.stitching import StitchedProblem, parameters_of
from fastmimic.pipeline import Imitation, imitate, load_motion
from fastmimic.robot import Robot, load_robot

Array = NDArray[np.float64]

PART_CHECKPOINT: Final = "checkpoint-{}.npz"
CHECKPOINT: Final = "checkpoint.npz"
RUN_MOTION: Final = "motion.npz"
PART_POPULATION: Final = 10


@dataclass(frozen=True, eq=False)
class Stitching(Imitation):
    """A stitched, optimised motion and how it came about.

    Attributes:
        individual: one nominal episode with the segments' own optima, from which the search began.
    """

    individual: Rollout

    def metrics(self) -> dict[str, Any]:
        """As `Imitation.metrics`, with `segments`, `transitions`, and what the individual optima are worth as they
        stand."""
        found, individual = super().metrics(), self.individual
        found["individual_optima"] = {
            "reward": float(individual.reward[0]),
            "fell": bool(individual.fell[0]),
            "segments": [float(part.reward[0]) for part in individual.parts],
        }
        found["transitions"] = self.demonstration.meta["stitch"]["transitions"]
        return found


def stitch(
    sources: Sequence[str | Path | Clip | Motion],
    robot: Robot | str = "a1",
    *,
    cycles: int | Sequence[int] | None = None,
    method: str = "mbc-dmp",
    config: ControllerConfig | str = "default",
    iterations: int = 200,
    population: int | None = None,
    part_iterations: int | None = None,
    seed: int = 0,
    workers: int | None = None,
    folder: str | Path | None = None,
    resume: bool = False,
    progress: Callable[[Progress], None] | None = None,
    stage: Callable[[str], None] | None = None,
) -> Stitching:
    """Stitches motions and optimises all their DMPs together, from each one's own optimum.

    Each motion that is not optimised yet is optimised by itself first, as `imitate` does. Then the parameters of all
    segments, each occurrence its own, are optimised over the whole episode.

    Args:
        sources: two or more of what `load_motion` takes, or folders of runs. An optimised motion is taken with its
            parameters.
        robot: the robot, its name, or the path of its MJCF.
        cycles: how often each motion is repeated: one number for all, or one for each; about 3 s each if None.
        method: one of `fastmimic.methods.METHODS`; if it optimises nothing, the motion is stitched and run.
        config: the controller's parameters, or the name of a set.
        iterations: of CMA-ES on the whole.
        population: candidates in each; 4 + 3 ln k for k parameters, CMA-ES's usual size, if None.
        part_iterations: of CMA-ES on a motion by itself; as `iterations` if None.
        seed: of all of them.
        workers: threads; one for each core if None. The result does not depend on it.
        folder: where the checkpoints are kept, the motions' own as well; none if None.
        resume: go on from the checkpoints in the folder; what has none there is begun anew.
        progress: called after each iteration.
        stage: called with what begins.

    Raises:
        FastMimicError: something is wrong with what was given; the message says what.
        KeyboardInterrupt: stopped before the whole was optimised; the checkpoints are there.
    """
    began = time.perf_counter()
    chosen = method_named(method)
    robot = load_robot(robot)
    config = chosen.configure(controller_config(config) if isinstance(config, str) else config)
    for generations in (iterations, part_iterations):  # refuses what cannot be, before anything takes long
        if generations is not None:
            CmaSettings(generations, population if population is not None else PART_POPULATION, seed)
    say = stage if stage is not None else _ignore
    checkpoints = Path(folder) if folder is not None else None
    loaded = _load(sources, robot)
    motions = [loaded[k] for k in _keys(sources)]
    counts = [cycles] * len(motions) if isinstance(cycles, int) else cycles
    say("stitching " + ", ".join(m.name for m in motions))
    demonstration = stitch_motions(robot, [m.target for m in motions], counts)
    given, evaluations, simulated_s = demonstration, 0, 0.0
    if chosen.optimises:
        starts: dict[int, Array] = {}
        distinct = list({id(m): m for m in motions}.values())
        for i, motion in enumerate(distinct, start=1):
            if motion.demonstration is not None:
                starts[id(motion)] = parameters_of(motion, robot)
                continue
            say(f"{motion.name} by itself, {i} of {len(distinct)}")
            found = _optimised_part(
                motion,
                robot,
                checkpoints / PART_CHECKPOINT.format(i) if checkpoints is not None else None,
                resume,
                {
                    "method": method,
                    "config": config,
                    "iterations": part_iterations if part_iterations is not None else iterations,
                    "population": PART_POPULATION,
                    "seed": seed,
                    "workers": workers,
                    "progress": progress,
                },
            )
            starts[id(motion)] = found.values
            evaluations += found.evaluations
            simulated_s += found.simulated_s
        whole = StitchedProblem(robot, demonstration, start=[starts[id(m)] for m in motions], config=config)
        given = whole.motion(whole.start)
        population = population if population is not None else usual_population(len(whole.parameters))
        say("all together")
    prepared = time.perf_counter() - began
    checkpoint = checkpoints / CHECKPOINT if checkpoints is not None else None
    result = imitate(
        given,
        robot,
        method=method,
        config=config,
        iterations=iterations,
        population=population if population is not None else PART_POPULATION,
        seed=seed,
        workers=workers,
        checkpoint=checkpoint,
        resume=resume and checkpoint is not None and checkpoint.is_file(),
        progress=progress,
    )
    individual = result.before
    if chosen.optimises:
        individual = run_episodes(robot, given, duration_s=result.duration_s, config=config)
        simulated_s += result.duration_s
    own = {field.name: getattr(result, field.name) for field in fields(Imitation)}
    own["evaluations"] += evaluations
    own["simulated_s"] += simulated_s
    own["wall_s"] += prepared
    return Stitching(**own, individual=individual)


def usual_population(parameters: int) -> int:
    """CMA-ES's usual number of candidates, 4 + 3 ln k (Hansen 2006)."""
    return 4 + int(3 * np.log(parameters))


def _keys(sources: Sequence[str | Path | Clip | Motion]) -> list[object]:
    """What tells the sources apart: the same name or object is the same motion."""
    return [str(s) if isinstance(s, str | Path) else id(s) for s in sources]


def _load(sources: Sequence[str | Path | Clip | Motion], robot: Robot) -> dict[object, Motion]:
    if isinstance(sources, str | Path):
        raise ConfigError(f"stitching takes a list of motions, found '{sources}'")
    found: dict[object, Motion] = {}
    for key, source in zip(_keys(sources), sources, strict=True):
        if key in found:
            continue
        if isinstance(source, str | Path) and Path(source).is_dir():
            source = Path(source) / RUN_MOTION
        found[key] = load_motion(source, robot)
    return found


def _optimised_part(
    motion: Motion, robot: Robot, checkpoint: Path | None, resume: bool, settings: Mapping[str, Any]
) -> Imitation:
    again = resume and checkpoint is not None and checkpoint.is_file()
    result = imitate(motion, robot, checkpoint=checkpoint, resume=again, **settings)
    if result.interrupted:
        raise KeyboardInterrupt
    return result


def _ignore(text: str) -> None:
    """Where nobody listens."""
