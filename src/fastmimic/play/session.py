"""The live session: a robot under the controller, steered by what a hand, a script or a test asks for."""

import math
import time
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from fastmimic.base.arrays import Array
from fastmimic.base.conventions import GRAVITY
from fastmimic.base.errors import ConfigError, MotionError, did_you_mean
from fastmimic.base.rotations import quat_from_yaw, quat_multiply, rotate_planar, yaw_from_quat
from fastmimic.control.config import ControllerConfig, controller_config
from fastmimic.control.controller import Controller
from fastmimic.episode.placement import on_reference
from fastmimic.episode.reward import REWARD_TERMS
from fastmimic.episode.scorer import Scorer
from fastmimic.imitation.methods import METHODS
from fastmimic.motion.motion import Motion
from fastmimic.play.getting_up import GettingUp, GettingUpPhase
from fastmimic.play.world import LiveWorld
from fastmimic.reference.course_transition import CourseTransition
from fastmimic.reference.modulation_limits import Limits
from fastmimic.reference.motion_set import Entry, MotionSet
from fastmimic.reference.standing import STAND
from fastmimic.reference.stream import MODULATION, Stream, make_place
from fastmimic.reference.table import CLOCK, SAMPLE
from fastmimic.robot import Robot
from fastmimic.simulation.mujoco_sim import MujocoSimulation

RATES: Final = {"speed": 0.5, "turn": 1.2, "lift": 0.8}
"""How fast a modulation follows what was asked for: 1/s, rad/s², 1/s."""
_TIMINGS: Final = 2000
_LANDED: Final = 1e-9
_PACING: Final = 10
"""Control steps between two changes of the course while the speed changes."""
_PREPARING: Final = 50
"""Control steps between two looks at whether something can be made beforehand."""


def playable_methods() -> list[str]:
    """Names of the methods whose controllers can be chosen while it runs."""
    return [method.name for method in METHODS.values() if method.playable]


def check_method(name: str) -> None:
    """Raises `ConfigError` for a method that cannot be chosen in a live session."""
    names = playable_methods()
    if name not in names:
        raise ConfigError(f"'{name}' cannot be played; there are {', '.join(names)}{did_you_mean(name, names)}")


@dataclass(frozen=True, eq=False)
class Snapshot:
    """The present moment, for whoever shows it. Arrays are copies.

    Attributes:
        time_s: simulated since the start.
        pose, reference: (19,) of the robot and of what it is scored against: position (world, m), quaternion, joints.
        force, asked: (4, 3) the ground's force on each foot and what the controller asked for, world, N.
        wanted, measured, stance: (4,) schedule, loaded feet, gait planner.
        terms: (k,) the reward's terms of this step; 0 while it gets up.
        reward: of this step.
        velocity_b: (3,) of the base, heading frame, m/s; turn_rate: about the vertical, rad/s.
        push: (3,) force that pushes, world, N.
    """

    time_s: float
    pose: Array
    reference: Array
    force: Array
    asked: Array
    wanted: NDArray[np.bool_]
    measured: NDArray[np.bool_]
    stance: NDArray[np.bool_]
    terms: Array
    reward: float
    velocity_b: Array
    turn_rate: float
    push: Array


class LiveSession:
    """One robot that goes on until nobody looks any more. One thread at a time.

    Args:
        robot: the robot.
        motions: cyclic motions by name, or a `MotionSet` of them.
        start: the motion to begin with; "stand" if None.
        method: the controller, one of `playable_methods()`.
        config: its parameters, or the name of a set.

    Raises:
        ConfigError: no such motion, controller or configuration.
        MotionError: a motion that cannot be played.

    Example:
        session = LiveSession(load_robot("a1"), {"trot": load_motion("trot", "a1")})
        session.switch("trot")
        session.run(5.0)
        session.push(10.0, direction=math.pi / 2)
    """

    def __init__(
        self,
        robot: Robot,
        motions: Mapping[str, Motion] | MotionSet,
        *,
        start: str | None = None,
        method: str = "mbc",
        config: ControllerConfig | str = "default",
    ) -> None:
        self.robot = robot
        self._given = controller_config(config) if isinstance(config, str) else config
        self.rate_hz = self._given.rate_hz
        self.dt = 1.0 / self.rate_hz
        self.library = motions if isinstance(motions, MotionSet) else MotionSet(robot, motions, self.rate_hz)
        self.simulation = MujocoSimulation(robot, 1, control_rate_hz=self.rate_hz)
        self.world = LiveWorld(self.simulation)
        self._stream = Stream(robot, self.rate_hz)
        self._place, self._modulation = make_place(), np.zeros(1, MODULATION)
        self._modulation["speed"] = self._modulation["lift"] = 1.0
        self.wanted = {"speed": 1.0, "turn": 0.0, "lift": 1.0}
        self._clock = np.zeros(1, CLOCK)
        self._truth = np.zeros(1, SAMPLE)
        self._scorer = Scorer(robot, self._truth, 1, self._given, self.rate_hz)
        stand = self.library.entry(STAND).motion
        self._recovery = GettingUp(robot, self.simulation, stand.joint_pos[0], float(stand.root_pos_w[0, 2]), self.dt)
        self.falls = 0
        self.steps = 0
        self._control_s: deque[float] = deque(maxlen=_TIMINGS)
        self._transition: CourseTransition | None = None
        self._armed: tuple[str, CourseTransition] | None = None
        self.trouble: str | None = None
        """Why the robot does not go where it was asked to; None if it does."""
        self.method = ""
        self.set_method(method)
        name = start if start is not None else STAND
        self._enter(self.library.entry(name))
        self.goal = name
        self._following = self._entry
        self._loaded = self._given.gait.release_threshold * robot.mass * GRAVITY
        self.reset()

    # what is asked for

    def switch(self, name: str) -> None:
        """Goes on with another motion as soon as feet and phase allow; raises `ConfigError` if there is none."""
        self.library.entry(name)
        self.goal, self.trouble = name, None
        self._disarm()

    def set_speed(self, factor: float) -> None:
        """Of the motion's own; what is beyond its limits is cut to them."""
        self._want("speed", factor)

    def set_turn(self, rate: float) -> None:
        """Turn rate that is added to the motion's own, rad/s, positive to the left; likewise."""
        self._want("turn", rate)

    def set_lift(self, factor: float) -> None:
        """Swing height as a factor of the motion's own; likewise."""
        self._want("lift", factor)

    def push(self, impulse: float, direction: float = 0.5 * math.pi) -> None:
        """Pushes the trunk by `impulse`, N·s, in a direction from its heading, rad, positive to the left."""
        self.world.push(impulse, direction, float(yaw_from_quat(self.simulation.observation["root_quat"][0])))

    def set_method(self, name: str) -> None:
        """Chooses the controller, one of `playable_methods()`; raises `ConfigError` for others."""
        check_method(name)
        if name == self.method:
            return
        config = METHODS[name].configure(self._given)
        before = self.controller.memory.copy() if self.method else None
        self.controller: Controller = Controller(self.robot, [self.library.entry(STAND).motion], 1, config)
        ahead = 1
        if config.stance.forces == "horizon":
            ahead = math.ceil((config.horizon.steps + 1) * config.horizon.step_s * config.rate_hz) + 2
        self._every = max(1, round(config.rate_hz / config.horizon.solve_rate_hz)) if ahead > 1 else 1
        self._tables = np.zeros((1, ahead), SAMPLE)
        self.controller.tables = self._tables
        self.method = name
        if before is not None:
            self.controller.memory[...] = before

    def fall(self) -> None:
        """Lets the robot go limp, as after a fall."""
        if self._recovery.phase is GettingUpPhase.DONE:
            self._has_fallen()

    # what is the case

    @property
    def observation(self) -> Any:
        """The robot's state, one of `OBSERVATION`."""
        return self.simulation.observation[0]

    @property
    def time_s(self) -> float:
        """Simulated since the start."""
        return self.steps * self.dt

    @property
    def motion(self) -> str:
        """The motion that it does, or the last one that it did while it is in a transition."""
        return self._entry.name

    @property
    def fallen(self) -> bool:
        """Whether it lies or gets up."""
        return self._recovery.phase is not GettingUpPhase.DONE

    @property
    def state(self) -> str:
        """In words."""
        if self.fallen:
            return self._recovery.phase.value
        if self.trouble is not None:
            return self.trouble
        if self._transition is not None:
            return f"{self._entry.name} → {self._following.name}"
        if self.goal != self._entry.name:
            return f"{self._entry.name}, going to {self.goal}" + ("" if self._armed else " (preparing)")
        return self._entry.name

    @property
    def limits(self) -> Limits:
        """Of the modulation, at present: the motion's, in a transition what both motions allow, at their own speed."""
        limits = self._entry.limits
        target = self._armed[0] if self._armed is not None else None
        if self._transition is not None:
            target = self._following.name
        if target is not None:
            return replace(limits.within(self.library.entry(target).limits), speed=(1.0, 1.0))
        if self._modulation["speed"][0] == self.wanted["speed"] == 1.0 or self.library.tempo(self._entry.name) is None:
            return replace(limits, speed=(1.0, 1.0))
        return limits

    @property
    def modulation(self) -> dict[str, float]:
        """What is in force at present: speed, turn (rad/s), lift."""
        return {name: float(self._modulation[name][0]) for name in self.wanted}

    @property
    def control_us(self) -> tuple[float, float]:
        """Median and 99th percentile of the time that a control step takes, of the last few thousand, µs."""
        if not self._control_s:
            return 0.0, 0.0
        found = np.percentile(np.array(self._control_s), (50, 99)) * 1e6
        return float(found[0]), float(found[1])

    def snapshot(self) -> Snapshot:
        """The present moment."""
        obs, truth, memory = self.observation, self._demonstration[0], self.controller.memory[0]
        yaw = float(yaw_from_quat(obs["root_quat"]))
        pose = np.concatenate([obs["root_pos"], obs["root_quat"], obs["joint_pos"]])
        if not np.isfinite(pose).all():
            pose = np.concatenate([[0.0, 0.0, 0.3, 1.0, 0.0, 0.0, 0.0], self._recovery.command["joint_pos"][0]])
        origin = self._place["pose"][0]
        reference = np.concatenate(
            [
                [origin[0], origin[1], truth["root_pos"][2]],
                quat_multiply(quat_from_yaw(origin[2]), truth["root_quat"]),
                truth["joint_pos"],
            ]
        )
        force, asked = np.nan_to_num(obs["foot_force"]), np.array(memory["force"])
        asked[:, :2] = rotate_planar(yaw, asked[:, :2])
        up = not self.fallen
        terms = self._scorer.terms[0] if up else np.zeros(len(REWARD_TERMS))
        velocity = np.array(obs["lin_vel"])
        velocity[:2] = rotate_planar(-yaw, velocity[:2])
        return Snapshot(
            time_s=self.time_s,
            pose=pose,
            reference=reference,
            force=force,
            asked=asked if up else np.zeros((4, 3)),
            wanted=truth["contact"].astype(bool),
            measured=force[:, 2] > self._loaded,
            stance=memory["stance"].astype(bool),
            terms=terms,
            reward=float(self._scorer.reward[0]) if up else 0.0,
            velocity_b=velocity,
            turn_rate=float(obs["ang_vel"][2]),
            push=self.world.force.copy(),
        )

    # what goes on

    def run(self, seconds: float) -> None:
        """Goes on by that much simulated time, as fast as it can."""
        for _ in range(round(seconds * self.rate_hz)):
            self.step()

    def reset(self) -> None:
        """Puts the robot where it is now, facing the same way, into its motion; at first into the middle of the
        world."""
        obs = self.observation
        known = bool(np.isfinite(obs["root_pos"]).all() and np.abs(obs["root_quat"]).sum() > 0.5)
        yaw = float(yaw_from_quat(obs["root_quat"])) if known else 0.0
        self._place[...] = make_place()
        self._place["pose"][0] = (*(obs["root_pos"][:2] if known else (0.0, 0.0)), yaw)
        self._transition = None
        self._disarm()
        self._fill()
        self.simulation.reset(*on_reference(self._tables[0], np.zeros(1, np.int64), self._place["pose"]))
        self._recovery.phase = GettingUpPhase.DONE
        self._begin_control()

    def step(self) -> None:
        """One control step."""
        self.world.apply()
        if self.steps % _PREPARING == 0:
            self.library.prepare(self._entry.name)
        if self.fallen:
            self._get_up()
        else:
            self._modulate()
            self._route()
            self._control()
        self.steps += 1

    def _control(self) -> None:
        began = time.perf_counter()
        self._fill()
        self._clock["origin"] = self._place["pose"]
        commands = self.controller.step(self.simulation.observation, self._clock)
        self._control_s.append(time.perf_counter() - began)
        observation = self.simulation.step(commands)
        self._stream.advance(
            self._course, self._next_course, self._place, self._modulation, observation["root_pos"][0, :2]
        )
        if self._place["left"][0]:
            self._arrived()
        self._score(observation)

    def _score(self, observation: NDArray[Any]) -> None:
        """Against the demonstration of this moment, modulated as the reference."""
        self._stream.fill(self._target, self._next_target, self._place, self._modulation, self._truth)
        self._clock["origin"] = self._place["pose"]
        self._clock["jump"] = self._place["jump"]
        self._scorer.score(self._clock, observation, self.controller.memory)
        if self._scorer.tallies["fallen"][0]:
            self._has_fallen()

    def _fill(self) -> None:
        """The reference now; for planning ahead, when a plan is due, also that of the next moments."""
        rows = self._tables[0] if self.steps % self._every == 0 else self._tables[0, :1]
        self._stream.fill(self._course, self._next_course, self._place, self._modulation, rows)

    @property
    def _demonstration(self) -> NDArray[Any]:
        return self._truth

    @property
    def _course(self) -> NDArray[Any]:
        return self._courses[0] if self._transition is None else self._transition.course

    @property
    def _target(self) -> NDArray[Any]:
        return self._courses[1] if self._transition is None else self._transition.demonstration

    @property
    def _next_course(self) -> NDArray[Any] | None:
        if self._transition is not None:
            return self._following.course
        return self._armed[1].course if self._armed is not None else None

    @property
    def _next_target(self) -> NDArray[Any] | None:
        if self._transition is not None:
            return self._following.demonstration
        return self._armed[1].demonstration if self._armed is not None else None

    def _want(self, name: str, value: float) -> None:
        if not math.isfinite(value):
            raise ConfigError(f"{name} must be a number, found {value}")
        self.wanted[name] = float(value)

    def _modulate(self) -> None:
        """Follows what is wanted at a limited rate, within what the motion allows."""
        limits, now = self.limits, self._modulation
        before = float(now["speed"][0])
        for name, rate in RATES.items():
            low, high = getattr(limits, name)
            target = min(max(self.wanted[name], low), high)
            value = float(now[name][0])
            most = rate * self.dt
            now[name] = target if abs(target - value) <= most else value + math.copysign(most, target - value)
        speed = float(now["speed"][0])
        now["speed_rate"] = (speed - before) / self.dt
        if speed != self._paced and (self.steps % _PACING == 0 or speed == 1.0):
            self._pace(speed)

    def _pace(self, speed: float) -> None:
        """Takes the motion as it is balanced for a speed."""
        tempo = self.library.tempo(self._entry.name) if speed != 1.0 else None
        entry = self._entry
        self._paced = speed
        self._courses = entry.course, entry.demonstration
        if tempo is not None:
            target = tempo.at(speed)
            own = target if entry.course is entry.demonstration else tempo.changed(speed, entry.course)
            self._courses = own, target

    def _route(self) -> None:
        """Looks for the way to the goal, and lets the reference leave when the modulation is one that both allow."""
        if self._transition is not None or self.goal == self._entry.name or self.trouble is not None:
            return
        if self._armed is None:
            try:
                hop = self.library.next_hop(self._entry.name, self.goal)
            except MotionError as error:
                self.trouble, self.goal = str(error), self._entry.name
                return
            if hop is None:
                return
            self._armed = hop
        _, transition = self._armed
        if self.limits.hold(**self.modulation, slack=_LANDED):
            self._place["exit"], self._place["entry"] = transition.leave, transition.first
        else:
            self._place["exit"] = -1

    def _enter(self, entry: Entry) -> None:
        self._entry, self._paced = entry, 1.0
        self._courses = entry.course, entry.demonstration

    def _arrived(self) -> None:
        """The reference has gone from a motion into a transition, or out of it."""
        self._place["exit"] = -1
        if self._transition is not None:
            self._transition = None
            self._enter(self._following)
            return
        assert self._armed is not None
        name, self._transition = self._armed
        self._following = self.library.entry(name)
        self._armed = None
        self._place["exit"], self._place["entry"] = self._transition.last, self._transition.arrive

    def _disarm(self) -> None:
        if self._transition is None:
            self._armed = None
            self._place["exit"] = -1

    def _has_fallen(self) -> None:
        self.falls += 1
        self._transition = None
        self._disarm()
        self._recovery.begin()

    def _get_up(self) -> None:
        observation = self.simulation.step(self._recovery.step(self.simulation.observation))
        if self._recovery.phase is not GettingUpPhase.DONE:
            return
        self._enter(self.library.entry(STAND))
        obs = observation[0]
        self._place[...] = make_place()
        self._place["pose"][0] = (*obs["root_pos"][:2], float(yaw_from_quat(obs["root_quat"])))
        for name, neutral in (("speed", 1.0), ("turn", 0.0), ("lift", 1.0)):
            self._modulation[name] = neutral
        self._begin_control()

    def _begin_control(self) -> None:
        self._fill_all()
        self._clock["origin"] = self._place["pose"]
        self.controller.reset(np.zeros(1, np.int64))
        self._scorer.reset()
        self._score(self.simulation.observation)

    def _fill_all(self) -> None:
        self._stream.fill(self._course, self._next_course, self._place, self._modulation, self._tables[0])
