"""Episodes of n robots under a policy's joint targets, for the environments and for training.

Observation, reward and reset are batched and compiled; `score_step` gives reward and termination, as for every other
method. Each thread has its own robots and MuJoCo batch, so that no thread waits within a policy step. One generator
draws all random numbers in the order of the robots, so the results do not depend on the number of threads.
"""

import math
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from fastmimic.base.arrays import Array
from fastmimic.base.errors import ConfigError
from fastmimic.learning.config import ACTION_SIZE, OBSERVATION_SIZE, PolicyConfig
from fastmimic.learning.shard import DRAWS, Shard
from fastmimic.motion.motion import Motion
from fastmimic.reference.table import reference_table
from fastmimic.robot import Robot
from fastmimic.simulation.disturbances import Range, draw_uniform
from fastmimic.simulation.disturbances import part as part_of

Seen = NDArray[np.float32]

EPISODE_S: Final = 10.0  # s, greatest length, as in an evaluation
_LEAST_STEPS: Final = 30  # policy steps that every start leaves before the end of a motion


@dataclass(frozen=True, eq=False)
class Outcome:
    """Result of a step of n robots. The next step overwrites all arrays but `final`.

    Attributes:
        seen: (n, `OBSERVATION_SIZE`) observations; after the end of an episode, those of the next one's start.
        reward: (n,) mean over the step's control steps, 0 after a fall.
        fell, ended: (n,) bool, episodes that ended by a fall, or at their full length.
        final: (k, `OBSERVATION_SIZE`) last observations of the k episodes that ended.
        score: (k,) mean reward of these over the full length, 0 after a fall.
        steps: (k,) policy steps until their end.
    """

    seen: Seen
    reward: Array
    fell: NDArray[np.bool_]
    ended: NDArray[np.bool_]
    final: Seen
    score: Array
    steps: NDArray[np.int64]

    @property
    def done(self) -> NDArray[np.bool_]:
        """(n,) bool, episodes that ended either way."""
        return self.fell | self.ended


class Episodes:
    """n robots that imitate one motion in successive episodes. Only one thread at a time may step it.

    Of an optimised motion they imitate the demonstration. An episode begins at a random phase (reference-state
    initialisation), with joints and velocity perturbed as in an evaluation, and ends by a fall or at its length; the
    robot then begins the next one at once.
    """

    def __init__(
        self,
        robot: Robot,
        motion: Motion,
        n: int,
        config: PolicyConfig | None = None,
        *,
        seed: int = 0,
        threads: int = 1,
        duration_s: float = EPISODE_S,
        perturbed: bool = True,
        randomize: Sequence[Range] = (),
    ) -> None:
        """Raises `MotionError` for another robot's motion, `ConfigError` for another rate or a number out of range."""
        config = config if config is not None else PolicyConfig()
        demonstration = motion.target
        demonstration.check_robot(robot.name)
        if abs(demonstration.rate_hz - config.control_rate_hz) > 1e-9:
            raise ConfigError(
                f"motion '{demonstration.name}' has {demonstration.rate_hz:g} samples a second and joint targets go out"
                f" at {config.control_rate_hz:g} Hz; retarget the clip with that rate"
            )
        for what, count in (("robots", n), ("threads", threads)):
            if count < 1:
                raise ConfigError(f"{what} must be at least 1, found {count}")
        if not (math.isfinite(duration_s) and duration_s * config.rate_hz >= 1):
            raise ConfigError(f"the duration must be at least a policy step, found {duration_s:g} s")
        self.robot, self.motion, self.config, self.n = robot, demonstration, config, n
        self.random = np.random.default_rng(seed)
        self.duration_s = duration_s
        self._perturbed = perturbed
        self._table = reference_table(demonstration, robot)
        self._steps = max(1, round(duration_s * config.rate_hz))
        self._room = self._phases()
        robots = draw_uniform(randomize, n, np.random.default_rng([seed, n]))
        bounds = np.linspace(0, n, min(threads, n) + 1).astype(int)
        self._parts = [slice(a, b) for a, b in pairwise(bounds)]
        self._shards = [
            Shard(robot, demonstration, self._table, part.stop - part.start, config, part_of(robots, part))
            for part in self._parts
        ]
        self._pool = ThreadPoolExecutor(len(self._parts)) if len(self._parts) > 1 else None
        self._seen = np.zeros((n, OBSERVATION_SIZE), np.float32)
        self._reward = np.zeros(n)
        self._fell, self._ended = np.zeros(n, np.bool_), np.zeros(n, np.bool_)

    def reset(self) -> Seen:
        """Begins n episodes; returns the observations, which the next step overwrites."""
        self._begin(np.arange(self.n))
        return self._seen

    def step(self, actions: NDArray[Any]) -> Outcome:
        """One policy step; actions (n, 12) in units of `PolicyConfig.action_scale`, clipped to the joints' limits.
        Raises `ConfigError` for actions of another shape."""
        if actions.shape != (self.n, ACTION_SIZE):
            raise ConfigError(f"actions of shape {actions.shape}; expected {(self.n, ACTION_SIZE)}")
        given = np.ascontiguousarray(actions, np.float64)
        arrays: tuple[NDArray[Any], ...] = (given, self._seen, self._reward, self._fell, self._ended)

        def step(shard: Shard, part: slice) -> None:
            shard.step(*(array[part] for array in arrays))

        run = map if self._pool is None else self._pool.map
        list(run(step, self._shards, self._parts))
        rows = np.flatnonzero(self._fell | self._ended)
        final = self._seen[rows]
        counts = np.concatenate([shard.counts for shard in self._shards])[rows]
        if len(rows):
            self._begin(rows)
        score = counts["scored"] / (counts["limit"] * self.config.decimation)
        return Outcome(self._seen, self._reward, self._fell, self._ended, final, score, counts["steps"])

    @property
    def terms(self) -> Array:
        """(n, k) the reward's terms at the last control step, in the order of `REWARD_TERMS`."""
        return np.concatenate([shard.scorer.terms for shard in self._shards])

    def close(self) -> None:
        if self._pool is not None:
            self._pool.shutdown()
            self._pool = None

    def state(self) -> dict[str, Any]:
        """The complete state apart from the arguments: arrays, and the generator's state as `random`."""
        parts = [shard.state() for shard in self._shards]
        arrays = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
        return {**arrays, "seen": self._seen.copy(), "random": self.random.bit_generator.state}

    def restore(self, state: dict[str, Any]) -> Seen:
        """Restores a `state` of episodes with the same arguments; returns the observations."""
        self.random.bit_generator.state = state["random"]
        self._seen[...] = state["seen"]
        for shard, part in zip(self._shards, self._parts, strict=True):
            shard.restore({name: state[name][part] for name in shard.state()})
        return self._seen

    def _phases(self) -> int:
        """Number of samples where an episode may begin; a motion that ends must leave some steps."""
        n = self.motion.n_samples
        if self.motion.cycle is not None:
            return n
        if n - 1 < self.config.decimation:
            raise ConfigError(f"motion '{self.motion.name}' is shorter than a policy step")
        return max(1, n - self.config.decimation * min(self._steps, _LEAST_STEPS))

    def _begin(self, rows: NDArray[np.int64]) -> None:
        draws = self.random.random((len(rows), DRAWS))
        for shard, part in zip(self._shards, self._parts, strict=True):
            mine = (rows >= part.start) & (rows < part.stop)
            if mine.any():
                noise = float(self._perturbed)
                shard.begin(rows[mine] - part.start, draws[mine], noise, self._room, self._steps, self._seen[part])
