"""`imitate`: turns a motion into an optimised motion that the robot can execute, with rollouts and metrics."""

import time
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Final

import numpy as np

from fastmimic.base.arrays import Array
from fastmimic.base.machine import versions
from fastmimic.base.progress import is_watched
from fastmimic.base.text import plain
from fastmimic.clips.clip import Clip
from fastmimic.control.config import ControllerConfig
from fastmimic.episode.loop import MakeController, run_episodes
from fastmimic.episode.metrics import TRACKED, Metrics, swing_clearance
from fastmimic.episode.rollout import Rollout
from fastmimic.imitation.methods import METHODS, check_controller, made_with
from fastmimic.motion.motion import Motion
from fastmimic.optimize.cma_es import CmaSettings, History, Progress, optimisation_progress, optimize
from fastmimic.optimize.parameters import FinalChoice, Parameter
from fastmimic.optimize.problem import Objective
from fastmimic.optimize.stitched import make_problem
from fastmimic.robot import Robot, load_robot
from fastmimic.runs.loading import load_motion

_FEET: Final = ("early_contacts_per_s", "stance_slip_m", "foot_z_rmse_m", "foot_x_rmse_m")
_BEFORE_AND_AFTER: Final = (*_FEET, "qp_failures", *TRACKED)


@dataclass(frozen=True, eq=False, kw_only=True)
class Imitation:
    """An optimised motion and the course of its optimisation."""

    motion: Motion  # the optimised one, with its demonstration
    robot: Robot
    method: str
    config: ControllerConfig
    before: Rollout  # one nominal episode of `duration_s` with the demonstration, logged
    after: Rollout  # the same with the optimised motion
    parameters: tuple[Parameter, ...] = ()  # the optimised ones, with bounds
    values: Array = field(default_factory=lambda: np.zeros(0))  # (k,) of these, physical units
    history: History | None = None
    seed: int
    duration_s: float
    evaluations: int = 0
    simulated_s: float
    iterations: int = 0
    wall_s: float  # in all; includes the time before a resume
    interrupted: bool = False

    def __repr__(self) -> str:
        kind = type(self).__name__
        return f"<{kind} by {self.method}: {self.motion!r}\n before {self.before!r}\n after  {self.after!r}>"

    @property
    def demonstration(self) -> Motion:
        """The demonstration that scores the robot."""
        return self.motion.target

    @property
    def nothing_gained(self) -> bool:
        """Whether the search found nothing better: the motion is the demonstration as fitted by DMPs."""
        moved = (value != p.initial for p, value in zip(self.parameters, self.values, strict=True))
        return len(self.parameters) > 0 and not any(moved)

    @cached_property
    def kinematic(self) -> Rollout | None:
        """The same episode with the animal's motion as retargeted; None where it was not made executable. Simulated
        when it is first asked for."""
        animal = self.demonstration.animal
        if animal is None:
            return None
        return run_episodes(self.robot, animal, duration_s=self.duration_s, config=self.config, log=True)

    def metrics(self) -> dict[str, Any]:
        """All metrics of the run, JSON-serialisable; undefined ones (no swing, no step) are None."""
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
            **({"reward_animal": both("reward_animal")} if before.reward_animal is not None else {}),
            **({"kinematic": Metrics.of(self.kinematic).as_dict()} if self.kinematic is not None else {}),
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
            "parameters": [asdict(p) | {"value": float(v)} for p, v in zip(self.parameters, self.values, strict=True)],
            "versions": versions(),
        }
        return plain(found)

    def _segments(self) -> list[dict[str, Any]]:
        rate, found = self.demonstration.rate_hz, []
        segments = self.demonstration.provenance.stitched.segments
        for segment, *parts in zip(segments, self.before.parts, self.after.parts, strict=True):
            before, after = (Metrics.of(part) for part in parts)
            found.append(
                {
                    "motion": segment.name,
                    "cycles": segment.cycles,
                    "first_s": segment.first / rate,
                    "last_s": segment.last / rate,
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
    iterations: int | None = None,
    population: int = 10,
    seed: int = 0,
    workers: int | None = None,
    checkpoint: str | Path | None = None,
    resume: bool = False,
    progress: Callable[[Progress], None] | None = None,
    n_basis: int | None = None,
    controller: MakeController | None = None,
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
        duration_s: length of the episodes before and after, and at the most of the search's three cycles, s; a motion
            that does not repeat always runs whole.
        iterations: of CMA-ES; None until its best scores stay the same, at most 200.
        workers: threads; None for one per core. The result does not depend on it.
        progress: called after each iteration; None shows it in a terminal or notebook.
        n_basis: basis functions of each DMP; None for 100, and of a long cycle one each 20 ms.
        controller: of a trained policy, as in `evaluate`; for the method rl, which optimises nothing.
        choice: how the search chooses its result.

    Raises `FastMimicError`: an argument is wrong; the message says which.
    """
    chosen = METHODS[method]
    check_controller(chosen, controller is not None)
    robot = load_robot(robot)
    config = chosen.configure(config)
    controller = controller or chosen.controller
    settings = CmaSettings(iterations, population, seed, choice=choice)
    began = time.perf_counter()
    given = load_motion(source, robot, **overrides)
    demonstration = given.target
    if demonstration.cycle is None:
        duration_s = (demonstration.n_samples - 1) / demonstration.rate_hz
    objective = Objective(duration_s=duration_s)
    before = run_episodes(robot, demonstration, duration_s=duration_s, config=config, log=True, controller=controller)
    unoptimised = Imitation(
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
    if not chosen.optimises:
        return unoptimised
    search = {"objective": objective, "config": config, "workers": workers}
    problem = make_problem(robot, given, group=chosen.parameters, n_basis=n_basis, **search)
    prepared = time.perf_counter() - began
    shown = optimisation_progress() if progress is None and is_watched() else nullcontext(progress)
    with shown as tell:
        optimum = optimize(problem, settings, checkpoint=checkpoint, resume=resume, progress=tell)
    motion = made_with(problem.motion(optimum.x), method, config)
    after = run_episodes(robot, motion, duration_s=duration_s, config=config, log=True)
    return replace(
        unoptimised,
        motion=motion,
        after=after,
        parameters=problem.parameters,
        values=optimum.x,
        history=optimum.history,
        evaluations=optimum.evaluations,
        simulated_s=optimum.simulated_s + 2 * duration_s,
        iterations=len(optimum.history.best),
        wall_s=prepared + optimum.elapsed_s,
        interrupted=optimum.interrupted,
    )
