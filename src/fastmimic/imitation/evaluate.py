"""Runs a motion and scores it."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from fastmimic.base.errors import ConfigError, check_positive
from fastmimic.clips.clip import Clip
from fastmimic.control.config import ControllerConfig
from fastmimic.episode.loop import MakeController, run_episodes
from fastmimic.episode.metrics import Metrics
from fastmimic.episode.plan import Start, default_duration, perturbed_start, start_room
from fastmimic.episode.rollout import Rollout, run_log
from fastmimic.imitation.methods import RL, check_controller, controller_for
from fastmimic.motion.motion import Motion
from fastmimic.robot import Robot, load_robot
from fastmimic.robot.state import RunLog
from fastmimic.runs.loading import load_motion
from fastmimic.simulation.conditions import Conditions

EVALUATION_S: Final = 10.0  # s, default for a motion that repeats
PERTURBED_EPISODES: Final = 8  # of a comparison and of a training
_UNSEEN_SEED: Final = 20230617


@dataclass(frozen=True, eq=False)
class Evaluation:
    """Results of a motion over several episodes, under the controller of the method (one of
    `fastmimic.imitation.methods.METHODS`) with the parameters `config`, the method's changes included."""

    motion: Motion
    rollout: Rollout
    method: str
    config: ControllerConfig
    robot: str
    conditions: Conditions

    def __repr__(self) -> str:
        return f"<Evaluation of {self.motion!r}\n by {self.method}, {self.config.name}: {self.rollout!r}>"

    def run_log(self, episode: int = 0) -> RunLog:
        """The log of an episode with what the robot's own computer knew, for `identify`. Raises `ConfigError` if the
        evaluation kept no log, or its controller saw the true state."""
        if self.rollout.log is None:
            raise ConfigError("the evaluation kept no log; call evaluate(…, log=True)")
        latency = self.conditions.estimator.latency_s
        return run_log(self.rollout.log, episode, robot=self.robot, motion=self.motion.name, latency_s=latency)

    def as_dict(self) -> dict[str, Any]:
        """Metrics over all episodes; means over legs and episodes."""
        about = {"motion": self.motion.name, "method": self.method, "config": self.config.name}
        return about | Metrics.of(self.rollout).as_dict()


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

    Episode 0 starts at the motion's start, unperturbed; the others at a random phase with joints ± 0.05 rad and base
    velocity ± 0.1 m/s. An episode ends at the latest with a motion that does not repeat; the random phases then leave
    room for the whole episode.

    Args:
        source, robot, overrides: as in `load_motion`.
        duration_s: of each, s; None for 10 s, or the whole of a motion that does not repeat.
        method, config: the controller and its parameters; None for those that optimised the motion, else mbc and
            "default". The method does not change the motion.
        log: whether to keep all states.
        conditions: disturbances, simulator and observations.
        controller: of a trained policy (`controlled_by` of `fastmimic.learning`), with the method rl.

    Raises `FastMimicError`: an argument is wrong.
    """
    if episodes < 1:
        raise ConfigError(f"episodes must be at least 1, found {episodes}")
    if duration_s is not None:
        check_positive(duration_s, "the duration")
    if seed < 0:
        raise ConfigError(f"seed must not be negative, found {seed}")
    robot = load_robot(robot)
    motion = load_motion(source, robot, **overrides)
    chosen, config = controller_for(motion, RL if method is None and controller is not None else method, config)
    check_controller(chosen, controller is not None)
    controller = controller or chosen.controller
    if chosen.learned:  # a policy imitates the demonstration, not a motion that was optimised for another controller
        motion = motion.target
    duration_s = duration_s if duration_s is not None else default_duration(motion, EVALUATION_S)
    conditions = conditions or Conditions()
    if not isinstance(conditions, Conditions):
        raise ConfigError(f"conditions are a Conditions(disturbances=…), found {conditions!r}")
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
    return Evaluation(motion, rollout, chosen.name, config, robot.name, conditions)


def unseen_start(motion: Motion, seconds: float, perturbed: int) -> Start:
    """A nominal start and so many perturbed ones, for episodes of that length: the same ones in every comparison and
    training, which no optimisation uses."""
    return perturbed_start(perturbed + 1, start_room(motion, seconds), np.random.default_rng(_UNSEEN_SEED))
