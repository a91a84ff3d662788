"""The closed loop: robots in simulation under the controller, scored against the demonstration."""

import dataclasses
from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Final, Protocol

import numpy as np
from numpy.typing import NDArray

from fastmimic.base.arrays import Array, Records
from fastmimic.base.errors import ConfigError, MotionError
from fastmimic.base.rotations import quat_rotate, quat_rotate_inverse, rotate_planar, yaw_from_quat
from fastmimic.control.config import ControllerConfig, loaded_robot
from fastmimic.control.controller import Controller, gains_of
from fastmimic.episode.observer import Observer
from fastmimic.episode.plan import Start, episode_steps, nominal_start, perturbed_start, start_room
from fastmimic.episode.reward import Scorer, demonstration_in_world
from fastmimic.episode.rollout import Log, Rollout, summarised
from fastmimic.estimation.estimator import START
from fastmimic.motion.motion import Motion
from fastmimic.reference.table import advance_clocks, make_clocks, place_clocks, reference_table, stack_tables
from fastmimic.robot import Robot
from fastmimic.robot.kinematics import foot_positions
from fastmimic.simulation.conditions import Conditions, episode_generator
from fastmimic.simulation.simulators import Placement, make_simulation
from fastmimic.simulation.terrain import Terrain

_START_PURPOSE: Final = 72  # number of the random stream
_TRAVELS: Final = 0.05  # m/s, mean speed of a motion that leads somewhere


class LoopController(Protocol):
    """What the loop needs of a controller; see `fastmimic.control.controller.Controller`: the rate and the contact
    thresholds in its `config`, the `tables` (1 or n, t) of `SAMPLE` that the robots follow, the `memory` (n,) of
    `MEMORY`, and the last `command` (n,) of `COMMAND`."""

    config: ControllerConfig
    tables: Records
    memory: Records
    command: Records

    def reset(self, sample: NDArray[np.int64]) -> None:
        """Begins n episodes at samples (n,) of the reference."""

    def step(self, observation: Records, clocks: Records) -> Records:
        """Commands (n,) of `COMMAND` for the next control step."""


MakeController = Callable[[Robot, Motion, int, ControllerConfig], LoopController]
"""Makes a controller for a robot, its demonstration, n robots, and the loop's configuration."""


def on_reference(table: Records, sample: NDArray[np.int64], origin: Array) -> Placement:
    """The states at samples (n,) of a table (t,) of `SAMPLE` with its origin at (n, 3) (x, y, yaw) in the world."""
    due = demonstration_in_world(table, sample, origin)
    turning = quat_rotate_inverse(due["root_quat"], due["ang_vel"])
    return Placement(due["root_pos"], due["root_quat"], due["joint_pos"], due["lin_vel"], turning, due["joint_vel"])


class ClosedLoop:
    """n robots, their controller and the scoring, reusable for many rollouts. One thread at a time."""

    def __init__(
        self,
        robot: Robot,
        demonstration: Motion,
        n: int,
        config: ControllerConfig = ControllerConfig(),
        *,
        threads: int = 1,
        conditions: Conditions = Conditions(),
        controller: MakeController | None = None,
    ) -> None:
        """`controller` makes another controller than the model-based one, and may raise any `FastMimicError`. Raises
        `MotionError` if the motion is for another robot, `ConfigError` if it is for another rate."""
        self.conditions = conditions
        demonstration.check_robot(robot.name)
        self.robot = robot
        self.demonstration = demonstration
        self.n = n
        self.controller: LoopController = (
            Controller(robot, [demonstration], n, config)
            if controller is None
            else controller(robot, demonstration, n, config)
        )
        self._gains = self.controller.gains if isinstance(self.controller, Controller) else np.zeros(0)
        self.simulation = make_simulation(robot, n, self.conditions, control_rate_hz=config.rate_hz, threads=threads)
        self.terrain = self.conditions.ground
        senses = self.conditions.observe == "sensors"
        self.observer = Observer(robot, n, config.rate_hz, self.conditions) if senses else None
        self.table = self.controller.tables[0]
        self.clocks = make_clocks(demonstration, n)
        self.scorer = Scorer(robot, self.table, n, config, config.rate_hz)
        self._scorers = [self.scorer]
        if demonstration.animal is not None:
            # in the frame of the executable motion, which the clocks synchronise
            animal = reference_table(dataclasses.replace(demonstration.animal, demonstration=demonstration), robot)
            self._scorers.append(Scorer(robot, animal, n, config, config.rate_hz))
        self._seen: Records = self.simulation.observation
        self._truth: Records = self.simulation.observation
        self._followed = self.clocks  # the controller's own clocks

    def run(
        self,
        references: Sequence[Motion] | Records | None,
        start: Start,
        steps: int,
        *,
        log: bool = False,
        divisions: Sequence[int] = (),
    ) -> Rollout:
        """Runs one episode of so many control steps with each robot. `references` are one or n motions or tables (k, t)
        of `SAMPLE` to follow, None for the demonstration; `log` keeps the whole course; `divisions` are ascending
        control steps at which a part of the episodes ends. Raises `ConfigError` for a number of starts or references
        other than that of the robots, or another rate; `MotionError` for a period other than the demonstration's."""
        self.place(start, references)
        rate_hz, scorer = self.controller.config.rate_hz, self.scorer
        recorder = _Recorder(self, steps) if log else None
        cuts = [0, *(d for d in divisions if 0 < d < steps), steps] if len(divisions) else []
        counted = [scorer.counted()]
        for step in range(steps):
            self.apply(self.control())
            self.score()
            if recorder is not None:
                recorder.add(step)
            if step + 1 in cuts:
                counted.append(scorer.counted())
            if step % 64 == 63 and scorer.tallies["fallen"].all() and recorder is None:
                break
        counted += [scorer.counted() for _ in range(len(cuts) - len(counted))]  # all fell before
        between = zip(pairwise(cuts), pairwise(counted), strict=True)
        parts = tuple(summarised(after.since(before), b - a, rate_hz) for (a, b), (before, after) in between)
        found, animal = summarised(scorer.counted(), steps, rate_hz), self._scorers[1:]
        return dataclasses.replace(
            found,
            log=recorder.log() if recorder is not None else None,
            parts=parts,
            estimation=self.observer.errors() if self.observer is not None else None,
            reward_animal=animal[0].tallies["reward_sum"] / steps if animal else found.reward_animal,
        )

    def place(self, start: Start, references: Sequence[Motion] | Records | None = None) -> None:
        """Begins n episodes: puts the robots where the demonstration is; arguments and errors as for `run`."""
        if start.n != self.n:
            raise ConfigError(f"this loop holds {self.n} robots; {start.n} starts were given")
        self._follow(references)
        place_clocks(self.clocks, start.sample, self.table, self._begin(start))
        told = on_reference(self.table, start.sample, self.clocks["origin"])
        joints = np.clip(told.joint_pos + start.joint_offset, self.robot.joint_lower, self.robot.joint_upper)
        place = on_ground(self.terrain, self.robot, told._replace(joint_pos=joints))
        self.simulation.reset(*place._replace(lin_vel=place.lin_vel + start.velocity_offset))
        self.controller.reset(start.sample)
        for scorer in self._scorers:
            scorer.reset()
        self._seen = self._truth = self.simulation.observation
        self._followed = self.clocks
        if self.observer is not None:
            self._seen, self._followed = self._first_look(self.observer, start, told)

    def control(self) -> Records:
        """The controller's commands (n,) of `COMMAND` for the next control step."""
        return self.controller.step(self._seen, self._followed)

    def apply(self, commands: Records) -> None:
        """Steps the simulation, observes it for the controller, and advances the controller's clocks."""
        controller, observer = self.controller, self.observer
        if observer is None:
            self._seen = self._truth = self.simulation.step(commands)
        else:
            self._truth = self.simulation.step(observer.sensors.to_motors(commands))
            self._seen = observer.look(self._truth, controller.memory, controller.tables)

    def score(self) -> None:
        """Scores the robots' true states against the demonstration, synchronised to the truth."""
        advance_clocks(self.clocks, self.controller.tables, self._truth["root_pos"], self.controller.memory["haste"])
        truth = self._truth
        seen = truth if self.terrain is None else self.terrain.seen(truth)
        for scorer in self._scorers:  # that of the animal's motion ends with the robot's fall
            scorer.tallies["fallen"] |= self.scorer.tallies["fallen"]
            scorer.score(self.clocks, truth, self.controller.memory, seen)
        if self.observer is not None:
            self.observer.compare(seen, self.scorer.tallies)

    def _begin(self, start: Start) -> Array:
        """Where episodes begin, (n, 3) x, y, m, and heading, rad: on a terrain they lead along the world's x axis but
        for the terrain's own spread."""
        if self.terrain is None:
            return np.zeros((self.n, 3))
        seed = self.conditions.seed
        draws = [episode_generator(seed, int(i), _START_PURPOSE).uniform(-1.0, 1.0, 3) for i in start.streams]
        return np.array(draws) * self.terrain.spread - [0.0, 0.0, _travel(self.table)]

    def _first_look(self, observer: Observer, start: Start, told: Placement) -> tuple[Records, Records]:
        """First sensor readings, as estimates, and the controller's own clocks. The controller is told that the robots
        are where the demonstration is, without the start's offsets."""
        known = np.zeros(self.n, START)
        known["position"], known["heading"] = told.root_pos[:, :2], yaw_from_quat(told.root_quat)
        known["velocity"] = told.lin_vel
        planned = self.controller.memory["stance"]
        seen = observer.reset(self.simulation.observation, known, planned, start.streams, self.clocks)
        return seen, observer.clocks

    def _follow(self, references: Sequence[Motion] | Records | None) -> None:
        """Gives the controller references, those of the demonstration for None, in step with it, and a model-based
        controller their gains; those of tables are the demonstration's."""
        controller, gains, tables = self.controller, self._gains, self.table[None]
        if isinstance(references, np.ndarray):
            tables = references
        elif references is not None:
            for motion in references:
                motion.check_rate(controller.config.rate_hz)
            robot = loaded_robot(self.robot, controller.config.load)
            tables = stack_tables(references, robot)
            if isinstance(controller, Controller):
                each = [gains_of(motion, robot, controller.config) for motion in references]
                gains = np.stack(each[:1] if all(own is each[0] for own in each) else each)
        if len(tables) not in (1, self.n):
            raise ConfigError(f"{self.n} robots need 1 or {self.n} references, found {len(tables)}")
        if (n := tables.shape[1]) != (due := len(self.table)):
            said = f"the reference has {n} samples and the demonstration '{self.demonstration.name}' {due}"
            raise MotionError(f"{said}; a reference must keep the demonstration's period")
        controller.tables = tables
        if isinstance(controller, Controller):
            controller.gains = gains


def _travel(table: Records) -> float:
    """Direction of a table's (t,) mean velocity from the heading, rad; 0 for a motion that stays where it is."""
    x, y = rotate_planar(-yaw_from_quat(table["root_quat"]), table["lin_vel"][:, :2]).mean(axis=0)
    return float(np.arctan2(y, x)) if np.hypot(x, y) > _TRAVELS else 0.0


def _feet(robot: Robot, place: Placement) -> Array:
    """(n, 4, 3) centres of the feet, world, m."""
    feet = quat_rotate(place.root_quat[:, None], foot_positions(robot, place.joint_pos))
    return np.asarray(place.root_pos[:, None] + feet)


def on_ground(terrain: Terrain | None, robot: Robot, place: Placement) -> Placement:
    """Lays states above level ground on the plane under their feet; raises them so that no foot is in the ground."""
    ground: Array | float = 0.0
    if terrain is not None:
        plane = terrain.plane_through(place.root_pos, _feet(robot, place), robot.foot_radius)
        position, quat = plane.laid(place.root_pos, place.root_quat)
        place = place._replace(root_pos=position, root_quat=quat, lin_vel=quat_rotate(plane.quat, place.lin_vel))
        feet = _feet(robot, place)
        ground = terrain.support(feet[..., 0], feet[..., 1], robot.foot_radius)
    lift = (ground + robot.foot_radius - _feet(robot, place)[..., 2]).max(axis=1)
    place.root_pos[:, 2] += np.maximum(0.0, lift)
    return place


class _Recorder:
    """Keeps the whole course of a loop's episodes."""

    def __init__(self, loop: ClosedLoop, steps: int) -> None:
        self._loop = loop
        present = self._present().items()
        self._kept = {name: np.zeros((loop.n, steps, *value.shape[1:]), value.dtype) for name, value in present}

    def add(self, step: int) -> None:
        """Copies the state after a control step."""
        for name, value in self._present().items():
            self._kept[name][:, step] = value

    def log(self) -> Log:
        kept = dict(self._kept)
        demonstration = demonstration_in_world(self._loop.table, kept.pop("sample"), kept.pop("origin"))
        if self._loop.terrain is not None:
            plane = self._loop.terrain.plane(*np.moveaxis(demonstration["root_pos"][..., :2], -1, 0))
            laid = plane.laid(demonstration["root_pos"], demonstration["root_quat"])
            demonstration["root_pos"], demonstration["root_quat"] = laid
            for name in ("lin_vel", "ang_vel", "lin_acc", "ang_acc"):
                demonstration[name] = quat_rotate(plane.quat, demonstration[name])
        wanted = demonstration["contact"].astype(bool)
        rate_hz = self._loop.controller.config.rate_hz
        return Log(rate_hz, wanted=wanted, demonstration=demonstration, terrain=self._loop.terrain, **kept)

    def _present(self) -> dict[str, Records]:
        """What is kept of each step: fields of `Log`, and the clocks' `sample` and `origin`."""
        loop, memory = self._loop, self._loop.controller.memory
        up = loop.scorer.tallies["fallen"] == 0
        found = {
            "observation": loop.simulation.observation,
            "command": loop.controller.command,
            "stance": memory["stance"].astype(bool),
            "recovering": memory["recovering"] > 0,
            "force": memory["force"],
            "solve_time": memory["solve_time"],
            "terms": np.where(up[:, None], loop.scorer.terms, 0.0),
            "sample": loop.clocks["sample"],
            "origin": loop.clocks["origin"],
        }
        if loop.observer is not None:
            found["estimate"] = loop.observer.estimator.observation
            found["reading"] = loop.observer.sensors.reading
        return found


def run_episodes(
    robot: Robot,
    motion: Motion,
    *,
    start: Start | None = None,
    duration_s: float = 10.0,
    config: ControllerConfig = ControllerConfig(),
    log: bool = False,
    conditions: Conditions = Conditions(),
    controller: MakeController | None = None,
) -> Rollout:
    """Runs episodes of a motion once, scored against its demonstration `motion.target`: one from the motion's start if
    `start` is None, each `duration_s` long, s, at most to the end of a motion that does not repeat. `log` keeps the
    whole course; `controller` makes another controller than the model-based one, such as a policy."""
    start = start if start is not None else nominal_start(1)
    loop = ClosedLoop(robot, motion.target, start.n, config, conditions=conditions, controller=controller)
    steps = episode_steps(duration_s, loop.controller.config.rate_hz)
    if motion.cycle is None:  # it ends, and so do its episodes
        steps = max(1, min(steps, motion.n_samples - 1 - int(start.sample.max())))
    divisions = [first for first in motion.target.segment_starts if first] if not start.sample.any() else []
    return loop.run([motion], start, steps, log=log, divisions=divisions)


def share_of_falls(robot: Robot, motion: Motion) -> float:
    """Share of perturbed starts from which the robot falls under the default controller, without recovery steps: a
    motion should not need them. A passage is run 10 times as a whole, a cycle 3 times for 10 s, and either 32 times for
    1 s, since most falls come at once. The starts are not those of evaluations."""
    config = ControllerConfig()
    config = dataclasses.replace(config, gait=dataclasses.replace(config.gait, recovery_steps=False))
    rng, fell = np.random.default_rng(20_000), list[NDArray[np.bool_]]()
    for count, duration_s in ((10, motion.period_s) if motion.cycle is None else (3, 10.0), (32, 1.0)):
        start = perturbed_start(count, start_room(motion, motion.period_s), rng)
        fell.append(run_episodes(robot, motion, start=start, duration_s=duration_s, config=config).fell)
    return float(np.concatenate(fell).mean())
