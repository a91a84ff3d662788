"""A thread's share of the robots of a training, with its own MuJoCo batch.

Episodes start on the reference motion at a random phase (reference-state initialisation), or slightly off it.
"""

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from fastmimic.base.arrays import Array
from fastmimic.base.jit import kernel, record_dtype
from fastmimic.base.vectors import quat_to_matrix
from fastmimic.control.config import default_config
from fastmimic.episode.loop import Placement
from fastmimic.episode.plan import JOINT_NOISE, VELOCITY_NOISE
from fastmimic.episode.reward import Scorer
from fastmimic.learning.config import PolicyConfig, pack_settings
from fastmimic.learning.observation import act, command, make_senses, observe
from fastmimic.motion.motion import Motion
from fastmimic.reference.table import advance_clocks, make_clocks
from fastmimic.robot import Robot
from fastmimic.robot.kinematics import leg_forward
from fastmimic.robot.state import COMMAND, MEMORY
from fastmimic.simulation.disturbances import Disturbance
from fastmimic.simulation.mujoco_disturbed import DisturbedMujocoSimulation
from fastmimic.simulation.mujoco_sim import MujocoSimulation

Seen = NDArray[np.float32]

DRAWS: Final = 16  # random numbers of a start: phase, 12 joints, 3 velocities
_COUNT: Final = record_dtype([("steps", "i8"), ("limit", "i8"), ("scored", "f8")])
"""One robot's episode: policy steps so far, their limit, and the rewards of control steps paid out so far."""


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
        self.counts = np.zeros(n, _COUNT)
        self._config = config
        self._tables = table[None]
        self._settings = pack_settings(config, robot)
        self._clocks = make_clocks(motion, n)
        self._senses = make_senses(n)
        self.scorer = Scorer(robot, table, n, default_config(), config.control_rate_hz)
        self._memories = np.zeros(n, MEMORY)  # of the gait planner, which policies do not use
        self._commands = np.zeros(n, COMMAND)
        self._rotation = np.zeros((3, 3))

    def begin(self, rows: NDArray[np.int64], draws: Array, noise: float, room: int, steps: int, seen: Seen) -> None:
        """Begins episodes of the robots in `rows`, and writes their observations.

        Args:
            draws: (k, `DRAWS`) uniform in [0, 1): phase, joints, velocity.
            noise: 1 for starts off the reference motion, 0 for starts on it.
            room: number of samples where an episode may begin.
            steps: greatest number of policy steps.
        """
        self.scorer.reset(rows)
        sample = np.minimum((draws[:, 0] * room).astype(np.int64), room - 1)
        clocks, senses, out = self._clocks[rows], make_senses(len(rows)), seen[rows]
        clocks["sample"], clocks["cycle"], clocks["jump"] = sample, 0, 0.0
        left = (self._tables.shape[1] - 1 - sample) // self._config.decimation
        self.counts["steps"][rows], self.counts["scored"][rows] = 0, 0.0
        self.counts["limit"][rows] = np.where(clocks["repeats"] == 1, steps, np.minimum(steps, left))
        place = Placement(*(np.zeros((len(rows), size)) for size in (3, 4, 12, 3, 3, 12)))
        place_robots(self._settings, self.scorer.context, draws, noise, clocks, place, self._rotation)
        self.simulation.place(rows, *place)
        placed = self.simulation.observation[rows]
        observe(self._settings, self._tables, clocks, placed, senses, self._rotation, out)
        self._clocks[rows], self._senses[rows], seen[rows] = clocks, senses, out

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
        counts, tallies = self.counts, self.scorer.tallies
        counts["steps"] += 1
        reward[...] = (tallies["reward_sum"] - counts["scored"]) / self._config.decimation
        counts["scored"] = tallies["reward_sum"]
        fell[...] = tallies["fallen"] == 1
        ended[...] = ~fell & (counts["steps"] >= counts["limit"])
        observe(self._settings, tables, clocks, simulation.observation, self._senses, self._rotation, seen)

    def state(self) -> dict[str, NDArray[Any]]:
        """Copies of all arrays that change."""
        return {name: array.copy() for name, array in self._arrays().items()}

    def restore(self, state: dict[str, NDArray[Any]]) -> None:
        for name, array in self._arrays().items():
            array[...] = state[name]

    def _arrays(self) -> dict[str, NDArray[Any]]:
        return {
            "physics": self.simulation.batch.state,
            "observation": self.simulation.observation,
            "clocks": self._clocks,
            "senses": self._senses,
            "tallies": self.scorer.tallies,
            "counts": self.counts,
        }


@kernel
def place_robots(
    settings: Any, context: Any, draws: Array, noise: float, clocks: Any, place: Any, rotation: Array
) -> None:
    """Places k robots on their clocks' samples of the reference motion, at the world's origin with heading 0,
    perturbed by `draws` like the perturbed starts of `ClosedLoop`, with all feet above the ground.

    Args:
        settings: (1,) of `SETTINGS`.
        context: the `ScoringContext`.
        clocks: (k,) of `CLOCK`; their origins are written.
        place: the `Placement` to write.
        rotation: (3, 3) scratch.
    """
    for k in range(clocks.shape[0]):
        ref = context.table[clocks[k].sample]
        quat_to_matrix(ref.root_quat, rotation)
        yaw = -np.arctan2(rotation[1, 0], rotation[0, 0])
        c, s = np.cos(yaw), np.sin(yaw)
        x, y = ref.root_pos[0], ref.root_pos[1]
        clocks[k].origin[0], clocks[k].origin[1], clocks[k].origin[2] = -(c * x - s * y), -(s * x + c * y), yaw
        q = ref.root_quat
        ch, sh = np.cos(0.5 * yaw), np.sin(0.5 * yaw)
        place.root_quat[k, 0], place.root_quat[k, 1] = ch * q[0] - sh * q[3], ch * q[1] - sh * q[2]
        place.root_quat[k, 2], place.root_quat[k, 3] = ch * q[2] + sh * q[1], ch * q[3] + sh * q[0]
        for j in range(12):
            joint = ref.joint_pos[j] + noise * JOINT_NOISE * (2 * draws[k, 1 + j] - 1)
            place.joint_pos[k, j] = min(max(joint, settings[0].lower[j]), settings[0].upper[j])
            place.joint_vel[k, j] = ref.joint_vel[j]
        place.lin_vel[k, 0] = c * ref.lin_vel[0] - s * ref.lin_vel[1]
        place.lin_vel[k, 1] = s * ref.lin_vel[0] + c * ref.lin_vel[1]
        place.lin_vel[k, 2] = ref.lin_vel[2]
        for a in range(3):
            place.lin_vel[k, a] += noise * VELOCITY_NOISE * (2 * draws[k, 13 + a] - 1)
            # a turn about z changes the world, not the body's sensors
            place.ang_vel_b[k, a] = 0.0
            for b in range(3):
                place.ang_vel_b[k, a] += rotation[b, a] * ref.ang_vel[b]
        lowest = np.inf
        for leg in range(4):
            p = place.joint_pos[k, 3 * leg : 3 * leg + 3]
            fx, fy, fz = leg_forward(context.geometry[leg], p[0], p[1], p[2])
            lowest = min(lowest, rotation[2, 0] * fx + rotation[2, 1] * fy + rotation[2, 2] * fz)
        place.root_pos[k, 0], place.root_pos[k, 1] = 0.0, 0.0
        place.root_pos[k, 2] = max(ref.root_pos[2], context.foot_radius - lowest)
