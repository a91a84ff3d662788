"""Episodes of n robots under a policy's joint targets, for the environments and for training.

Observation and reward are batched and compiled; robots are placed and scored as for every other method. Each thread has
its own robots and MuJoCo batch, so that no thread waits within a policy step. One generator draws all random numbers in
the order of the robots, so the results do not depend on the number of threads.
"""

import math
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from fastmimic.base.arrays import Array, Flags, Indices, Records
from fastmimic.base.errors import ConfigError
from fastmimic.base.jit import record_dtype
from fastmimic.control.config import ControllerConfig
from fastmimic.episode.loop import on_ground, on_reference
from fastmimic.episode.plan import JOINT_NOISE, VELOCITY_NOISE, start_room
from fastmimic.episode.reward import Scorer
from fastmimic.learning.config import ACTION_SIZE, OBSERVATION_SIZE, PolicyConfig, pack_settings
from fastmimic.learning.observation import act, command, make_senses, observe
from fastmimic.motion.motion import Motion
from fastmimic.reference.table import advance_clocks, make_clocks, place_clocks, reference_table
from fastmimic.robot import Robot
from fastmimic.robot.state import COMMAND, MEMORY
from fastmimic.simulation.conditions import Disturbance, Range, draw_uniform
from fastmimic.simulation.mujoco_sim import MujocoSimulation

Seen = NDArray[np.float32]

EPISODE_S: Final = 10.0  # s, greatest length, as in an evaluation
_LEAST_STEPS: Final = 30  # policy steps that every start leaves before the end of a motion
DRAWS: Final = 16  # random numbers of a start: phase, 12 joints, 3 velocities
_COUNT: Final = record_dtype([("steps", "i8"), ("limit", "i8"), ("scored", "f8")])
"""One robot's episode: policy steps so far, their limit, and the rewards of control steps paid out so far."""


@dataclass(frozen=True, eq=False)
class Outcome:
    """Result of a step of n robots. The next step overwrites all arrays but `final`."""

    seen: Seen  # (n, `OBSERVATION_SIZE`) observations; after the end of an episode, those of the next one's start
    reward: Array  # (n,) mean over the step's control steps, 0 after a fall
    fell: Flags  # (n,) episodes that ended by a fall
    ended: Flags  # (n,) those that ended at their full length
    final: Seen  # (k, `OBSERVATION_SIZE`) last observations of the k episodes that ended
    score: Array  # (k,) mean reward of these over the full length, 0 after a fall
    steps: Indices  # (k,) policy steps until their end

    @property
    def done(self) -> Flags:
        """(n,) bool, episodes that ended either way."""
        return self.fell | self.ended


class Episodes:
    """n robots that imitate one motion, or its demonstration, in successive episodes. One thread at a time may step it.
    An episode begins at a random phase (reference-state initialisation), with joints and velocity perturbed as in an
    evaluation, and ends by a fall or at its length; the robot then begins the next one at once."""

    def __init__(
        self,
        robot: Robot,
        motion: Motion,
        n: int,
        config: PolicyConfig = PolicyConfig(),
        *,
        seed: int = 0,
        threads: int = 1,
        duration_s: float = EPISODE_S,
        perturbed: bool = True,
        randomize: Sequence[Range] = (),
    ) -> None:
        """Raises `MotionError` for another robot's motion, `ConfigError` for another rate or a number out of range."""
        demonstration = motion.target
        demonstration.check_robot(robot.name)
        demonstration.check_rate(config.control_rate_hz)
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
        self._shards = []
        for part in self._parts:
            own = tuple(replace(d, values=d.values[part]) for d in robots)
            self._shards.append(Shard(robot, demonstration, self._table, part.stop - part.start, config, own))
        self._pool = ThreadPoolExecutor(len(self._parts)) if len(self._parts) > 1 else None
        self._seen = np.zeros((n, OBSERVATION_SIZE), np.float32)
        self._reward = np.zeros(n)
        self._fell, self._ended = np.zeros(n, np.bool_), np.zeros(n, np.bool_)

    def reset(self) -> Seen:
        """Begins n episodes; returns the observations, which the next step overwrites."""
        self._begin(np.arange(self.n))
        return self._seen

    def step(self, actions: NDArray[Any]) -> Outcome:
        """One policy step; actions (n, 12) in units of `action_scale`, clipped to the limits. Raises `ConfigError`."""
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
        parts = [shard.arrays() for shard in self._shards]
        arrays = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
        return {**arrays, "seen": self._seen.copy(), "random": self.random.bit_generator.state}

    def restore(self, state: dict[str, Any]) -> Seen:
        """Restores a `state` of episodes with the same arguments; returns the observations."""
        self.random.bit_generator.state = state["random"]
        self._seen[...] = state["seen"]
        for shard, part in zip(self._shards, self._parts, strict=True):
            for name, array in shard.arrays().items():
                array[...] = state[name][part]
        return self._seen

    def _phases(self) -> int:
        """Number of samples where an episode may begin; a motion that ends must leave some steps."""
        if self.motion.cycle is None and self.motion.n_samples - 1 < self.config.decimation:
            raise ConfigError(f"motion '{self.motion.name}' is shorter than a policy step")
        return start_room(self.motion, min(self._steps, _LEAST_STEPS) / self.config.rate_hz)

    def _begin(self, rows: Indices) -> None:
        draws = self.random.random((len(rows), DRAWS))
        for shard, part in zip(self._shards, self._parts, strict=True):
            mine = (rows >= part.start) & (rows < part.stop)
            if mine.any():
                noise = float(self._perturbed)
                shard.begin(rows[mine] - part.start, draws[mine], noise, self._room, self._steps, self._seen[part])


class Shard:
    """A share of the robots, stepped by one thread."""

    def __init__(
        self,
        robot: Robot,
        motion: Motion,
        table: Records,
        n: int,
        config: PolicyConfig,
        robots: tuple[Disturbance, ...],
    ) -> None:
        self.simulation = MujocoSimulation(robot, n, robots, control_rate_hz=config.control_rate_hz)
        self.counts = np.zeros(n, _COUNT)
        self._robot, self._config = robot, config
        self._tables = table[None]
        self._settings = pack_settings(config, robot)
        self._clocks = make_clocks(motion, n)
        self._senses = make_senses(n)
        self.scorer = Scorer(robot, table, n, ControllerConfig(), config.control_rate_hz)
        self._memories = np.zeros(n, MEMORY)  # of the gait planner, which policies do not use
        self._commands = np.zeros(n, COMMAND)
        self._rotation = np.zeros((3, 3))

    def begin(self, rows: Indices, draws: Array, noise: float, room: int, steps: int, seen: Seen) -> None:
        """Begins episodes of the robots in `rows` at one of the first `room` samples, of at most `steps` policy steps,
        and writes their observations. `draws` (k, `DRAWS`) are uniform in [0, 1): phase, joints, velocity; `noise` is 1
        for starts off the reference motion, 0 for starts on it."""
        self.scorer.reset(rows)
        sample = np.minimum((draws[:, 0] * room).astype(np.int64), room - 1)
        clocks, senses, out = self._clocks[rows], make_senses(len(rows)), seen[rows]
        place_clocks(clocks, sample, self._tables[0], np.zeros((len(rows), 3)))
        left = (self._tables.shape[1] - 1 - sample) // self._config.decimation
        self.counts["steps"][rows], self.counts["scored"][rows] = 0, 0.0
        self.counts["limit"][rows] = np.where(clocks["repeats"] == 1, steps, np.minimum(steps, left))
        told, drawn = on_reference(self._tables[0], sample, clocks["origin"]), noise * (2 * draws - 1)
        joints = told.joint_pos + JOINT_NOISE * drawn[:, 1:13]
        joints = np.clip(joints, self._robot.joint_lower, self._robot.joint_upper)
        place = on_ground(None, self._robot, told._replace(joint_pos=joints))
        self.simulation.place(rows, *place._replace(lin_vel=place.lin_vel + VELOCITY_NOISE * drawn[:, 13:]))
        placed = self.simulation.observation[rows]
        observe(self._settings, self._tables, clocks, placed, senses, self._rotation, out)
        self._clocks[rows], self._senses[rows], seen[rows] = clocks, senses, out

    def step(self, actions: Array, seen: Seen, reward: Array, fell: Flags, ended: Flags) -> None:
        """One policy step; writes into the arrays after `actions`."""
        act(self._settings, actions, self._senses)
        simulation, clocks, tables, commands = self.simulation, self._clocks, self._tables, self._commands
        for _ in range(self._config.decimation):
            command(self._settings, self._senses, commands)
            observation = simulation.step(commands)
            advance_clocks(clocks, tables, observation["root_pos"], self._memories["haste"])
            self.scorer.score(clocks, observation, self._memories)
        counts, tallies = self.counts, self.scorer.tallies
        counts["steps"] += 1
        reward[...] = (tallies["reward_sum"] - counts["scored"]) / self._config.decimation
        counts["scored"] = tallies["reward_sum"]
        fell[...] = tallies["fallen"] == 1
        ended[...] = ~fell & (counts["steps"] >= counts["limit"])
        observe(self._settings, tables, clocks, simulation.observation, self._senses, self._rotation, seen)

    def arrays(self) -> dict[str, NDArray[Any]]:
        """What lasts from one step to the next."""
        return {
            "physics": self.simulation.batch.state,
            "observation": self.simulation.observation,
            "clocks": self._clocks,
            "senses": self._senses,
            "tallies": self.scorer.tallies,
            "counts": self.counts,
        }
