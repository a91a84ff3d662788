"""Runs a motion and scores it."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from fastmimic.base.errors import ConfigError
from fastmimic.clips.clip import Clip
from fastmimic.control.config import ControllerConfig
from fastmimic.episode.loop import MakeController, run_episodes
from fastmimic.episode.metrics import Metrics
from fastmimic.episode.plan import default_duration, perturbed_start, start_room
from fastmimic.episode.rollout import Rollout, run_log
from fastmimic.episode.run_log import RunLog
from fastmimic.imitation.methods import RL, check_controller, controller_for
from fastmimic.motion.motion import Motion
from fastmimic.robot import Robot, load_robot
from fastmimic.runs.loading import load_motion
from fastmimic.simulation.conditions import Conditions

EVALUATION_S: Final = 10.0
"""Length of an episode of a motion that repeats, if nothing is said."""


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
        controller: of a trained policy (`controlled_by` of `fastmimic.learning`), which makes the method rl.

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
