"""The main job: from a motion to an optimised motion that the robot can execute, and what it is worth."""

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np

from fastmimic.base.arrays import Array
from fastmimic.base.errors import ConfigError
from fastmimic.base.machine import versions
from fastmimic.base.text import plain
from fastmimic.clips.clip import Clip
from fastmimic.control.config import ControllerConfig
from fastmimic.episode.loop import MakeController, run_episodes
from fastmimic.episode.metrics import Metrics, swing_clearance
from fastmimic.episode.plan import default_duration, nominal_start, perturbed_start, start_room
from fastmimic.episode.rollout import Rollout, run_log
from fastmimic.episode.run_log import RunLog
from fastmimic.imitation.methods import RL, Method, check_controller, controller_for, made_with, method_named
from fastmimic.motion.motion import Motion
from fastmimic.optimize.cma_es import CmaSettings, History, Progress, optimize
from fastmimic.optimize.parameters import Parameter, moved_by
from fastmimic.optimize.problem import Objective
from fastmimic.optimize.randomization import HELD_OUT_ROBOTS, Randomization, randomization
from fastmimic.optimize.stitched import make_problem
from fastmimic.primitive.rhythmic import N_BASIS
from fastmimic.robot import Robot, load_robot
from fastmimic.runs.loading import load_motion
from fastmimic.simulation.conditions import Conditions

EVALUATION_S: Final = 10.0
"""Length of an episode of a motion that repeats, if nothing is said."""
_BEFORE_AND_AFTER: Final = ("early_contacts_per_s", "stance_slip_m", "foot_z_rmse_m", "foot_x_rmse_m", "qp_failures")


@dataclass(frozen=True, eq=False)
class HeldOut:
    """What a search over several robots is worth on robots that it has not met.

    Attributes:
        randomization: of the search.
        before, after: an episode with each of the held-out robots, from the motion's start, with the demonstration and
            with the optimised motion.
    """

    randomization: Randomization
    before: Rollout
    after: Rollout

    def as_dict(self) -> dict[str, Any]:
        """What was asked for, and what came of it, JSON-serialisable."""
        return {
            **self.randomization.as_dict(),
            "held_out": {
                "robots": len(self.before.reward),
                "before": _over_robots(self.before),
                "after": _over_robots(self.after),
            },
        }


def _over_robots(rollout: Rollout) -> dict[str, float]:
    found = Metrics.of(rollout)
    return {"mean": found.reward_mean, "std": found.reward_std, "worst": found.reward_worst, "fell": found.fell}


@dataclass(frozen=True, eq=False)
class Imitation:
    """An optimised motion and how it came about.

    Attributes:
        motion: the optimised motion; it carries its demonstration.
        robot: the robot.
        method: one of `fastmimic.imitation.methods.METHODS`.
        config: the controller's, as the method has it.
        before, after: one nominal episode of `duration_s` with the demonstration and with the optimised motion, logged.
        parameters: what was optimised, with bounds.
        values: (k,) the values found, physical units.
        history: the course of the optimisation; None without one.
        seed: of the optimiser.
        evaluations: episodes run by the optimisation.
        simulated_s: simulated time in all, s.
        iterations: generations.
        wall_s: time for all this, s; after a resume, with the time before it.
        interrupted: whether the optimisation was stopped early.
        held_out: how it fares on other robots; None if candidates met only the robot as it is.
    """

    motion: Motion
    robot: Robot
    method: str
    config: ControllerConfig
    before: Rollout
    after: Rollout
    parameters: tuple[Parameter, ...]
    values: Array
    history: History | None
    seed: int
    duration_s: float
    evaluations: int
    simulated_s: float
    iterations: int
    wall_s: float
    interrupted: bool
    held_out: HeldOut | None = field(default=None, kw_only=True)

    @property
    def demonstration(self) -> Motion:
        """What the robot is scored against."""
        return self.motion.target

    def metrics(self) -> dict[str, Any]:
        """All figures of the run, JSON-serialisable; numbers that do not exist (no swing, no step) are None."""
        before, after = Metrics.of(self.before), Metrics.of(self.after)

        def both(name: str) -> dict[str, Any]:
            return {"before": getattr(before, name), "after": getattr(after, name)}

        found = {
            "motion": self.motion.name,
            "robot": self.robot.name,
            "method": self.method,
            "config": self.config.name,
            "seed": self.seed,
            "duration_s": self.duration_s,
            "reward": {
                **both("reward_mean"),
                "components_before": before.components,
                "components_after": after.components,
            },
            **({"randomization": self.held_out.as_dict()} if self.held_out is not None else {}),
            "fell": both("fell_once"),
            "drift_m_per_s": both("drift_m_per_s"),
            "swing_clearance_m": {
                "demonstration": swing_clearance(self.demonstration, self.robot.foot_radius),
                **both("swing_clearance_m"),
            },
            **{name: both(name) for name in _BEFORE_AND_AFTER},
            "evaluations": self.evaluations,
            "iterations": self.iterations,
            "interrupted": self.interrupted,
            **({"segments": self._segments()} if self.demonstration.parts else {}),
            "wall_s": self.wall_s,
            "simulated_s": self.simulated_s,
            "realtime_factor": self.simulated_s / self.wall_s if self.wall_s > 0 else None,
            "parameters": [
                {
                    "name": p.name,
                    "unit": p.unit,
                    "lower": p.lower,
                    "upper": p.upper,
                    "initial": p.initial,
                    "value": float(v),
                }
                for p, v in zip(self.parameters, self.values, strict=True)
            ],
            "versions": versions(),
        }
        return plain(found)

    def _segments(self) -> list[dict[str, Any]]:
        """Figures of each segment of a stitched motion; empty for others."""
        rate, found = self.demonstration.rate_hz, []
        segments = self.demonstration.meta.get("stitch", {}).get("segments", [])
        for segment, *parts in zip(segments, self.before.parts, self.after.parts, strict=True):
            before, after = (Metrics.of(part) for part in parts)
            found.append(
                {
                    "motion": segment["name"],
                    "cycles": segment["cycles"],
                    "first_s": segment["first"] / rate,
                    "last_s": segment["last"] / rate,
                    "reward": {"before": before.reward_mean, "after": after.reward_mean},
                    "fell": {"before": before.fell_once, "after": after.fell_once},
                    "swing_clearance_m": {"before": before.swing_clearance_m, "after": after.swing_clearance_m},
                }
            )
        return found


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
    **overrides: Any,
) -> Imitation:
    """Turns a motion into one that the robot can execute: retarget, fit DMPs, optimise with the robot in the loop.

    Args:
        source: whatever `load_motion` takes. An optimised motion is optimised anew, against its demonstration; a
            stitched one is optimised further.
        robot: the robot, its name, or the path of its MJCF.
        method: one of `fastmimic.imitation.methods.METHODS`.
        config: the controller's parameters, or the name of a set.
        duration_s: length of the episodes, s; those of a motion that does not repeat are the whole of it.
        iterations, population, seed: of CMA-ES.
        workers: threads; one for each core if None. The result does not depend on it.
        checkpoint, resume: as in `optimize`.
        progress: called after each iteration.
        n_basis: basis functions of each DMP.
        controller: of a trained policy, as in `evaluate`; for the method rl, which optimises nothing.
        randomize: over which robots each candidate is scored, or just over how many; None for the robot as it is.
        warm_start: an optimised motion, or its file, modulated like which the search begins; None for the unmodulated
            motion.
        overrides: as in `load_motion`.

    Raises:
        FastMimicError: something is wrong with what was given; the message says what.
    """
    chosen = method_named(method)
    check_controller(chosen, controller is not None)
    robot = load_robot(robot)
    config = chosen.configure(config)
    controller = controller or chosen.controller
    settings = CmaSettings(iterations, population, seed)
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
            parameters=(),
            values=np.zeros(0),
            history=None,
            seed=seed,
            duration_s=duration_s,
            evaluations=0,
            simulated_s=duration_s,
            iterations=0,
            wall_s=time.perf_counter() - began,
            interrupted=False,
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
    """How the motion is modulated that a search begins from."""
    if given is None:
        return None
    if not method.optimises:
        raise ConfigError(f"a warm start is of a search, and method '{method.name}' has none; leave it out")
    return moved_by(given if isinstance(given, Motion) else Motion.load(given))


def _held_out(
    over: Randomization, motion: Motion, robot: Robot, duration_s: float, config: ControllerConfig
) -> HeldOut:
    """A motion and its demonstration on the robots that nothing was optimised or chosen on."""
    conditions = Conditions(disturbances=over.held_out(HELD_OUT_ROBOTS))
    start = nominal_start(HELD_OUT_ROBOTS)
    before, after = (
        run_episodes(robot, m, start=start, duration_s=duration_s, config=config, conditions=conditions)
        for m in (motion.target, motion)
    )
    return HeldOut(over, before, after)


@dataclass(frozen=True, eq=False)
class Evaluation:
    """A motion's worth over several episodes.

    Attributes:
        motion: what was run.
        rollout: its episodes.
        method: one of `fastmimic.imitation.methods.METHODS`: whose controller ran it.
        config: the controller's parameters, as the method has them.
        robot: the robot's name.
        conditions: under which it ran.
    """

    motion: Motion
    rollout: Rollout
    method: str
    config: ControllerConfig
    robot: str
    conditions: Conditions

    def run_log(self, episode: int = 0) -> RunLog:
        """What the robot's own computer knew of an episode, for `fastmimic.identification.identify.identify`.

        Raises:
            ConfigError: the evaluation kept no log, or its controller was told the truth.
        """
        if self.rollout.log is None:
            raise ConfigError("the evaluation kept no log; call evaluate(…, log=True)")
        latency = self.conditions.estimator.latency_s
        return run_log(self.rollout.log, episode, robot=self.robot, motion=self.motion.name, latency_s=latency)

    def as_dict(self) -> dict[str, Any]:
        """Figures over all episodes; means over legs and episodes where there are several."""
        return {
            "motion": self.motion.name,
            "method": self.method,
            "config": self.config.name,
            **Metrics.of(self.rollout).as_dict(),
        }


def evaluate(
    source: str | Path | Clip | Motion,
    robot: Robot | str = "a1",
    *,
    episodes: int = 1,
    duration_s: float | None = None,
    seed: int = 0,
    method: str | None = None,
    config: ControllerConfig | str | None = None,
    log: bool = False,
    conditions: Conditions | None = None,
    controller: MakeController | None = None,
    **overrides: Any,
) -> Evaluation:
    """Runs episodes of a motion and scores them against its demonstration.

    Episode 0 starts at the motion's start, unperturbed; the others at a random phase with joints ± 0.05 rad and
    base velocity ± 0.1 m/s. An episode of a motion that does not repeat ends with it at the latest, and its random
    phases leave room for the whole episode.

    Args:
        source, robot, overrides: as in `load_motion`.
        episodes: how many.
        duration_s: of each, s; if None 10 s, or the whole of a motion that does not repeat.
        seed: of the perturbations.
        method, config: whose controller, and its parameters; if None those with which the motion was optimised, or mbc
            and "default" for others. Of the `method` only its controller counts: the motion is run as it is.
        log: whether to keep the whole course.
        conditions: what the robot meets and what its controller sees.
        controller: of a trained policy (`fastmimic.learning.controller.controlled_by`), which makes the method rl.

    Raises:
        FastMimicError: something is wrong with what was given.
    """
    if episodes < 1:
        raise ConfigError(f"episodes must be at least 1, found {episodes}")
    if duration_s is not None and not (math.isfinite(duration_s) and duration_s > 0):
        raise ConfigError(f"the duration must be positive, found {duration_s}")
    if seed < 0:
        raise ConfigError(f"seed must not be negative, found {seed}")
    robot = load_robot(robot)
    motion = load_motion(source, robot, **overrides)
    chosen, config = controller_for(motion, RL if method is None and controller is not None else method, config)
    check_controller(chosen, controller is not None)
    controller = controller or chosen.controller
    if chosen.learned:  # a policy imitates the demonstration, whatever was optimised for another controller
        motion = motion.target
    duration_s = duration_s if duration_s is not None else default_duration(motion, EVALUATION_S)
    start = perturbed_start(episodes, start_room(motion, duration_s), np.random.default_rng(seed))
    rollout = run_episodes(
        robot,
        motion,
        start=start,
        duration_s=duration_s,
        config=config,
        log=log,
        conditions=conditions,
        controller=controller,
    )
    return Evaluation(motion, rollout, chosen.name, config, robot.name, conditions or Conditions())
