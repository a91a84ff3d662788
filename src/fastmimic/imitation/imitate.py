"""`imitate`: turns a motion into an optimised motion that the robot can execute."""

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from fastmimic.base.errors import ConfigError
from fastmimic.clips.clip import Clip
from fastmimic.control.config import ControllerConfig
from fastmimic.episode.loop import MakeController, run_episodes
from fastmimic.episode.plan import nominal_start
from fastmimic.imitation.imitation_result import HeldOut, Imitation
from fastmimic.imitation.methods import Method, check_controller, made_with, method_named
from fastmimic.motion.motion import Motion
from fastmimic.optimize.cma_es import CmaSettings, Progress, optimize
from fastmimic.optimize.final_choice import FinalChoice
from fastmimic.optimize.parameters import moved_by
from fastmimic.optimize.problem import Objective
from fastmimic.optimize.randomization import HELD_OUT_ROBOTS, Randomization, randomization
from fastmimic.optimize.stitched import make_problem
from fastmimic.primitive.rhythmic import N_BASIS
from fastmimic.robot import Robot, load_robot
from fastmimic.runs.loading import load_motion
from fastmimic.simulation.conditions import Conditions


def imitate(
    source: str | Path | Clip | Motion,
    robot: Robot | str = "a1",
    *,
    method: str = "mbc-dmp",
    config: ControllerConfig | str = "default",
    duration_s: float = 5.0,
    iterations: int = 200,
    population: int = 10,
    seed: int = 0,
    workers: int | None = None,
    checkpoint: str | Path | None = None,
    resume: bool = False,
    progress: Callable[[Progress], None] | None = None,
    n_basis: int = N_BASIS,
    controller: MakeController | None = None,
    randomize: int | Randomization | None = None,
    warm_start: str | Path | Motion | None = None,
    choice: FinalChoice = FinalChoice(),
    **overrides: Any,
) -> Imitation:
    """Turns a motion into one that the robot can execute: retarget, fit DMPs, optimise with the robot in the loop.

    Args:
        source: as in `load_motion`. The search for an optimised motion starts again from its demonstration; a stitched
            motion is optimised further.
        robot: the robot, its name, or the path of its MJCF.
        method: one of `fastmimic.imitation.methods.METHODS`.
        config: the controller's parameters, or the name of a set.
        duration_s: length of the episodes, s; a motion that does not repeat always runs whole.
        workers: threads; None for one per core. The result does not depend on it.
        n_basis: basis functions of each DMP.
        controller: of a trained policy, as in `evaluate`; for the method rl, which optimises nothing.
        randomize: the robots that score each candidate, or their number; None for the nominal robot.
        warm_start: an optimised motion, or its file, with the modulation that the search begins from.
        choice: how the search chooses its result.

    Raises `FastMimicError`: an argument is wrong; the message says which.
    """
    chosen = method_named(method)
    check_controller(chosen, controller is not None)
    robot = load_robot(robot)
    config = chosen.configure(config)
    controller = controller or chosen.controller
    settings = CmaSettings(iterations, population, seed, choice=choice)
    over = randomization(randomize)
    if over is not None and not chosen.optimises:
        raise ConfigError(f"randomisation is of a search, and method '{method}' has none; leave it out")
    moved = _warm(warm_start, chosen)
    began = time.perf_counter()
    given = load_motion(source, robot, **overrides)
    demonstration = given.target
    if demonstration.cycle is None:
        duration_s = (demonstration.n_samples - 1) / demonstration.rate_hz
    objective = Objective(duration_s=duration_s, randomization=over)
    before = run_episodes(robot, demonstration, duration_s=duration_s, config=config, log=True, controller=controller)
    if not chosen.optimises:
        return Imitation(
            motion=demonstration,
            robot=robot,
            method=method,
            config=config,
            before=before,
            after=before,
            seed=seed,
            duration_s=duration_s,
            simulated_s=duration_s,
            wall_s=time.perf_counter() - began,
        )
    problem = make_problem(
        robot,
        given,
        objective=objective,
        config=config,
        group=chosen.parameters,
        workers=workers,
        n_basis=n_basis,
        moved=moved,
    )
    prepared = time.perf_counter() - began
    optimum = optimize(problem, settings, checkpoint=checkpoint, resume=resume, progress=progress)
    motion = made_with(problem.motion(optimum.x), method, config, over)
    after = run_episodes(robot, motion, duration_s=duration_s, config=config, log=True)
    measured = time.perf_counter()
    held_out = None if over is None else _held_out(over, motion, robot, duration_s, config)
    measured_s = 0.0 if held_out is None else time.perf_counter() - measured
    return Imitation(
        motion=motion,
        robot=robot,
        method=method,
        config=config,
        before=before,
        after=after,
        parameters=problem.parameters,
        values=optimum.x,
        history=optimum.history,
        seed=seed,
        duration_s=duration_s,
        evaluations=optimum.evaluations,
        simulated_s=optimum.simulated_s + 2 * duration_s * (1 if over is None else 1 + HELD_OUT_ROBOTS),
        iterations=len(optimum.history.best),
        wall_s=prepared + optimum.elapsed_s + measured_s,
        interrupted=optimum.interrupted,
        held_out=held_out,
    )


def _warm(given: str | Path | Motion | None, method: Method) -> dict[str, float] | None:
    if given is None:
        return None
    if not method.optimises:
        raise ConfigError(f"a warm start is of a search, and method '{method.name}' has none; leave it out")
    return moved_by(given if isinstance(given, Motion) else Motion.load(given))


def _held_out(
    over: Randomization, motion: Motion, robot: Robot, duration_s: float, config: ControllerConfig
) -> HeldOut:
    conditions = Conditions(disturbances=over.held_out(HELD_OUT_ROBOTS))
    start = nominal_start(HELD_OUT_ROBOTS)
    before, after = (
        run_episodes(robot, m, start=start, duration_s=duration_s, config=config, conditions=conditions)
        for m in (motion.target, motion)
    )
    return HeldOut(over, before, after)
