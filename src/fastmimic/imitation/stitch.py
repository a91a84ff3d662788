"""`stitch`: joins several motions into one that the robot can execute (paper, "Motion stitching")."""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from fastmimic.base.errors import CheckpointError, ConfigError
from fastmimic.base.files import remove_file
from fastmimic.clips.clip import Clip
from fastmimic.control.config import ControllerConfig
from fastmimic.episode.loop import run_episodes
from fastmimic.episode.rollout import Rollout
from fastmimic.executors import check_workers
from fastmimic.imitation.imitate import Imitation, imitate
from fastmimic.imitation.methods import METHODS, check_controller, made_with
from fastmimic.motion.motion import Motion
from fastmimic.optimize.cma_es import Checkpoint, CmaSettings, Progress
from fastmimic.optimize.parameters import FOOT_HEIGHT, FinalChoice, needed_group
from fastmimic.optimize.stitched import StitchedProblem, parameters_of
from fastmimic.robot import Robot, load_robot
from fastmimic.runs.loading import MotionSource, load_motion
from fastmimic.runs.work_folder import CHECKPOINT, CHECKPOINTS, PART_CHECKPOINT
from fastmimic.stitching.join import stitch_motions

PART_POPULATION: Final = 10


@dataclass(frozen=True, eq=False, kw_only=True)
class Stitching(Imitation):
    """A stitched, optimised motion and the course of its optimisation; `individual` is one nominal episode with the
    segments' own optima, where the search began (without a search, the same as `before` and `after`)."""

    individual: Rollout

    def metrics(self) -> dict[str, Any]:
        """`Imitation.metrics`, with `segments`, `transitions`, and the metrics of the individual optima."""
        found, individual = super().metrics(), self.individual
        found["individual_optima"] = {
            "reward": float(individual.reward[0]),
            "fell": bool(individual.fell[0]),
            "segments": [float(part.reward[0]) for part in individual.parts],
        }
        found["transitions"] = list(self.demonstration.provenance.stitched.transitions)
        return found


def stitch(
    sources: Sequence[str | Path | Clip | Motion | MotionSource],
    robot: Robot | str = "a1",
    *,
    cycles: int | Sequence[int] | None = None,
    method: str = "mbc-dmp",
    config: ControllerConfig | str = "default",
    iterations: int | None = None,
    population: int | None = None,
    part_iterations: int | None = None,
    seed: int = 0,
    workers: int | None = None,
    folder: str | Path | None = None,
    resume: bool = False,
    progress: Callable[[Progress], None] | None = None,
    stage: Callable[[str], None] = lambda name: None,
    choice: FinalChoice = FinalChoice(),
    part_duration_s: float = 5.0,
) -> Stitching:
    """Stitches motions and optimises all their DMPs together, over the whole episode, from each motion's own optimum,
    which `imitate` finds first if need be. Each occurrence of a motion has its own parameters.

    Args:
        sources: two or more, as in `load_motion`. Optimised motions keep their parameters.
        cycles: repetitions of each motion: one number for all, or one for each; None for about 3 s each. The whole
            lasts 600 s at most.
        method: one of `fastmimic.imitation.methods.METHODS`; without a search, the stitched motion is only run.
        population: candidates in each; None for 4 + 3 ln k with k parameters, CMA-ES's default.
        part_iterations: of CMA-ES on each motion; None for `iterations`, or after a resume for the earlier number.
        folder: for all checkpoints; None to keep none. Removes those of an earlier run unless `resume`.
        resume: continue from the checkpoints in the folder. Once the whole has begun, the motions' own are only read.
        stage: called with the name of each stage as it begins.
        choice: as in `imitate`, for each motion and for the whole.
        part_duration_s: length of the episodes in which a motion is optimised by itself, s.

    Raises `FastMimicError` if an argument is wrong. Checkpoints survive Ctrl-C, which raises `KeyboardInterrupt` before
    the whole is optimised.
    """
    began = time.perf_counter()
    chosen = METHODS[method]
    check_controller(chosen, False)
    robot = load_robot(robot)
    config = chosen.configure(config)
    for generations in (iterations, part_iterations):  # checks before any long work
        if generations is not None:
            CmaSettings(generations, population if population is not None else PART_POPULATION, seed)
    check_workers(workers)
    if isinstance(cycles, int) and cycles < 1:
        raise ConfigError(f"every motion needs at least one cycle, found {cycles}")
    checkpoints = Path(folder) if folder is not None else None
    motions = _load(sources, robot)
    counts = [cycles] * len(motions) if isinstance(cycles, int) else cycles
    stage("stitching " + ", ".join(m.name for m in motions))
    demonstration = stitch_motions(robot, [m.target for m in motions], counts)
    given, whole, elsewhere = demonstration, None, 0.0
    parts: dict[int, Imitation] = {}
    search = {"iterations": iterations, "population": PART_POPULATION, "seed": seed, "choice": choice}
    settings: dict[str, Any] = {"method": method, "config": config, "workers": workers, "progress": progress, **search}
    if chosen.optimises or any(m.demonstration is not None for m in motions):
        if chosen.optimises:
            if checkpoints is not None and not resume:
                for path in checkpoints.glob(CHECKPOINTS):
                    remove_file(path)
            imitated = time.perf_counter()
            own = settings | {"duration_s": part_duration_s}
            parts = _optimised_parts(motions, robot, part_iterations, checkpoints, resume, own, stage)
            elsewhere += time.perf_counter() - imitated
        starts = [parameters_of(parts[id(m)].motion if id(m) in parts else m) for m in motions]
        group = needed_group(chosen.parameters if chosen.optimises else FOOT_HEIGHT, *starts)
        whole = StitchedProblem(robot, demonstration, start=starts, config=config, group=group)
        given = whole.motion(whole.start)
    if chosen.optimises and whole is not None:
        settings["population"] = population or 4 + int(3 * np.log(len(whole.parameters)))  # Hansen 2006
        stage("all together")
    checkpoint = checkpoints / CHECKPOINT if checkpoints is not None else None
    again = resume and checkpoint is not None and checkpoint.is_file()
    imitated = time.perf_counter()
    result = imitate(given, robot, checkpoint=checkpoint, resume=again, **settings)
    elsewhere += time.perf_counter() - imitated
    own = dict(vars(result))
    individual = result.before
    if whole is not None:
        individual = run_episodes(robot, given, duration_s=result.duration_s, config=config, log=not chosen.optimises)
        own["simulated_s"] += result.duration_s
        if not chosen.optimises:
            own |= {"motion": made_with(given, method, config), "before": individual, "after": individual}
            own |= {"parameters": whole.parameters, "values": whole.start}
    for name in ("evaluations", "simulated_s", "wall_s"):  # the results include the time before a resume
        own[name] += sum(getattr(part, name) for part in parts.values())
    own["wall_s"] += time.perf_counter() - began - elsewhere
    return Stitching(**own, individual=individual)


def _load(sources: Sequence[str | Path | Clip | Motion | MotionSource], robot: Robot) -> list[Motion]:
    """The motions; the same name or object is the same motion, loaded once."""
    if isinstance(sources, str | Path):
        raise ConfigError(f"stitching takes a list of motions, found '{sources}'")
    keys = [str(source) if isinstance(source, str | Path) else id(source) for source in sources]
    found = {key: load_motion(source, robot) for key, source in dict(zip(keys, sources, strict=True)).items()}
    return [found[key] for key in keys]


def _optimised_parts(
    motions: Sequence[Motion],
    robot: Robot,
    iterations: int | None,
    folder: Path | None,
    resume: bool,
    settings: Mapping[str, Any],
    say: Callable[[str], None],
) -> dict[int, Imitation]:
    """The results of the motions that are not optimised yet, each by itself, by the motion's id."""
    begun = resume and folder is not None and (folder / CHECKPOINT).is_file()
    distinct = list({id(m): m for m in motions}.values())
    todo, out = [], dict[int, Imitation]()
    for i, motion in enumerate(distinct, start=1):
        if motion.demonstration is not None:
            continue
        path = folder / PART_CHECKPOINT.format(i) if folder is not None else None
        again = resume and path is not None and path.is_file()
        count = iterations if iterations is not None else settings["iterations"]
        if begun and again and path is not None:
            count = _iterations_before(motion, path, iterations)
        todo.append((i, motion, path, again, count))
    for i, motion, path, again, count in todo:
        say(f"{motion.name} by itself, {i} of {len(distinct)}")
        own = {**settings, "iterations": count}
        out[id(motion)] = imitate(motion, robot, checkpoint=path, resume=again, **own)
        if out[id(motion)].interrupted:
            raise KeyboardInterrupt
    return out


def _iterations_before(motion: Motion, checkpoint: Path, wanted: int | None) -> int:
    """Iterations of a single motion's search when the search on the whole began."""
    had = len(Checkpoint.load(checkpoint).scores)
    if wanted is not None and wanted != had:
        raise CheckpointError(
            f"the whole was begun from {had} iterations of '{motion.name}' by itself, not {wanted};"
            f" resume with --part-iterations {had} or without, or choose another output folder"
        )
    return had
