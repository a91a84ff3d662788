"""The closed loop: robots in simulation under the controller, scored against the demonstration."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Final, Protocol

import numpy as np
from numpy.typing import NDArray

from fastmimic.base.arrays import Array
from fastmimic.base.conventions import GRAVITY
from fastmimic.base.errors import ConfigError, MotionError
from fastmimic.base.rotations import quat_rotate, quat_rotate_inverse, rotate_planar, yaw_from_quat
from fastmimic.control.config import ControllerConfig, default_config, pack_config
from fastmimic.control.controller import Controller
from fastmimic.control.load import loaded_robot
from fastmimic.episode.observer import EstimationErrors, Observer
from fastmimic.episode.reward import TALLY, TERMS, WEIGHTS, score_step
from fastmimic.episode.run_log import RunLog
from fastmimic.estimation.estimator import START
from fastmimic.estimation.reading import READING
from fastmimic.motion.motion import Motion
from fastmimic.reference.resync import advance_recovering
from fastmimic.reference.table import advance_clocks, make_clocks, place_clocks, stack_tables, world_root
from fastmimic.robot import Robot
from fastmimic.robot.kinematics import foot_positions
from fastmimic.robot.state import COMMAND, OBSERVATION
from fastmimic.simulation.conditions import Conditions
from fastmimic.simulation.simulators import Simulation, make_simulation

JOINT_NOISE: Final = 0.05  # rad, of perturbed starts
VELOCITY_NOISE: Final = 0.1  # m/s


@dataclass(frozen=True, eq=False)
class Start:
    """How n episodes begin.

    Attributes:
        sample: (n,) index into the motion.
        joint_offset: (n, 12) rad, added to the demonstration's joints.
        velocity_offset: (n, 3) m/s, added to its base velocity, world frame.
        stream: (n,) numbers of the episodes' random streams (`Conditions.seed`); 0 … n − 1 if None.
    """

    sample: NDArray[np.int64]
    joint_offset: Array
    velocity_offset: Array
    stream: NDArray[np.int64] | None = None

    @property
    def n(self) -> int:
        return len(self.sample)

    def part(self, rows: slice) -> "Start":
        """Some of the episodes."""
        return Start(self.sample[rows], self.joint_offset[rows], self.velocity_offset[rows], self.streams[rows])

    @property
    def streams(self) -> NDArray[np.int64]:
        """(n,) numbers of the episodes' random streams."""
        return self.stream if self.stream is not None else np.arange(self.n)


def nominal_start(n: int) -> Start:
    """n episodes from the motion's start, unperturbed."""
    return Start(np.zeros(n, np.int64), np.zeros((n, 12)), np.zeros((n, 3)))


def perturbed_start(n: int, n_samples: int, rng: np.random.Generator) -> Start:
    """n episodes: the first from the start, unperturbed; the others at a random phase, joints and velocity
    perturbed."""
    start = nominal_start(n)
    for i in range(1, n):
        start.sample[i] = rng.integers(n_samples)
        start.joint_offset[i] = rng.uniform(-JOINT_NOISE, JOINT_NOISE, 12)
        start.velocity_offset[i] = rng.uniform(-VELOCITY_NOISE, VELOCITY_NOISE, 3)
    return start


@dataclass(frozen=True, eq=False)
class Log:
    """Everything of n episodes over t control steps; rows after a fall repeat nothing: see `Summary.steps`.

    Attributes:
        rate_hz: control steps a second.
        observation: (n, t) of `OBSERVATION`, the state after each step.
        command: (n, t) of `COMMAND`, what led to it.
        stance: (n, t, 4) bool, the gait planner's leg states.
        wanted: (n, t, 4) bool, the schedule.
        force: (n, t, 4, 3) forces that the stance QP asked for, heading frame, N.
        solve_time: (n, t) s that the controller took to plan ahead, 0 in steps in which it did not.
        terms: (n, t, 5) the reward's terms in the order of `TERMS`; 0 after a fall.
        demonstration: (n, t) of `SAMPLE`, the demonstration in force, its root and feet in the world and body frame.
        estimate: (n, t) of `OBSERVATION`, what the controller was told after each step where it has sensors only.
        reading: (n, t) of `READING`, what the sensors had said by then, likewise.
    """

    rate_hz: float
    observation: NDArray[Any]
    command: NDArray[Any]
    stance: NDArray[np.bool_]
    wanted: NDArray[np.bool_]
    force: Array
    solve_time: Array
    terms: Array
    demonstration: NDArray[Any]
    estimate: NDArray[Any] | None = None
    reading: NDArray[Any] | None = None

    @property
    def reward(self) -> Array:
        """(n, t) reward per step."""
        return self.terms @ np.array(WEIGHTS)


@dataclass(frozen=True, eq=False)
class Rollout:
    """Results of n episodes.

    Attributes:
        reward: (n,) mean over the whole episode, steps after a fall count 0.
        terms: (n, 5) means of the reward's terms, likewise.
        fell: (n,) bool.
        steps: (n,) control steps until the fall or the end.
        duration_s: length of an episode, s.
        drift: (n,) m/s that the synchronisation of the reference hides.
        clearance: (n, 4) mean over the swings of each foot's greatest height above the ground, m; NaN without swings.
        slip: (n, 4) mean path that a loaded foot's contact point slides in a stance, m.
        early_contacts: (n,) touch-downs before their time, per second.
        foot_rmse: (n, 4, 3) against the demonstration, body frame, until the fall, m.
        qp_failures: (n,) steps at which the stance QP failed, until the fall.
        log: the whole course, if it was asked for.
        parts: the same of each part of the episodes, if they were divided; a robot that fell does so in one of them.
        estimation: how far the estimate was from the truth over whole episodes, where the controller has sensors only.
    """

    reward: Array
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
    log: Log | None = None
    parts: "tuple[Rollout, ...]" = ()
    estimation: EstimationErrors | None = None

    def components(self, episode: int) -> dict[str, float]:
        """The reward's terms of one episode by name."""
        return {name: float(value) for name, value in zip(TERMS, self.terms[episode], strict=True)}


class LoopController(Protocol):
    """What the loop needs of a controller; see `fastmimic.control.controller.Controller`.

    Attributes:
        config: its rate, and the thresholds by which contacts are counted.
        tables: (1 or n, t) of `SAMPLE`, what the robots follow.
        memory: (n,) of `MEMORY`.
        command: (n,) of `COMMAND`, the last ones.
    """

    config: ControllerConfig
    tables: NDArray[Any]
    memory: NDArray[Any]
    command: NDArray[Any]

    def reset(self, sample: NDArray[np.int64]) -> None:
        """Begins n episodes at samples (n,) of the reference."""

    def step(self, observation: NDArray[Any], clocks: NDArray[Any]) -> NDArray[Any]:
        """Commands (n,) of `COMMAND` for the next control step."""


MakeController = Callable[["Robot", Motion, int, ControllerConfig], LoopController]
"""Makes a controller for a robot, its demonstration, n robots, and the loop's configuration."""


class ClosedLoop:
    """n robots, their controller and the scoring, reusable for many rollouts. One thread at a time."""

    def __init__(
        self,
        robot: Robot,
        demonstration: Motion,
        n: int,
        config: ControllerConfig | None = None,
        *,
        threads: int = 1,
        conditions: Conditions | None = None,
        controller: MakeController | None = None,
    ) -> None:
        """
        Raises:
            MotionError: the motion is for another robot.
            ConfigError: it is for another rate.
            FastMimicError: as `controller`, which makes another controller than the model-based one.
        """
        config = config if config is not None else default_config()
        self.conditions = conditions if conditions is not None else Conditions()
        demonstration.check_robot(robot.name)
        self.robot = robot
        self.demonstration = demonstration
        self.n = n
        self.controller: LoopController = (
            Controller(robot, [demonstration], n, config)
            if controller is None
            else controller(robot, demonstration, n, config)
        )
        self.simulation: Simulation = make_simulation(
            robot, n, self.conditions, control_rate_hz=config.rate_hz, threads=threads
        )
        self.observer = (
            Observer(robot, n, config.rate_hz, self.conditions) if self.conditions.observe == "sensors" else None
        )
        self._table = self.controller.tables[0]
        self._clocks = make_clocks(demonstration, n)
        self._tallies = np.zeros(n, TALLY)
        self._work = np.zeros((2, 3, 3))
        self._dt = 1.0 / config.rate_hz
        self._recovery = pack_config(config, robot) if config.recovery.enabled else None
        self._threshold = config.gait.contact_threshold * robot.mass * GRAVITY

    def run(
        self,
        references: Sequence[Motion] | NDArray[Any] | None,
        start: Start,
        steps: int,
        *,
        log: bool = False,
        divisions: Sequence[int] = (),
    ) -> Rollout:
        """Runs one episode with each robot.

        Args:
            references: what the controller follows: motions or tables (k, t) of `SAMPLE`, one or n; None for the
                demonstration.
            start: of n episodes.
            steps: control steps.
            log: whether to keep the whole course.
            divisions: control steps, ascending, at which one part of the episodes ends and the next begins.

        Raises:
            ConfigError: starts or references are not as many as there are robots, or at another rate.
            MotionError: the references' period is not the demonstration's.
        """
        self._reset(references, start)
        controller, simulation, tallies = self.controller, self.simulation, self._tallies
        observer = self.observer
        recorder = _Recorder(self, steps) if log else None
        seen, clocks = (simulation.observation, self._clocks) if observer is None else self._first_look(observer, start)
        if self._recovery is not None and observer is None:
            clocks = self._clocks.copy()  # the reward keeps its own
        cuts = [0, *(d for d in divisions if 0 < d < steps), steps] if len(divisions) else []
        counted = [tallies.copy()]
        for step in range(steps):
            commands = controller.step(seen, clocks)
            if observer is None:
                seen = truth = simulation.step(commands)
            else:
                truth = simulation.step(observer.to_motors(commands))
                seen = observer.look(truth, controller.memory["stance"], controller.tables, self._recovery)
            if self._recovery is not None and observer is None:
                advance_recovering(self._recovery, clocks, controller.tables, truth)
            self._score(truth)
            if recorder is not None:
                recorder.add(step)
            if step + 1 in cuts:
                counted.append(tallies.copy())
            if step % 64 == 63 and tallies["fallen"].all() and recorder is None:
                break
        counted += [tallies.copy() for _ in range(len(cuts) - len(counted))]  # all fell before
        parts = tuple(
            summarised(_since(before, after), b - a, self.controller.config.rate_hz)
            for (a, b), (before, after) in zip(pairwise(cuts), pairwise(counted), strict=True)
        )
        estimation = observer.errors() if observer is not None else None
        course = recorder.log() if recorder is not None else None
        return summarised(tallies, steps, self.controller.config.rate_hz, course, parts, estimation)

    def _first_look(self, observer: Observer, start: Start) -> tuple[NDArray[Any], NDArray[Any]]:
        """What sensors tell of robots that start as the demonstration does, and the controller's own clocks.

        What is added to the start, the controller is not told.
        """
        table, clocks = self._table, self._clocks
        position, quat = world_root(table, start.sample, clocks["origin"])
        known = np.zeros(self.n, START)
        known["position"], known["heading"] = position[:, :2], yaw_from_quat(quat)
        known["velocity"] = table["lin_vel"][start.sample]
        known["velocity"][:, :2] = rotate_planar(clocks["origin"][:, 2], known["velocity"][:, :2])
        planned = self.controller.memory["stance"]
        seen = observer.reset(self.simulation.observation, known, planned, start.streams, clocks)
        return seen, observer.clocks

    def _score(self, truth: NDArray[Any]) -> None:
        """Scores the robots' true states after a control step against the demonstration, synchronised to the truth."""
        advance_clocks(self._clocks, self.controller.tables, truth["root_pos"])
        score_step(
            self.robot.geometry.rows,
            self.robot.foot_radius,
            self._threshold,
            self._dt,
            self._table,
            self._clocks,
            truth,
            self.controller.memory,
            self._tallies,
            self._work,
        )
        if self.observer is not None:
            self.observer.compare(truth, self._tallies)

    def _reset(self, references: Sequence[Motion] | NDArray[Any] | None, start: Start) -> None:
        if start.n != self.n:
            raise ConfigError(f"this loop holds {self.n} robots; {start.n} starts were given")
        demo = self.demonstration
        self.controller.tables = self._tables(references)
        pose = np.zeros((self.n, 3))
        place_clocks(self._clocks, start.sample, self._table, pose)
        position, quat = world_root(self._table, start.sample, self._clocks["origin"])
        yaw = self._clocks["origin"][:, 2]
        joints = demo.joint_pos[start.sample] + start.joint_offset
        joints = np.clip(joints, self.robot.joint_lower, self.robot.joint_upper)
        position[:, 2] += _lift_to_ground(self.robot, position, quat, joints)
        velocity = np.array(self._table["lin_vel"][start.sample])
        turning = np.array(self._table["ang_vel"][start.sample])
        velocity[:, :2] = rotate_planar(yaw, velocity[:, :2])
        turning[:, :2] = rotate_planar(yaw, turning[:, :2])
        self.simulation.reset(
            position,
            quat,
            joints,
            velocity + start.velocity_offset,
            quat_rotate_inverse(quat, turning),
            demo.joint_vel[start.sample],
        )
        self.controller.reset(start.sample)
        self._tallies[...] = np.zeros((), TALLY)

    def _tables(self, references: Sequence[Motion] | NDArray[Any] | None) -> NDArray[Any]:
        """What the controller follows, (1 or n, t) of `SAMPLE`, in step with the demonstration."""
        if references is None:
            return self._table[None]
        if isinstance(references, np.ndarray):
            tables = references
        else:
            rate = self.controller.config.rate_hz
            for motion in references:
                if abs(motion.rate_hz - rate) > 1e-9:
                    raise ConfigError(
                        f"reference '{motion.name}' has {motion.rate_hz:g} samples a second; expected {rate:g}"
                    )
            tables = stack_tables(references, loaded_robot(self.robot, self.controller.config.load))
        if len(tables) not in (1, self.n):
            raise ConfigError(f"{self.n} robots need 1 or {self.n} references, found {len(tables)}")
        if tables.shape[1] != len(self._table):
            raise MotionError(
                f"the reference has {tables.shape[1]} samples and the demonstration '{self.demonstration.name}'"
                f" {len(self._table)}; a reference must keep the demonstration's period"
            )
        return tables


def summarised(
    t: NDArray[Any],
    steps: int,
    rate_hz: float,
    log: Log | None = None,
    parts: tuple[Rollout, ...] = (),
    estimation: EstimationErrors | None = None,
) -> Rollout:
    """What the tallies (n,) of `TALLY` of some steps amount to.

    Args:
        t: the tallies.
        steps: control steps of each episode, also of those that fell before.
        rate_hz: control steps a second.
        log, parts, estimation: as in `Rollout`.
    """
    lived = np.maximum(t["steps"], 1)
    with np.errstate(invalid="ignore", divide="ignore"):
        clearance = t["clearance_sum"] / t["swings"]
        slip = t["slip"] / np.maximum(t["stances"], 1)
    return Rollout(
        reward=t["reward_sum"] / steps,
        terms=t["terms"] / steps,
        fell=t["fallen"].astype(bool),
        steps=t["steps"].copy(),
        duration_s=steps / rate_hz,
        drift=t["jump"] / (lived / rate_hz),
        clearance=clearance,
        slip=slip,
        early_contacts=t["early_touchdowns"] / (lived / rate_hz),
        foot_rmse=np.sqrt(t["foot_error_sq"] / lived[:, None, None]),
        qp_failures=t["qp_failures"].copy(),
        log=log,
        parts=parts,
        estimation=estimation,
    )


def _since(before: NDArray[Any], after: NDArray[Any]) -> NDArray[Any]:
    """What was counted between two states of the tallies."""
    between = after.copy()
    for name in after.dtype.names or ():
        between[name] = after[name] - before[name]
    return between


class _Recorder:
    """Copies what passes through the loop into arrays."""

    def __init__(self, loop: ClosedLoop, steps: int) -> None:
        n = loop.n
        self._loop = loop
        self._observation = np.zeros((n, steps), OBSERVATION)
        self._command = np.zeros((n, steps), COMMAND)
        self._stance = np.zeros((n, steps, 4), np.bool_)
        self._force = np.zeros((n, steps, 4, 3))
        self._solve_time = np.zeros((n, steps))
        self._terms = np.zeros((n, steps, 5))
        self._sample = np.zeros((n, steps), np.int64)
        self._origin = np.zeros((n, steps, 3))
        self._estimate = np.zeros((n, steps), OBSERVATION) if loop.observer is not None else None
        self._reading = np.zeros((n, steps), READING) if loop.observer is not None else None

    def add(self, step: int) -> None:
        loop = self._loop
        self._observation[:, step] = loop.simulation.observation
        self._command[:, step] = loop.controller.command
        self._stance[:, step] = loop.controller.memory["stance"]
        self._force[:, step] = loop.controller.memory["force"]
        self._solve_time[:, step] = loop.controller.memory["solve_time"]
        alive = loop._tallies["fallen"] == 0
        self._terms[alive, step] = loop._tallies["reward"][alive]
        self._sample[:, step] = loop._clocks["sample"]
        self._origin[:, step] = loop._clocks["origin"]
        if self._estimate is not None and loop.observer is not None:
            self._estimate[:, step] = loop.observer.estimator.observation
        if self._reading is not None and loop.observer is not None:
            self._reading[:, step] = loop.observer.sensors.reading

    def log(self) -> Log:
        table = self._loop._table
        demonstration = table[self._sample]
        position, quat = world_root(table, self._sample, self._origin)
        demonstration["root_pos"], demonstration["root_quat"] = position, quat
        for name in ("lin_vel", "ang_vel", "lin_acc", "ang_acc"):
            vector = demonstration[name]
            vector[..., :2] = rotate_planar(self._origin[..., 2], vector[..., :2])
        return Log(
            rate_hz=self._loop.controller.config.rate_hz,
            observation=self._observation,
            command=self._command,
            stance=self._stance,
            wanted=demonstration["contact"].astype(bool),
            force=self._force,
            solve_time=self._solve_time,
            terms=self._terms,
            demonstration=demonstration,
            estimate=self._estimate,
            reading=self._reading,
        )


def run_log(log: Log, episode: int, *, robot: str, motion: str, latency_s: float) -> RunLog:
    """What the robot's own computer knew of an episode.

    Args:
        log: with sensors.
        episode: which.
        robot, motion: names.
        latency_s: age of the readings when they arrive, as the estimator assumes it.

    Raises:
        ConfigError: the controller was told the truth, and no robot's computer knows that.
    """
    if log.reading is None or log.estimate is None:
        raise ConfigError("a robot's log is of what its sensors say; run the episode with --observe sensors")
    of = log.reading[episode], log.command[episode], log.estimate[episode], log.stance[episode]
    return RunLog(robot, motion, log.rate_hz, latency_s, *of)


def _lift_to_ground(robot: Robot, position: Array, quat: Array, joints: Array) -> Array:
    """How far to raise each base (n,) so that no foot starts below the ground, m."""
    feet = position[:, None] + quat_rotate(quat[:, None], foot_positions(robot, joints))
    return np.maximum(0.0, robot.foot_radius - feet[..., 2].min(axis=1))


def run_episodes(
    robot: Robot,
    motion: Motion,
    *,
    references: Sequence[Motion] | None = None,
    start: Start | None = None,
    duration_s: float = 10.0,
    config: ControllerConfig | None = None,
    log: bool = False,
    conditions: Conditions | None = None,
    controller: MakeController | None = None,
) -> Rollout:
    """Runs episodes of a motion once; the demonstration it is scored against is `motion.target`.

    Args:
        robot: the robot.
        motion: what the controller follows, unless `references` are given.
        references: one reference for each episode.
        start: of the episodes; one from the motion's start if None.
        duration_s: length of an episode, s; at most to the end of a motion that does not repeat.
        config: the controller's.
        log: whether to keep the whole course.
        conditions: what the robot meets and what its controller sees.
        controller: makes another controller than the model-based one, such as a policy.
    """
    start = start if start is not None else nominal_start(1)
    loop = ClosedLoop(robot, motion.target, start.n, config, conditions=conditions, controller=controller)
    steps = max(1, math.ceil(duration_s * loop.controller.config.rate_hz - 1e-9))
    if motion.cycle is None:  # it ends, and so do its episodes
        steps = max(1, min(steps, motion.n_samples - 1 - int(start.sample.max())))
    divisions = [first for first in motion.target.segment_starts if first] if not start.sample.any() else []
    return loop.run(
        list(references) if references is not None else [motion], start, steps, log=log, divisions=divisions
    )
