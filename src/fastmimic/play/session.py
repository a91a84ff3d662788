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
from numpy.typing import NDArray

from fastmimic.base.arrays import Array
from fastmimic.base.errors import ConfigError, did_you_mean
from fastmimic.base.rotations import quat_from_yaw, quat_multiply, rotate_planar, yaw_from_quat
from fastmimic.clips.synthesis import GAITS
from fastmimic.control.config import ControllerConfig, controller_config
from fastmimic.control.controller import Controller
from fastmimic.episode.loop import on_ground, on_reference
from fastmimic.episode.reward import REWARD_TERMS, Scorer
from fastmimic.imitation.methods import METHODS
from fastmimic.motion.motion import Motion
from fastmimic.play.live_reference import GettingUp, GettingUpPhase, LiveReference, LiveWorld
from fastmimic.reference.motion_set import IN_PLACE, MotionSet, in_place
from fastmimic.reference.standing import STAND, standing
from fastmimic.reference.table import CLOCK, SAMPLE
from fastmimic.robot import Robot
from fastmimic.runs.loading import MotionSource, find_motion
from fastmimic.simulation.mujoco_sim import MujocoSimulation
from fastmimic.simulation.terrain import Terrain

DEFAULTS: Final = (STAND, IN_PLACE, "walk", "trot", "pace", "turn", "side-step", "spin", "backward-trot", "bound")
_MADE: Final = {STAND: standing, IN_PLACE: in_place}
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
    wanted: NDArray[np.bool_]  # (4,) by the schedule
    measured: NDArray[np.bool_]  # (4,) loaded feet
    stance: NDArray[np.bool_]  # (4,) of the gait planner
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
        if name in _MADE:
            motion = _MADE[name](robot)
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

    `motions` are cyclic ones by name, `start` is the first of them ("stand" if None), `method` the controller, one of
    `playable_methods()`, `config` its parameters, or the name of a set; `ideal` as in `Conditions`; `terrain` is the
    ground, flat if None. Raises `ConfigError` if there is no such motion, controller or configuration, `MotionError`
    for a motion that cannot be played.

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
        ideal: bool = False,
        terrain: Terrain | None = None,
    ) -> None:
        self.robot = robot
        self._given = controller_config(config) if isinstance(config, str) else config
        self.rate_hz = self._given.rate_hz
        self.dt = 1.0 / self.rate_hz
        self.library = (
            motions
            if isinstance(motions, MotionSet)
            else MotionSet(robot, motions, self.rate_hz, regulator=self._given.regulator)
        )
        self.simulation = MujocoSimulation(robot, 1, control_rate_hz=self.rate_hz, ideal=ideal, ground=terrain)
        self.terrain = terrain
        self.world = LiveWorld(self.simulation)
        name = start if start is not None else STAND
        self.reference = LiveReference(robot, self.library, self.rate_hz, name)
        self._clock = np.zeros(1, CLOCK)
        self._truth = np.zeros(1, SAMPLE)
        self._scorer = Scorer(robot, self._truth, 1, self._given, self.rate_hz)
        stand = self.library.entry(STAND).motion
        height = float(stand.root_pos_w[0, 2])
        self._recovery = GettingUp(robot, self.simulation, stand.joint_pos[0], height, self.dt)
        self.falls = 0
        self.steps = 0
        self._control_s: deque[float] = deque(maxlen=_TIMINGS)
        self.method = ""
        self.set_method(method)
        self._loaded = self._given.release_force(robot)
        self.reset()

    # requests

    def switch(self, name: str) -> None:
        """Changes to another motion as soon as feet and phase allow; raises `ConfigError` for an unknown one."""
        self.reference.switch(name)

    def want(self, name: str, value: float) -> None:
        """Requests a modulation, cut to the motion's limits: "speed" and "lift" are factors on its own speed and swing
        height, "turn" is a turn rate in addition to its own, rad/s, positive to the left."""
        self.reference.want(name, value)

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
        if self._recovery.phase is GettingUpPhase.DONE:
            self._has_fallen()

    # state

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
    def modulation(self) -> dict[str, float]:
        """The present modulation: speed, turn (rad/s), lift."""
        return self.reference.modulation

    @property
    def fallen(self) -> bool:
        """Whether the robot lies or gets up."""
        return self._recovery.phase is not GettingUpPhase.DONE

    @property
    def state(self) -> str:
        return self._recovery.phase.value if self.fallen else self.reference.state

    @property
    def control_us(self) -> tuple[float, float]:
        """Median and 99th percentile of the last few thousand control steps' durations, µs."""
        if not self._control_s:
            return 0.0, 0.0
        found = np.percentile(np.array(self._control_s), (50, 99)) * 1e6
        return float(found[0]), float(found[1])

    def snapshot(self) -> Snapshot:
        obs, truth, memory, up = self.observation, self._truth[0], self.controller.memory[0], not self.fallen
        yaw = float(yaw_from_quat(obs["root_quat"]))
        pose = np.concatenate([obs["root_pos"], obs["root_quat"], obs["joint_pos"]])
        if not np.isfinite(pose).all():
            pose = np.concatenate([[0.0, 0.0, 0.3, 1.0, 0.0, 0.0, 0.0], self._recovery.command["joint_pos"][0]])
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

    # simulation

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
        self._recovery.phase = GettingUpPhase.DONE
        self._begin_control()

    def step(self) -> None:
        self.world.apply()
        if self.steps % _PREPARING == 0:
            self.library.prepare(self.motion)
        if self.fallen:
            self._get_up()
        else:
            self.reference.update(self.steps)
            self._control()
        self.steps += 1

    def _control(self) -> None:
        began = time.perf_counter()
        self._fill()
        self._clock["origin"] = self.reference.place["pose"]
        if self.controller.config.stance.feedback == "regulator":
            self.controller.gains = self.reference.gains[None]
            self.controller.recover_with(self.reference.demonstration)
        commands = self.controller.step(self.simulation.observation, self._clock)
        self._control_s.append(time.perf_counter() - began)
        observation = self.simulation.step(commands)
        self.reference.advance(observation["root_pos"][0, :2], float(self.controller.memory["haste"][0]))
        self._score(observation)

    def _score(self, observation: NDArray[Any]) -> None:
        """Scores against the present demonstration, modulated like the reference."""
        self.reference.fill(self._truth, scored=True)
        self._clock["origin"] = self.reference.place["pose"]
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
        self.reference.give_up_transition()
        self._recovery.begin()

    def _get_up(self) -> None:
        observation = self.simulation.step(self._recovery.step(self.simulation.observation))
        if self._recovery.phase is not GettingUpPhase.DONE:
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
        self._score(self.simulation.observation)
