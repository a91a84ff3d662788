"""The live session: a robot under the controller, steered by hand, script or test, and the motions that it plays."""

import math
import time
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import chain, count
from pathlib import Path
from typing import Any, Final

import numpy as np

from fastmimic.base.arrays import Array, Flags, Records
from fastmimic.base.errors import ConfigError, did_you_mean
from fastmimic.base.rotations import quat_from_yaw, quat_multiply, rotate_planar, yaw_from_quat
from fastmimic.clips.synthesis import GAITS
from fastmimic.control.config import ControllerConfig, controller_config
from fastmimic.control.controller import Controller
from fastmimic.episode.loop import on_ground, on_reference
from fastmimic.episode.observer import Observer
from fastmimic.episode.reward import REWARD_TERMS, Scorer
from fastmimic.estimation.estimator import START
from fastmimic.imitation.methods import METHODS
from fastmimic.motion.motion import Motion
from fastmimic.play.live_world import GettingUp, GettingUpPhase, LiveWorld
from fastmimic.reference.motion_set import ALWAYS, IN_PLACE, LiveReference, MotionSet
from fastmimic.reference.standing import STAND
from fastmimic.reference.table import CLOCK, SAMPLE
from fastmimic.robot import Robot
from fastmimic.runs.loading import MotionSource, find_motion
from fastmimic.simulation.conditions import Conditions
from fastmimic.simulation.mujoco_sim import MujocoSimulation
from fastmimic.simulation.simulators import make_simulation
from fastmimic.steering.gait_field import RATE_HZ as GAIT_RATE_HZ
from fastmimic.steering.gait_field import GaitField
from fastmimic.steering.steered import Steered

DEFAULTS: Final = (STAND, IN_PLACE, "walk", "trot", "pace", "turn", "side-step", "spin", "backward-trot", "bound")
_TIMINGS: Final = 2000
_PREPARING: Final = 50  # control steps between two attempts to prepare something


@dataclass(frozen=True, eq=False)
class Snapshot:
    """The present moment. Arrays are copies."""

    time_s: float  # simulated since the start
    pose: Array  # (19,) position (world, m), quaternion, joints
    reference: Array  # (19,) of what it is scored against
    force: Array  # (4, 3) the ground's on each foot, world, N
    asked: Array  # (4, 3) as commanded
    wanted: Flags  # (4,) by the schedule
    measured: Flags  # (4,) loaded feet
    stance: Flags  # (4,) of the gait planner
    terms: Array  # (k,) the reward's in this step, 0 while the robot gets up
    reward: float  # of this step
    velocity_b: Array  # (3,) of the base, heading frame, m/s
    turn_rate: float  # about the vertical, rad/s
    push: Array  # (3,) force, world, N


def playable_methods() -> list[str]:
    """Names of the methods available in a live session."""
    return [method.name for method in METHODS.values() if method.playable]


def check_method(name: str) -> None:
    """Raises `ConfigError` for a method that is not available in a live session."""
    names = playable_methods()
    if name not in names:
        raise ConfigError(f"'{name}' cannot be played; there are {', '.join(names)}{did_you_mean(name, names)}")


def load_motions(sources: Sequence[str | MotionSource], robot: Robot) -> dict[str, Motion]:
    """Motions by the names used in a session, from names, clips, robot motions (.npz) or folders of runs; also "stand"
    and "in-place". Raises `FastMimicError` for unknown ones or files that cannot be read."""
    found: dict[str, Motion] = {}
    for given in sources:
        source = find_motion(given) if isinstance(given, str) else given
        name = source.name
        if name in ALWAYS:
            motion = ALWAYS[name](robot)
        else:
            motion = source.load(robot)
            name = name if name in GAITS or ":" in name else _short(name, motion)
        numbered = (f"{name} ({k})" for k in count(2))
        found[next(free for free in chain([name], numbered) if free not in found)] = motion
    return found


def _short(source: str, motion: Motion) -> str:
    path = Path(source)
    if path.is_dir():
        return path.resolve().name
    return motion.name if path.stem == "motion" else path.stem


class LiveSession:
    """One robot in an endless simulation. One thread at a time.

    `motions` are cyclic ones by name, `start` is the first of them, `method` the controller, one of
    `playable_methods()`, `config` its parameters, or the name of a set. With `gaits` the robot is steered by a velocity
    instead, see `steer`. Raises `ConfigError` if there is no such motion, controller or configuration, or the simulator
    is not MuJoCo; `MotionError` for a motion that cannot be played.

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
        start: str = STAND,
        method: str = "mbc",
        config: ControllerConfig | str = "default",
        conditions: Conditions = Conditions(),
        gaits: GaitField | None = None,
    ) -> None:
        self.robot = robot
        self._given = controller_config(config) if isinstance(config, str) else config
        self.rate_hz = self._given.rate_hz
        self.dt = 1.0 / self.rate_hz
        if not isinstance(motions, MotionSet):
            motions = MotionSet(robot, motions, self.rate_hz, regulator=self._given.regulator)
        self.motions = motions
        self.conditions = conditions
        simulation = make_simulation(robot, 1, self.conditions, control_rate_hz=self.rate_hz)
        if not isinstance(simulation, MujocoSimulation):
            raise ConfigError(f"a live session is simulated by mujoco, not by {self.conditions.simulator}")
        self.simulation = simulation
        self.terrain = self.conditions.ground
        if gaits is not None and self.rate_hz != GAIT_RATE_HZ:
            raise ConfigError(f"steering takes a controller at {GAIT_RATE_HZ:g} Hz, not at {self.rate_hz:g} Hz")
        sensors = self.conditions.observe == "sensors"
        self._observer = Observer(robot, 1, self.rate_hz, self.conditions) if sensors else None
        self._seen: Records = simulation.observation
        self.world = LiveWorld(self.simulation)
        self.reference: LiveReference | Steered = (
            LiveReference(robot, motions, self.rate_hz, start) if gaits is None else Steered(gaits)
        )
        self._clock = np.zeros(1, CLOCK)
        self._truth = np.zeros(1, SAMPLE)
        self._scorer = Scorer(robot, self._truth, 1, self._given, self.rate_hz)
        stand = self.motions.entries[STAND].motion
        height = float(stand.root_pos_w[0, 2])
        self._getting_up = GettingUp(robot, self.simulation, stand.joint_pos[0], height, self.dt)
        self.falls = 0
        self.steps = 0
        self._control_s: deque[float] = deque(maxlen=_TIMINGS)
        self.method = ""
        self.set_method(method)
        self._loaded = self._given.release_force(robot)
        self.reset()

    def switch(self, name: str) -> None:
        """Changes to another motion as soon as feet and phase allow; raises `ConfigError` for an unknown one."""
        if not isinstance(self.reference, LiveReference):
            raise ConfigError("a steered robot plays no motions")
        self.reference.switch(name)

    def steer(self, velocity: Sequence[float] | Array) -> Array:
        """Requests a velocity (3,): forwards, to the left, m/s, turning to the left, rad/s. Returns the nearest one of
        the gaits, which the robot comes to; raises `ConfigError` without gaits, or if it is not three numbers."""
        if not isinstance(self.reference, Steered):
            raise ConfigError("this session has no gaits to steer with")
        return self.reference.steer(np.asarray(velocity, dtype=np.float64))

    @property
    def steered(self) -> bool:
        """Whether a velocity steers the robot; otherwise it plays motions."""
        return isinstance(self.reference, Steered)

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
        self.controller: Controller = Controller(self.robot, [self.motions.entries[STAND].motion], 1, config)
        ahead = config.samples_ahead
        self._every = max(1, round(config.rate_hz / config.horizon.solve_rate_hz)) if ahead > 1 else 1
        self._tables = np.zeros((1, ahead), SAMPLE)
        self.controller.tables = self._tables
        self.method = name
        if before is not None:
            self.controller.memory[...] = before
            self.controller.memory["recovering"], self.controller.memory["haste"] = 0, 0.0

    def fall(self) -> None:
        """Lets the robot go limp, as after a fall."""
        if self._getting_up.phase is GettingUpPhase.DONE:
            self._has_fallen()

    @property
    def observation(self) -> Any:
        """The robot's state, one of `OBSERVATION`."""
        return self.simulation.observation[0]

    @property
    def time_s(self) -> float:
        """Simulated time since the start."""
        return self.steps * self.dt

    @property
    def motion(self) -> str:
        return self.reference.motion

    @property
    def fallen(self) -> bool:
        """Whether the robot lies or gets up."""
        return self._getting_up.phase is not GettingUpPhase.DONE

    @property
    def state(self) -> str:
        return self._getting_up.phase.value if self.fallen else self.reference.state

    @property
    def control_us(self) -> tuple[float, float]:
        """Median and 99th percentile of the last few thousand control steps' durations, µs."""
        median, p99 = np.percentile(self._control_s or [0.0], (50, 99)) * 1e6
        return float(median), float(p99)

    def snapshot(self) -> Snapshot:
        obs, truth, memory, up = self.observation, self._truth[0], self.controller.memory[0], not self.fallen
        yaw = float(yaw_from_quat(obs["root_quat"]))
        pose = np.concatenate([obs["root_pos"], obs["root_quat"], obs["joint_pos"]])
        if not np.isfinite(pose).all():
            pose = np.concatenate([[0.0, 0.0, 0.3, 1.0, 0.0, 0.0, 0.0], self._getting_up.command["joint_pos"][0]])
        x, y, turned = self.reference.place["pose"][0]
        orientation = quat_multiply(quat_from_yaw(turned), truth["root_quat"])
        place = np.array([x, y, truth["root_pos"][2]])
        if self.terrain is not None:
            place, orientation = self.terrain.plane(x, y).laid(place, orientation)
        force, asked = np.nan_to_num(obs["foot_force"]), np.array(memory["force"])
        asked[:, :2] = rotate_planar(yaw, asked[:, :2])
        velocity = np.array(obs["lin_vel"])
        velocity[:2] = rotate_planar(-yaw, velocity[:2])
        return Snapshot(
            time_s=self.time_s,
            pose=pose,
            reference=np.concatenate([place, orientation, truth["joint_pos"]]),
            force=force,
            asked=asked if up else np.zeros((4, 3)),
            wanted=truth["contact"].astype(bool),
            measured=force[:, 2] > self._loaded,
            stance=memory["stance"].astype(bool),
            terms=self._scorer.terms[0].copy() if up else np.zeros(len(REWARD_TERMS)),
            reward=float(self._scorer.reward[0]) if up else 0.0,
            velocity_b=velocity,
            turn_rate=float(obs["ang_vel"][2]),
            push=self.world.force.copy(),
        )

    def prepare(self) -> None:
        """Begins to make what may be needed next, in the background."""
        if isinstance(self.reference, LiveReference):
            self.motions.prepare(self.motion)

    def run(self, seconds: float) -> None:
        """Simulates this much time as fast as possible."""
        for _ in range(round(seconds * self.rate_hz)):
            self.step()

    def reset(self) -> None:
        """Puts the robot into its motion at its present place and heading; at first in the middle of the world."""
        obs = self.observation
        known = bool(np.isfinite(obs["root_pos"]).all() and np.abs(obs["root_quat"]).sum() > 0.5)
        yaw = float(yaw_from_quat(obs["root_quat"])) if known else 0.0
        x, y = obs["root_pos"][:2] if known else (0.0, 0.0)
        self.reference.put(x, y, yaw)
        self._fill()
        place = on_reference(self._tables[0], np.zeros(1, np.int64), self.reference.place["pose"])
        self.simulation.reset(*on_ground(self.terrain, self.robot, place))
        self._getting_up.phase = GettingUpPhase.DONE
        self._begin_control()

    def step(self) -> None:
        self.world.apply()
        if self.steps % _PREPARING == 0:
            self.prepare()
        if self.fallen:
            self._get_up()
        else:
            self.reference.update()
            self._control()
        self.steps += 1

    def _control(self) -> None:
        began = time.perf_counter()
        self._fill()
        self._clock["origin"] = self.reference.place["pose"]
        if self.controller.config.stance.feedback == "regulator":
            self.controller.gains = self.reference.gains[None]
            self.controller.recover_with(self.reference.demonstration)
        if self.steered:  # in haste, too, its feet that stand keep their places
            self.controller.memory["lag"] = 0.0
        commands = self.controller.step(self._seen, self._clock)
        self._control_s.append(time.perf_counter() - began)
        observer = self._observer
        if observer is None:
            observation = self._seen = self.simulation.step(commands)
        else:
            observation = self.simulation.step(observer.sensors.to_motors(commands))
            self._seen = observer.look(observation, self.controller.memory, self._tables)
        self.reference.advance(self._seen["root_pos"][0, :2], float(self.controller.memory["haste"][0]))
        self._score(observation)

    def _score(self, observation: Records) -> None:
        self.reference.fill(self._truth, scored=True)
        self._clock["origin"] = self.reference.place["pose"]
        if self._observer is not None:  # the reference is where the robot is by its sensors
            told, true = self._seen, observation
            self._clock["origin"][:, :2] += true["root_pos"][:, :2] - told["root_pos"][:, :2]
            self._clock["origin"][:, 2] += yaw_from_quat(true["root_quat"]) - yaw_from_quat(told["root_quat"])
        self._clock["jump"] = self.reference.place["jump"]
        seen = observation if self.terrain is None else self.terrain.seen(observation)
        self._scorer.score(self._clock, observation, self.controller.memory, seen)
        if self._scorer.tallies["fallen"][0]:
            self._has_fallen()

    def _fill(self) -> None:
        """Fills the reference: the present sample, and when a plan is due also its horizon."""
        rows = self._tables[0] if self.steps % self._every == 0 else self._tables[0, :1]
        self.reference.fill(rows)

    def _has_fallen(self) -> None:
        self.falls += 1
        self._getting_up.begin()

    def _get_up(self) -> None:
        observation = self.simulation.step(self._getting_up.step(self.simulation.observation))
        if self._getting_up.phase is not GettingUpPhase.DONE:
            return
        obs = observation[0]
        x, y = obs["root_pos"][:2]
        self.reference.stand(x, y, float(yaw_from_quat(obs["root_quat"])))
        self._begin_control()

    def _begin_control(self) -> None:
        self.reference.fill(self._tables[0])
        self._clock["origin"] = self.reference.place["pose"]
        self.controller.reset(np.zeros(1, np.int64))
        self._scorer.reset()
        truth = self._seen = self.simulation.observation
        if self._observer is not None:
            known = np.zeros(1, START)
            known["position"], known["heading"] = truth["root_pos"][:, :2], yaw_from_quat(truth["root_quat"])
            known["velocity"] = truth["lin_vel"]
            episode = np.array([self.falls])
            self._seen = self._observer.reset(truth, known, self.controller.memory["stance"], episode, self._clock)
        self._score(truth)
