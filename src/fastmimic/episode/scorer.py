"""Scores robots against a demonstration, step by step."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fastmimic.base.arrays import Array
from fastmimic.base.conventions import GRAVITY
from fastmimic.base.errors import ConfigError
from fastmimic.base.rotations import rotate_planar
from fastmimic.control.config import ControllerConfig
from fastmimic.episode.reward import (
    REWARD_TERMS,
    TALLY,
    WEIGHTS,
    RewardTerm,
    ScoringContext,
    reward_weights,
    score_step,
)
from fastmimic.reference.table import world_root
from fastmimic.robot import Robot


class Counted(NamedTuple):
    """Counters of n episodes so far.

    Attributes:
        tallies: (n,) of `TALLY`.
        own: (n, k) sums of the user's terms.
    """

    tallies: NDArray[Any]
    own: Array

    def since(self, before: "Counted") -> "Counted":
        """Counters since an earlier moment of the same episodes."""
        between = self.tallies.copy()
        for name in between.dtype.names or ():
            between[name] = self.tallies[name] - before.tallies[name]
        return Counted(between, self.own - before.own)


class Scorer:
    """The reward, the falls and the counters of n robots. One thread at a time.

    Attributes:
        tallies: (n,) of `TALLY`.
        context: inputs of the kernel besides the robots' states.
    """

    def __init__(self, robot: Robot, table: NDArray[Any], n: int, config: ControllerConfig, rate_hz: float) -> None:
        """`table` (t,) of `SAMPLE` is the demonstration; `config` gives the load above which a foot has touched
        down."""
        self.tallies = np.zeros(n, TALLY)
        self.context = ScoringContext(
            table=table,
            geometry=robot.geometry,
            foot_radius=robot.foot_radius,
            threshold=config.gait.contact_threshold * robot.mass * GRAVITY,
            dt=1.0 / rate_hz,
            work=np.zeros((2, 3, 3)),
        )
        self._added: list[RewardTerm] = [term for term in REWARD_TERMS.values() if term.function is not None]
        self._weights = reward_weights()
        self._own, self._own_sums = np.zeros((n, len(self._added))), np.zeros((n, len(self._added)))

    def reset(self, rows: NDArray[np.int64] | slice = slice(None)) -> None:
        """Begins the episodes of some robots, or of all."""
        self.tallies[rows] = np.zeros((), TALLY)
        self._own[rows] = self._own_sums[rows] = 0.0

    def score(self, clocks: NDArray[Any], observations: NDArray[Any], memories: NDArray[Any]) -> None:
        """Scores the robots' states, (n,) of `OBSERVATION`, after a control step. `clocks` (n,) of `CLOCK` give the due
        sample of the demonstration and its place; `memories` (n,) of `MEMORY` are the controller's."""
        score_step(self.context, clocks, observations, memories, self.tallies)
        if self._added:
            self._add_own_terms(clocks, observations)

    @property
    def terms(self) -> Array:
        """(n, k) terms of the last step, in the order of `REWARD_TERMS`."""
        return np.hstack([self.tallies["reward"], self._own])

    @property
    def reward(self) -> Array:
        """(n,) reward of the last step."""
        return self.terms @ self._weights

    def counted(self) -> Counted:
        """A copy of the counters."""
        return Counted(self.tallies.copy(), self._own_sums.copy())

    def _add_own_terms(self, clocks: NDArray[Any], observations: NDArray[Any]) -> None:
        """Adds the user's terms; the weights are scaled so that the reward stays in [0, 1]."""
        demonstration = demonstration_in_world(self.context.table, clocks["sample"], clocks["origin"])
        for k, term in enumerate(self._added):
            self._own[:, k] = _checked(term, demonstration, observations)
        up = self.tallies["fallen"] == 0
        self._own_sums[up] += self._own[up]
        built_in = self.tallies["reward"] @ np.array(WEIGHTS)
        self.tallies["reward_sum"][up] += (self.reward - built_in)[up]


def demonstration_in_world(table: NDArray[Any], sample: NDArray[np.int64], origin: Array) -> NDArray[Any]:
    """Due samples (…) of a table (t,) of `SAMPLE`, with root, velocities and accelerations in the world frame. `sample`
    (…) are their indices, `origin` (…, 3) x, y and yaw of the table in the world."""
    demonstration = table[sample]
    position, quat = world_root(table, sample, origin)
    demonstration["root_pos"], demonstration["root_quat"] = position, quat
    for name in ("lin_vel", "ang_vel", "lin_acc", "ang_acc"):
        vector = demonstration[name]
        vector[..., :2] = rotate_planar(origin[..., 2], vector[..., :2])
    return demonstration


def _checked(term: RewardTerm, demonstration: NDArray[Any], observations: NDArray[Any]) -> Array:
    assert term.function is not None
    values = np.asarray(term.function(demonstration, observations), dtype=float)
    if values.shape != observations.shape:
        raise ConfigError(
            f"reward term '{term.name}' gave values of shape {values.shape} for {len(observations)} robots"
        )
    values = np.where(np.isfinite(values), values, 0.0)  # of a robot that is lost
    if values.min() < 0.0 or values.max() > 1.0:
        raise ConfigError(f"reward term '{term.name}' must lie in [0, 1], found {values.min():g} to {values.max():g}")
    return values
