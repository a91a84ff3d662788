"""A thread's share of the robots of a training, with its own MuJoCo batch."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from fastmimic.base.arrays import Array
from fastmimic.base.jit import kernel
from fastmimic.control.config import default_config
from fastmimic.episode.scorer import Scorer
from fastmimic.learning.config import PolicyConfig, pack_settings
from fastmimic.learning.observation import act, command, make_senses, observe
from fastmimic.learning.starts import BODY, COUNT, PLACE, begin_episodes
from fastmimic.motion.motion import Motion
from fastmimic.reference.table import advance_clocks, make_clocks
from fastmimic.robot import Robot
from fastmimic.robot.state import COMMAND, MEMORY
from fastmimic.simulation.disturbances import Disturbance
from fastmimic.simulation.mujoco_disturbed import DisturbedMujocoSimulation
from fastmimic.simulation.mujoco_sim import MujocoSimulation

Seen = NDArray[np.float32]


class Shard:
    """A share of the robots, stepped by one thread."""

    def __init__(
        self,
        robot: Robot,
        motion: Motion,
        table: NDArray[Any],
        n: int,
        config: PolicyConfig,
        robots: tuple[Disturbance, ...],
    ) -> None:
        self.simulation: MujocoSimulation = (
            DisturbedMujocoSimulation(robot, n, robots, control_rate_hz=config.control_rate_hz)
            if robots
            else MujocoSimulation(robot, n, control_rate_hz=config.control_rate_hz)
        )
        self.counts = np.zeros(n, COUNT)
        self._config = config
        self._tables = table[None]
        self._settings = pack_settings(config, robot)
        self._clocks = make_clocks(motion, n)
        self._senses = make_senses(n)
        self.scorer = Scorer(robot, table, n, default_config(), config.control_rate_hz)
        self.tallies = self.scorer.tallies
        self._memories = np.zeros(n, MEMORY)  # of the gait planner, which policies do not use
        self._commands = np.zeros(n, COMMAND)
        self._body = np.zeros(1, BODY)
        self._body["geometry"], self._body["foot_radius"] = robot.geometry.rows, robot.foot_radius
        self._body["lower"], self._body["upper"] = robot.joint_lower, robot.joint_upper
        self._work = np.zeros((2, 3, 3))

    def begin(self, rows: NDArray[np.int64], draws: Array, noise: float, room: int, steps: int, seen: Seen) -> None:
        """Begins episodes of the robots in `rows`, and writes their observations."""
        places = np.zeros(len(rows), PLACE)
        self.scorer.reset(rows)
        begin_episodes(
            self._body,
            self._tables[0],
            rows,
            draws,
            noise,
            room,
            steps,
            self._config.decimation,
            self._clocks,
            self._senses,
            self.counts,
            places,
            self._work,
        )
        self.simulation.place(rows, *(places[name] for name in PLACE.names or ()))
        observation = self.simulation.observation
        observe_rows(self._settings, self._tables, rows, self._clocks, observation, self._senses, self._work, seen)

    def step(
        self, actions: Array, seen: Seen, reward: Array, fell: NDArray[np.bool_], ended: NDArray[np.bool_]
    ) -> None:
        """One policy step; writes into the arrays after `actions`."""
        act(self._settings, actions, self._senses)
        simulation, clocks, tables, commands = self.simulation, self._clocks, self._tables, self._commands
        for _ in range(self._config.decimation):
            command(self._settings, self._senses, commands)
            observation = simulation.step(commands)
            advance_clocks(clocks, tables, observation["root_pos"])
            self.scorer.score(clocks, observation, self._memories)
        pay(self._config.decimation, self.tallies, self.counts, reward, fell, ended)
        observe(self._settings, tables, clocks, simulation.observation, self._senses, self._work[0], seen)

    def state(self) -> dict[str, NDArray[Any]]:
        found = {
            "physics": self.simulation.batch.state,
            "observation": self.simulation.observation,
            "clocks": self._clocks,
            "senses": self._senses,
            "tallies": self.tallies,
            "counts": self.counts,
        }
        return {name: array.copy() for name, array in found.items()}

    def restore(self, state: dict[str, NDArray[Any]]) -> None:
        self.simulation.batch.state[...] = state["physics"]
        self.simulation.observation[...] = state["observation"]
        self._clocks[...], self._senses[...] = state["clocks"], state["senses"]
        self.tallies[...], self.counts[...] = state["tallies"], state["counts"]


@kernel
def pay(
    decimation: int,
    tallies: Any,
    counts: Any,
    reward: Array,
    fell: NDArray[np.bool_],
    ended: NDArray[np.bool_],
) -> None:
    """Accounts a policy step of n robots: rewards, falls and ends of episodes."""
    for i in range(reward.shape[0]):
        count = counts[i]
        count.steps += 1
        reward[i] = (tallies[i].reward_sum - count.scored) / decimation
        count.scored = tallies[i].reward_sum
        fell[i] = tallies[i].fallen == 1
        ended[i] = not fell[i] and count.steps >= count.limit


@kernel
def observe_rows(
    settings: Any,
    tables: Any,
    rows: NDArray[np.int64],
    clocks: Any,
    observations: Any,
    senses: Any,
    work: Array,
    seen: Seen,
) -> None:
    """Writes the observations of some robots."""
    for k in range(rows.shape[0]):
        i = slice(rows[k], rows[k] + 1)
        observe(settings, tables, clocks[i], observations[i], senses[i], work[0], seen[i])
