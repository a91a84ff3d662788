"""The main job: from a motion to an optimised motion that the robot can execute, and what it is worth."""

import math
import platform
import time
from collections.abc import Callable
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from fastmimic.control.config import ControllerConfig, controller_config
from fastmimic.errors import ConfigError, MotionError, did_you_mean
from fastmimic.imitation.reward import TERMS
from fastmimic.imitation.rollout import Rollout, perturbed_start, run_episodes, swing_clearance
from fastmimic.motion.catalogue import open_clip
from fastmimic.motion.clip import Clip
from fastmimic.motion.formats import detect_format
from fastmimic.motion.motion import Motion
from fastmimic.motion.retarget import retarget
from fastmimic.optimize.cma_es import CmaSettings, History, Progress, optimize
from fastmimic.optimize.problem import ImitationProblem, Objective, Parameter
from fastmimic.primitive import MotionDmp
from fastmimic.robot import Robot, load_robot

Array = NDArray[np.float64]

METHODS: Final = ("mbc", "mbc-dmp")
"""`mbc`: the controller follows the retargeted motion. `mbc-dmp`: its DMPs are optimised first (the paper's method)."""


@dataclass(frozen=True, eq=False)
class Imitation:
    """An optimised motion and how it came about.

    Attributes:
        motion: the optimised motion; it carries its demonstration.
        robot: the robot.
        method: one of `METHODS`.
        config: the controller's.
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

    @property
    def demonstration(self) -> Motion:
        """What the robot is scored against."""
        return self.motion.target

    def metrics(self) -> dict[str, Any]:
        """All figures of the run, JSON-serialisable; numbers that do not exist (no swing, no step) are None."""
        before, after = self.before, self.after
        return {
            "motion": self.motion.name,
            "robot": self.robot.name,
            "method": self.method,
            "config": self.config.name,
            "seed": self.seed,
            "duration_s": self.duration_s,
            "reward": {
                "before": float(before.reward[0]),
                "after": float(after.reward[0]),
                "components_before": before.components(0),
                "components_after": after.components(0),
            },
            "fell": {"before": bool(before.fell[0]), "after": bool(after.fell[0])},
            "drift_m_per_s": {"before": float(before.drift[0]), "after": float(after.drift[0])},
            "swing_clearance_m": {
                "demonstration": numbers(swing_clearance(self.demonstration, self.robot.foot_radius)),
                "before": numbers(before.clearance[0]),
                "after": numbers(after.clearance[0]),
            },
            "early_contacts_per_s": {
                "before": float(before.early_contacts[0]),
                "after": float(after.early_contacts[0]),
            },
            "stance_slip_m": {"before": float(np.mean(before.slip[0])), "after": float(np.mean(after.slip[0]))},
            "foot_z_rmse_m": {"before": _rms(before.foot_rmse[0, :, 2]), "after": _rms(after.foot_rmse[0, :, 2])},
            "foot_x_rmse_m": {"before": _rms(before.foot_rmse[0, :, 0]), "after": _rms(after.foot_rmse[0, :, 0])},
            "qp_failures": {"before": int(before.qp_failures[0]), "after": int(after.qp_failures[0])},
            "evaluations": self.evaluations,
            "iterations": self.iterations,
            "interrupted": self.interrupted,
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


def load_motion(source: str | Path | Clip | Motion, robot: Robot | str = "a1", **overrides: Any) -> Motion:
    """A robot motion from anything: our `.npz`, a clip file of any known format, a name, a clip, a motion.

    Args:
        source: a `Motion` is returned as it is; a clip is retargeted to the robot.
        robot: the robot.
        overrides: for clips, as `open_clip` takes them (`fps`, `up`, `scale`, `frames`, `speed`, `yaw_rate`, `duty`).

    Raises:
        FastMimicError: nothing of that name, a file that cannot be read, or an override that does not apply.
    """
    robot = load_robot(robot)
    given = {k: v for k, v in overrides.items() if v is not None}
    if isinstance(source, Motion):
        motion = source
    elif not isinstance(source, Clip) and Path(source).is_file() and detect_format(source) == "npz":
        motion = Motion.load(source)
    else:
        clip = source if isinstance(source, Clip) else open_clip(source, robot=robot, **given)
        return retarget(clip, robot)[0]
    if given:
        raise ConfigError(
            f"{', '.join(sorted(given))} cannot be applied to '{motion.name}': it is already a robot motion"
        )
    of = motion.meta.get("robot")
    if of is not None and of != robot.name:
        raise MotionError(f"motion '{motion.name}' is for robot '{of}', not for '{robot.name}'; retarget its clip anew")
    return motion


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
    **overrides: Any,
) -> Imitation:
    """Turns a motion into one that the robot can execute: retarget, fit DMPs, optimise with the robot in the loop.

    Args:
        source: whatever `load_motion` takes. An optimised motion is optimised anew, against its demonstration.
        robot: the robot, its name, or the path of its MJCF.
        method: one of `METHODS`.
        config: the controller's parameters, or the name of a set.
        duration_s: length of the episodes, s.
        iterations, population, seed: of CMA-ES.
        workers: threads; one for each core if None. The result does not depend on it.
        checkpoint, resume: as in `optimize`.
        progress: called after each iteration.
        overrides: as in `load_motion`.

    Raises:
        FastMimicError: something is wrong with what was given; the message says what.
    """
    if method not in METHODS:
        raise ConfigError(f"unknown method '{method}'; there are {', '.join(METHODS)}{did_you_mean(method, METHODS)}")
    robot = load_robot(robot)
    config = controller_config(config) if isinstance(config, str) else config
    objective, settings = Objective(duration_s=duration_s), CmaSettings(iterations, population, seed)
    began = time.perf_counter()
    demonstration = load_motion(source, robot, **overrides).target
    before = run_episodes(robot, demonstration, duration_s=duration_s, config=config, log=True)
    if method == "mbc":
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
    dmp = MotionDmp.fit(demonstration, robot)
    problem = ImitationProblem(robot, demonstration, dmp, objective=objective, config=config, workers=workers)
    prepared = time.perf_counter() - began
    optimum = optimize(problem, settings, checkpoint=checkpoint, resume=resume, progress=progress)
    motion = problem.motion(optimum.x)
    after = run_episodes(robot, motion, duration_s=duration_s, config=config, log=True)
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
        simulated_s=optimum.simulated_s + 2 * duration_s,
        iterations=len(optimum.history.best),
        wall_s=prepared + optimum.elapsed_s,
        interrupted=optimum.interrupted,
    )


@dataclass(frozen=True, eq=False)
class Evaluation:
    """A motion's worth over several episodes."""

    motion: Motion
    rollout: Rollout

    def as_dict(self) -> dict[str, Any]:
        """Figures over all episodes; means over legs and episodes where there are several."""
        r = self.rollout
        return {
            "motion": self.motion.name,
            "episodes": len(r.reward),
            "duration_s": r.duration_s,
            "reward_mean": float(r.reward.mean()),
            "reward_std": float(r.reward.std()),
            "components": {name: float(r.terms[:, i].mean()) for i, name in enumerate(TERMS)},
            "fell": float(r.fell.mean()),
            "drift_m_per_s": float(r.drift.mean()),
            "swing_clearance_m": numbers(_mean_over_episodes(r.clearance)),
            "early_contacts_per_s": float(r.early_contacts.mean()),
            "stance_slip_m": float(r.slip.mean()),
            "foot_z_rmse_m": _rms(r.foot_rmse[..., 2]),
            "foot_x_rmse_m": _rms(r.foot_rmse[..., 0]),
        }


def evaluate(
    source: str | Path | Clip | Motion,
    robot: Robot | str = "a1",
    *,
    episodes: int = 1,
    duration_s: float = 10.0,
    seed: int = 0,
    config: ControllerConfig | str = "default",
    log: bool = False,
    **overrides: Any,
) -> Evaluation:
    """Runs episodes of a motion and scores them against its demonstration.

    Episode 0 starts at the motion's start, unperturbed; the others at a random phase with joints ± 0.05 rad and
    base velocity ± 0.1 m/s.

    Raises:
        FastMimicError: something is wrong with what was given.
    """
    if episodes < 1:
        raise ConfigError(f"episodes must be at least 1, found {episodes}")
    if not (math.isfinite(duration_s) and duration_s > 0):
        raise ConfigError(f"the duration must be positive, found {duration_s}")
    if seed < 0:
        raise ConfigError(f"seed must not be negative, found {seed}")
    robot = load_robot(robot)
    config = controller_config(config) if isinstance(config, str) else config
    motion = load_motion(source, robot, **overrides)
    start = perturbed_start(episodes, motion.n_samples, np.random.default_rng(seed))
    rollout = run_episodes(robot, motion, start=start, duration_s=duration_s, config=config, log=log)
    return Evaluation(motion, rollout)


def versions() -> dict[str, str]:
    """Versions of this package and of what its results depend on."""
    names = ("fastmimic", "mujoco", "daqp", "cma", "numba", "numpy")
    return {"python": platform.python_version(), **{name: metadata.version(name) for name in names}}


def numbers(values: Array) -> list[float | None]:
    """A list for JSON, which knows no NaN."""
    return [float(v) if np.isfinite(v) else None for v in values]


def _mean_over_episodes(values: Array) -> Array:
    present = np.isfinite(values)
    total = np.where(present, values, 0.0).sum(axis=0)
    return np.where(present.any(axis=0), total / np.maximum(present.sum(axis=0), 1), np.nan)


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
