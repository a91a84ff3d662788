"""The results of episodes."""

from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fastmimic.base.arrays import Array, Records
from fastmimic.base.errors import ConfigError
from fastmimic.episode.observer import EstimationErrors
from fastmimic.episode.reward import REWARD_TERMS, Counted, reward_weights
from fastmimic.episode.tracking_errors import tracking_errors
from fastmimic.robot.state import RunLog
from fastmimic.simulation.terrain import Terrain


@dataclass(frozen=True, eq=False)
class Log:
    """Everything of n episodes over t control steps; `Rollout.steps` says where an episode's fall is.

    Attributes:
        rate_hz: control steps a second.
        observation: (n, t) of `OBSERVATION`, the state after each step.
        command: (n, t) of `COMMAND`, what led to it.
        stance: (n, t, 4) bool, the gait planner's leg states.
        recovering: (n, t) bool, whether it takes recovery steps.
        wanted: (n, t, 4) bool, the contact schedule.
        force: (n, t, 4, 3) forces from the stance QP, heading frame, N.
        solve_time: (n, t) s of planning ahead, 0 in steps without.
        terms: (n, t, k) the reward's terms in the order of `REWARD_TERMS`; 0 after a fall.
        demonstration: (n, t) of `SAMPLE`, the demonstration in force, its root and feet in the world and body frame.
        estimate: (n, t) of `OBSERVATION`, the controller's observation after each step, with sensors only.
        reading: (n, t) of `READING`, the sensors' latest by then, with sensors only.
        terrain: the ground; None if it is flat.
        weights: (k,) of the terms.
    """

    rate_hz: float
    observation: Records
    command: Records
    stance: NDArray[np.bool_]
    recovering: NDArray[np.bool_]
    wanted: NDArray[np.bool_]
    force: Array
    solve_time: Array
    terms: Array
    demonstration: Records
    estimate: Records | None = None
    reading: Records | None = None
    terrain: Terrain | None = None
    weights: Array = field(default_factory=reward_weights)

    @property
    def reward(self) -> Array:
        """(n, t) reward per step."""
        return self.terms @ self.weights


@dataclass(frozen=True, eq=False)
class Rollout:
    """Results of n episodes.

    Attributes:
        reward: (n,) mean over the whole episode, steps after a fall count 0.
        reward_animal: (n,) the same against the animal's motion, for a motion that was made executable, else NaN.
        terms: (n, k) means of the reward's terms, in the order of `REWARD_TERMS`.
        fell: (n,) bool.
        steps: (n,) control steps until the fall or the end.
        duration_s: length of an episode, s.
        drift: (n,) m/s that the synchronisation of the reference hides.
        clearance: (n, 4) each foot's greatest height above the ground, mean over its swings, m; NaN without swings.
        slip: (n, 4) mean path that a loaded foot's contact point slides in a stance, m.
        early_contacts: (n,) early touch-downs per second.
        foot_rmse: (n, 4, 3) against the demonstration, body frame, until the fall, m.
        qp_failures: (n,) steps at which the stance QP failed, until the fall.
        tracking: (n,) of `TRACKING_ERRORS`, the field's measures of motion tracking.
        log: the whole course, if requested.
        parts: results of each part of divided episodes; a robot that fell does so in one of them.
        estimation: errors of the estimate over whole episodes, with sensors only.
    """

    reward: Array
    reward_animal: Array
    terms: Array
    fell: NDArray[np.bool_]
    steps: NDArray[np.int64]
    duration_s: float
    drift: Array
    clearance: Array
    slip: Array
    early_contacts: Array
    foot_rmse: Array
    qp_failures: NDArray[np.int64]
    tracking: Records
    log: Log | None = None
    parts: "tuple[Rollout, ...]" = ()
    estimation: EstimationErrors | None = None

    def __repr__(self) -> str:
        n, animal = len(self.reward), float(self.reward_animal.mean())
        against = "" if np.isnan(animal) else f", {animal:.3f} against the animal"
        said = f"reward {self.reward.mean():.3f}{against}, {int(self.fell.sum())} of {n} fell"
        return f"<Rollout of {n} episode{'s' if n > 1 else ''}, {self.duration_s:g} s: {said}>"

    @property
    def course(self) -> Log:
        """The log of a rollout for which it was requested."""
        assert self.log is not None, "this needs a rollout with its log"
        return self.log

    def components(self, episode: int) -> dict[str, float]:
        """The reward's terms of one episode by name."""
        return {name: float(value) for name, value in zip(REWARD_TERMS, self.terms[episode], strict=True)}

    def episodes(self, which: slice) -> "Rollout":
        """Some of the episodes, without `log`, `parts` and `estimation`."""
        known = {f.name: getattr(self, f.name) for f in fields(self)}
        chosen: dict[str, Any] = {name: value[which] for name, value in known.items() if isinstance(value, np.ndarray)}
        return replace(self, **chosen, log=None, parts=(), estimation=None)


def summarised(counted: Counted, steps: int, rate_hz: float) -> Rollout:
    """The results of n episodes, or of a part of them; `steps` counts each episode's control steps, falls or not."""
    t = counted.tallies
    lived = np.maximum(t["steps"], 1)
    with np.errstate(invalid="ignore", divide="ignore"):
        clearance = t["clearance_sum"] / t["swings"]
        slip = t["slip"] / np.maximum(t["stances"], 1)
    return Rollout(
        reward=t["reward_sum"] / steps,
        reward_animal=np.full(len(t), np.nan),
        terms=np.hstack([t["terms"], counted.own]) / steps,
        fell=t["fallen"].astype(bool),
        steps=t["steps"].copy(),
        duration_s=steps / rate_hz,
        drift=t["jump"] / (lived / rate_hz),
        clearance=clearance,
        slip=slip,
        early_contacts=t["early_touchdowns"] / (lived / rate_hz),
        foot_rmse=np.sqrt(t["foot_error_sq"] / lived[:, None, None]),
        qp_failures=t["qp_failures"].copy(),
        tracking=tracking_errors(t),
    )


def run_log(log: Log, episode: int, *, robot: str, motion: str, latency_s: float) -> RunLog:
    """One episode as the robot's own computer knew it. `log` is of a controller with sensors, else `ConfigError` is
    raised: no robot knows the truth. `latency_s` is the readings' age on arrival, as the estimator assumes it."""
    if log.reading is None or log.estimate is None:
        raise ConfigError("a robot's log is of what its sensors say; run the episode with --observe sensors")
    of = log.reading[episode], log.command[episode], log.estimate[episode], log.stance[episode]
    return RunLog(robot, motion, log.rate_hz, latency_s, *of)
