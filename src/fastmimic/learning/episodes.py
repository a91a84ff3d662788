"""Episodes of n robots whose joint targets a policy gives: what the environments and the training step.

Observation, reward and reset are batched and compiled; reward and termination are `score_step`'s, those of every other
method. The robots are divided among threads, each with a MuJoCo batch of its own, so that nothing waits for anything
within a policy step; every random number is drawn by the one generator in the order of the robots, so the results do
not depend on the number of threads.
"""

import math
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from fastmimic.control.config import default_config
from fastmimic.control.reference import advance_clocks, make_clocks, reference_table
from fastmimic.control.state import COMMAND, MEMORY
from fastmimic.control.vectors import quat_to_matrix
from fastmimic.conventions import GRAVITY
from fastmimic.errors import ConfigError
from fastmimic.imitation.reward import TALLY, score_step
from fastmimic.imitation.rollout import JOINT_NOISE, VELOCITY_NOISE
from fastmimic.jit import kernel, record_dtype
from fastmimic.learning.config import ACTION_SIZE, OBSERVATION_SIZE, PolicyConfig, pack_settings
from fastmimic.learning.observation import act, command, make_senses, observe
from fastmimic.learning.randomisation import Randomisation, RandomWorld, random_world
from fastmimic.robot.kinematics import leg_forward
from fastmimic.simulation.mujoco_disturbed import DisturbedMujocoSimulation
from fastmimic.simulation.mujoco_sim import MujocoSimulation

if TYPE_CHECKING:
    from fastmimic.motion.motion import Motion
    from fastmimic.robot import Robot

Array = NDArray[np.float64]
Seen = NDArray[np.float32]

EPISODE_S: Final = 10.0
"""At most, as in an evaluation."""
_LEAST_STEPS: Final = 30
"""Policy steps that a motion that ends leaves at least to an episode."""
_DRAWS: Final = 16
"""Random numbers of a start: phase, 12 joints, 3 velocities."""

COUNT: Final = record_dtype([("steps", "i8"), ("limit", "i8"), ("scored", "f8")])
"""Of one robot's episode: policy steps so far, at most, and the sum of rewards of control steps that was paid out."""

PLACE: Final = record_dtype(
    [
        ("root_pos", "f8", (3,)),
        ("root_quat", "f8", (4,)),
        ("joint_pos", "f8", (12,)),
        ("lin_vel", "f8", (3,)),
        ("ang_vel_b", "f8", (3,)),
        ("joint_vel", "f8", (12,)),
    ]
)
"""Where one robot begins, world frame but for the angular velocity (body frame)."""

BODY: Final = record_dtype(
    [("geometry", "f8", (4, 12)), ("foot_radius", "f8"), ("lower", "f8", (12,)), ("upper", "f8", (12,))]
)
"""What of the robot a start depends on."""


@dataclass(frozen=True, eq=False)
class Outcome:
    """What a step of n robots led to. All arrays are overwritten by the next step but `final`.

    Attributes:
        seen: (n, `OBSERVATION_SIZE`) what is seen now; of those whose episode ended, at the start of the next one.
        reward: (n,) mean over the step's control steps, those after a fall counting 0.
        fell: (n,) bool, episodes that ended by a fall.
        ended: (n,) bool, those that reached their length.
        final: (k, `OBSERVATION_SIZE`) what the k robots whose episode ended (`fell` or `ended`) saw last.
        score: (k,) mean reward over the whole length of each of these episodes, steps after a fall counting 0.
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
    """n robots that imitate one motion, episode after episode. One thread at a time may step it.

    An episode begins at a random phase of the motion (reference-state initialisation), joints and velocity off by as
    much as in an evaluation, and ends by a fall or at its length; the robot then begins the next one at once.
    """

    def __init__(
        self,
        robot: "Robot",
        motion: "Motion",
        n: int,
        config: PolicyConfig | None = None,
        *,
        seed: int = 0,
        threads: int = 1,
        duration_s: float = EPISODE_S,
        perturbed: bool = True,
        randomize: Sequence[Randomisation] = (),
    ) -> None:
        """
        Args:
            robot: the robot.
            motion: what it imitates; of an optimised motion its demonstration.
            n: number of robots.
            config: how policies see and act.
            seed: of all that is random.
            threads: to divide the robots among.
            duration_s: of an episode, s.
            perturbed: whether episodes begin off the reference.
            randomize: in what the robots and their grounds differ.

        Raises:
            ConfigError: the motion is for another robot or rate, or a number out of its range.
        """
        config = config if config is not None else PolicyConfig()
        demonstration = motion.target
        of = demonstration.meta.get("robot")
        if of is not None and of != robot.name:
            raise ConfigError(f"motion '{demonstration.name}' is for robot '{of}', not for '{robot.name}'")
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
        world = random_world(randomize, n, np.random.default_rng([seed, n]))
        bounds = np.linspace(0, n, min(threads, n) + 1).astype(int)
        self._parts = [slice(a, b) for a, b in pairwise(bounds)]
        self._shards = [
            _Shard(robot, demonstration, self._table, part.stop - part.start, config, world.part(part))
            for part in self._parts
        ]
        self._pool = ThreadPoolExecutor(len(self._parts)) if len(self._parts) > 1 else None
        self._seen = np.zeros((n, OBSERVATION_SIZE), np.float32)
        self._reward = np.zeros(n)
        self._fell, self._ended = np.zeros(n, np.bool_), np.zeros(n, np.bool_)

    def reset(self) -> Seen:
        """Begins n episodes; what the robots see, overwritten by the next step."""
        everyone = np.arange(self.n)
        self._begin(everyone)
        return self._seen

    def step(self, actions: NDArray[Any]) -> Outcome:
        """One policy step of all robots.

        Args:
            actions: (n, 12), in units of `PolicyConfig.action_scale`; clipped to the joints' limits.

        Raises:
            ConfigError: actions of another shape.
        """
        if actions.shape != (self.n, ACTION_SIZE):
            raise ConfigError(f"actions of shape {actions.shape}; expected {(self.n, ACTION_SIZE)}")
        given = np.ascontiguousarray(actions, np.float64)
        if self._pool is None:
            self._step_part(0, given)
        else:
            list(self._pool.map(self._step_part, range(len(self._parts)), [given] * len(self._parts)))
        rows = np.flatnonzero(self._fell | self._ended)
        final = self._seen[rows]
        counts = np.concatenate([shard.counts for shard in self._shards])[rows]
        if len(rows):
            self._begin(rows)
        score = counts["scored"] / (counts["limit"] * self.config.decimation)
        return Outcome(self._seen, self._reward, self._fell, self._ended, final, score, counts["steps"])

    @property
    def terms(self) -> Array:
        """(n, 5) the reward's terms in the order of `fastmimic.imitation.reward.TERMS`, at the last control step."""
        return np.concatenate([shard.tallies["reward"] for shard in self._shards])

    def close(self) -> None:
        """Stops the threads."""
        if self._pool is not None:
            self._pool.shutdown()
            self._pool = None

    def state(self) -> dict[str, Any]:
        """All that the future depends on besides the arguments: arrays, and the generator's state as `random`."""
        parts = [shard.state() for shard in self._shards]
        arrays = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
        return {**arrays, "seen": self._seen.copy(), "random": self.random.bit_generator.state}

    def restore(self, state: dict[str, Any]) -> Seen:
        """Goes on from a `state` of episodes with the same arguments; what the robots see."""
        self.random.bit_generator.state = state["random"]
        self._seen[...] = state["seen"]
        for shard, part in zip(self._shards, self._parts, strict=True):
            shard.restore({name: state[name][part] for name in shard.state()})
        return self._seen

    def _phases(self) -> int:
        """Number of samples at which an episode may begin: a motion that ends leaves room for some steps."""
        n = self.motion.n_samples
        if self.motion.cycle is not None:
            return n
        if n - 1 < self.config.decimation:
            raise ConfigError(f"motion '{self.motion.name}' is shorter than a policy step")
        return max(1, n - self.config.decimation * min(self._steps, _LEAST_STEPS))

    def _begin(self, rows: NDArray[np.int64]) -> None:
        draws = self.random.random((len(rows), _DRAWS))
        for shard, part in zip(self._shards, self._parts, strict=True):
            mine = (rows >= part.start) & (rows < part.stop)
            if mine.any():
                noise = float(self._perturbed)
                shard.begin(rows[mine] - part.start, draws[mine], noise, self._room, self._steps, self._seen[part])

    def _step_part(self, index: int, actions: Array) -> None:
        part = self._parts[index]
        self._shards[index].step(
            actions[part], self._seen[part], self._reward[part], self._fell[part], self._ended[part]
        )


class _Shard:
    """Some of the robots, stepped by one thread."""

    def __init__(
        self, robot: "Robot", motion: "Motion", table: NDArray[Any], n: int, config: PolicyConfig, world: RandomWorld
    ) -> None:
        self.simulation: MujocoSimulation = (
            DisturbedMujocoSimulation(robot, n, world.disturbances, control_rate_hz=config.control_rate_hz)
            if world.disturbances
            else MujocoSimulation(robot, n, control_rate_hz=config.control_rate_hz)
        )
        self.counts = np.zeros(n, COUNT)
        self._config = config
        self._tables = table[None]
        self._settings = pack_settings(config, robot)
        self._clocks = make_clocks(motion, n)
        self._senses = make_senses(n)
        self.tallies = np.zeros(n, TALLY)
        self._memories = np.zeros(n, MEMORY)  # of a gait planner, which policies have none of
        self._commands = np.zeros(n, COMMAND)
        self._geometry, self._foot_radius = robot.geometry.rows, robot.foot_radius
        self._body = np.zeros(1, BODY)
        self._body["geometry"], self._body["foot_radius"] = robot.geometry.rows, robot.foot_radius
        self._body["lower"], self._body["upper"] = robot.joint_lower, robot.joint_upper
        self._threshold = default_config().gait.contact_threshold * robot.mass * GRAVITY
        self._dt = 1.0 / config.control_rate_hz
        self._work = np.zeros((2, 3, 3))

    def begin(self, rows: NDArray[np.int64], draws: Array, noise: float, room: int, steps: int, seen: Seen) -> None:
        """Begins episodes of some robots, and writes what these see."""
        places = np.zeros(len(rows), PLACE)
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
            self.tallies,
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
            score_step(
                self._geometry,
                self._foot_radius,
                self._threshold,
                self._dt,
                tables[0],
                clocks,
                observation,
                self._memories,
                self.tallies,
                self._work,
            )
        pay(self._config.decimation, self.tallies, self.counts, reward, fell, ended)
        observe(self._settings, tables, clocks, simulation.observation, self._senses, self._work[0], seen)

    def state(self) -> dict[str, NDArray[Any]]:
        """All that the future depends on, robot by robot."""
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
        """Takes on what `state` gave."""
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
    """Counts a policy step of n robots: its reward, and which episodes it ended and how."""
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
    """What some robots see."""
    for k in range(rows.shape[0]):
        i = slice(rows[k], rows[k] + 1)
        observe(settings, tables, clocks[i], observations[i], senses[i], work[0], seen[i])


@kernel
def begin_episodes(
    body: Any,
    table: Any,
    rows: NDArray[np.int64],
    draws: Array,
    noise: float,
    room: int,
    steps: int,
    decimation: int,
    clocks: Any,
    tallies: Any,
    senses: Any,
    counts: Any,
    places: Any,
    work: Array,
) -> None:
    """Sets some robots on the reference at random phases, as `ClosedLoop` sets its perturbed starts.

    Args:
        body: (1,) of `BODY`.
        table: (t,) of `SAMPLE`.
        rows: (k,) which robots of the n.
        draws: (k, 16) uniform in [0, 1): phase, joints, velocity.
        noise: 1 for starts off the reference, 0 for starts on it.
        room: number of samples at which an episode may begin.
        steps: policy steps of an episode.
        decimation: control steps of a policy step.
        clocks, tallies, senses, counts: (n,) records, changed in place.
        places: (k,) of `PLACE`, the result.
        work: (2, 3, 3) scratch.
    """
    for k in range(rows.shape[0]):
        i = rows[k]
        clock, count, place = clocks[i], counts[i], places[k]
        sample = min(int(draws[k, 0] * room), room - 1)
        _place(body[0], table[sample], clock, draws[k], noise, place, work[0])
        clock.sample, clock.cycle, clock.jump = sample, 0, 0.0
        count.steps, count.scored = 0, 0.0
        count.limit = steps if clock.repeats == 1 else min(steps, (table.shape[0] - 1 - sample) // decimation)
        senses[i].age = -1
        _clear(tallies[i])


@kernel
def _place(body: Any, ref: Any, clock: Any, draws: Array, noise: float, place: Any, rotation: Array) -> None:
    """The reference's sample at the world's origin with heading 0, off by as much as drawn, no foot in the ground."""
    quat_to_matrix(ref.root_quat, rotation)
    yaw = -np.arctan2(rotation[1, 0], rotation[0, 0])
    c, s = np.cos(yaw), np.sin(yaw)
    x, y = ref.root_pos[0], ref.root_pos[1]
    clock.origin[0], clock.origin[1], clock.origin[2] = -(c * x - s * y), -(s * x + c * y), yaw
    q = ref.root_quat
    ch, sh = np.cos(0.5 * yaw), np.sin(0.5 * yaw)
    place.root_quat[0], place.root_quat[1] = ch * q[0] - sh * q[3], ch * q[1] - sh * q[2]
    place.root_quat[2], place.root_quat[3] = ch * q[2] + sh * q[1], ch * q[3] + sh * q[0]
    for j in range(12):
        joint = ref.joint_pos[j] + noise * JOINT_NOISE * (2 * draws[1 + j] - 1)
        place.joint_pos[j] = min(max(joint, body.lower[j]), body.upper[j])
        place.joint_vel[j] = ref.joint_vel[j]
    place.lin_vel[0] = c * ref.lin_vel[0] - s * ref.lin_vel[1]
    place.lin_vel[1] = s * ref.lin_vel[0] + c * ref.lin_vel[1]
    place.lin_vel[2] = ref.lin_vel[2]
    for a in range(3):
        place.lin_vel[a] += noise * VELOCITY_NOISE * (2 * draws[13 + a] - 1)
        # turning about z changes the world, not what the body feels
        place.ang_vel_b[a] = 0.0
        for b in range(3):
            place.ang_vel_b[a] += rotation[b, a] * ref.ang_vel[b]
    lowest = np.inf
    for leg in range(4):
        p = place.joint_pos[3 * leg : 3 * leg + 3]
        fx, fy, fz = leg_forward(body.geometry[leg], p[0], p[1], p[2])
        lowest = min(lowest, rotation[2, 0] * fx + rotation[2, 1] * fy + rotation[2, 2] * fz)
    place.root_pos[0], place.root_pos[1] = 0.0, 0.0
    place.root_pos[2] = max(ref.root_pos[2], body.foot_radius - lowest)


@kernel
def _clear(tally: Any) -> None:
    """An episode's tally at its beginning, as far as the reward and the fall go by it."""
    tally.steps, tally.fallen, tally.reward_sum, tally.jump = 0, 0, 0.0, 0.0
    tally.terms[:] = 0.0
    tally.reward[:] = 0.0
    tally.foot_error_sq[:, :] = 0.0
    tally.peak[:] = 0.0
    tally.clearance_sum[:] = 0.0
    tally.swings[:] = 0
    tally.was_swing[:] = 0
    tally.slip[:] = 0.0
    tally.stances[:] = 0
    tally.foot_xy[:, :] = 0.0
    tally.early_touchdowns = 0
    tally.qp_failures = 0
