"""What happens to a live robot: pushes, another friction, a payload, and getting up after a fall.

It gets up by relaxing its joints, folding its legs and rising; if it lies on its side or back, it is first set upright.
"""

import math
from enum import Enum
from typing import Any, Final

import numpy as np

from fastmimic.base.arrays import Array, Records
from fastmimic.base.conventions import GROUND_FRICTION
from fastmimic.base.errors import ConfigError
from fastmimic.base.rotations import quat_from_yaw, quat_rotate, yaw_from_quat
from fastmimic.episode.loop import on_ground
from fastmimic.reference.standing import along, rising_path, smooth, standing_gains
from fastmimic.robot import Robot
from fastmimic.robot.state import COMMAND
from fastmimic.simulation.mujoco_sim import MujocoSimulation
from fastmimic.simulation.simulators import Placement

PUSH_S: Final = 0.1  # duration of a push
MAX_IMPULSE: Final = 100.0
FRICTION: Final = (0.2, 1.5)
MAX_PAYLOAD_KG: Final = 10.0
LIMP_S: Final = 0.5
FOLD_S: Final = 0.7
RISE_S: Final = 1.0
SETTLE_S: Final = 0.3
_UPRIGHT: Final = 0.7  # cosine of the largest tilt from which the legs can push up
_TRIES: Final = 3


class LiveWorld:
    """The ground of one simulated robot, its coefficient of `friction` with every foot, and what is done to the trunk:
    pushes, and a payload at its centre of mass, unknown to the controller."""

    def __init__(self, simulation: MujocoSimulation) -> None:
        model, self.trunk = simulation.model, simulation.trunk
        self._batch = simulation.batch
        self._step_s = simulation.substeps * float(model.opt.timestep)
        self._applied, self._by_hand = self._batch.bind("xfrc_applied"), simulation.by_hand
        self._mass = self._batch.expand("body_mass")
        self._sliding = self._batch.expand("geom_friction")
        self._own_mass = float(model.body_mass[self.trunk])
        self._push = np.zeros(3)
        self._push_steps = 0
        self.friction = GROUND_FRICTION

    def push(self, impulse: float, direction: float, yaw: float = 0.0) -> None:
        """Pushes the trunk's centre of mass horizontally, for `PUSH_S` from now, by an impulse of 0 … `MAX_IMPULSE`
        N·s, in a direction from the heading `yaw`, rad, positive to the left; raises `ConfigError` for others."""
        if not (math.isfinite(impulse) and 0.0 <= impulse <= MAX_IMPULSE and math.isfinite(direction)):
            raise ConfigError(f"a push has 0 to {MAX_IMPULSE:g} N·s, found {impulse:g} N·s")
        self._push_steps = max(1, round(PUSH_S / self._step_s))
        force = impulse / (self._push_steps * self._step_s)
        self._push[:] = force * math.cos(yaw + direction), force * math.sin(yaw + direction), 0.0

    @property
    def force(self) -> Array:
        """The present push, (3,) world, N."""
        return self._push if self._push_steps > 0 else np.zeros(3)

    def apply(self) -> None:
        """Applies the push; call before each control step."""
        self._applied[0, self.trunk, :3] = self._by_hand[0] = self.force
        self._push_steps = max(0, self._push_steps - 1)

    def set_friction(self, coefficient: float) -> None:
        """Sets the friction of every contact; raises `ConfigError` outside `FRICTION`."""
        if not FRICTION[0] <= coefficient <= FRICTION[1]:
            raise ConfigError(f"friction must be {FRICTION[0]:g} to {FRICTION[1]:g}, found {coefficient:g}")
        self._sliding[0, :, 0] = coefficient  # MuJoCo takes the greater one of two surfaces
        self.friction = coefficient

    def set_payload(self, mass_kg: float) -> None:
        """Sets the trunk's payload; raises `ConfigError` outside 0 … `MAX_PAYLOAD_KG`."""
        if not 0.0 <= mass_kg <= MAX_PAYLOAD_KG:
            raise ConfigError(f"the payload must be 0 to {MAX_PAYLOAD_KG:g} kg, found {mass_kg:g}")
        self._mass[0, self.trunk] = self._own_mass + mass_kg
        self._batch.set_const()


class GettingUpPhase(Enum):
    LIMP = "fallen"
    FOLD = "folding its legs"
    RISE = "getting up"
    DONE = "up"


class GettingUp:
    """Attempts to get up, until the robot stands with joints `stand`, (12,) rad, and base `height`, m."""

    def __init__(self, robot: Robot, simulation: MujocoSimulation, stand: Array, height: float, dt: float) -> None:
        self._robot, self._simulation, self._dt = robot, simulation, dt
        self._stand, self._height = stand, height
        self._path, self._folded_height = rising_path(robot, stand)
        self._stiffness, self._damping = standing_gains(robot)
        self.command = np.zeros(1, COMMAND)
        self._from = self._path[0]
        self.begin()
        self.phase = GettingUpPhase.DONE

    def begin(self) -> None:
        self.phase, self._time, self._tries = GettingUpPhase.LIMP, 0.0, 0

    def step(self, observation: Records) -> Records:
        """Commands (1,) of `COMMAND` for the next control step, from an observation (1,)."""
        ground, command = self._simulation.ground, self.command
        obs = (observation if ground is None else ground.seen(observation))[0]
        self._time += self._dt
        command["torque"] = command["joint_vel"] = 0.0
        if not np.isfinite(obs["root_pos"]).all() or not np.isfinite(obs["joint_pos"]).all():
            self._set_on_belly(np.zeros(2), 0.0)
            obs = self._simulation.observation[0]
        if self.phase is GettingUpPhase.LIMP:
            command["stiffness"], command["damping"] = 0.0, 2.0 * self._damping
            command["joint_pos"] = obs["joint_pos"]
            if self._time >= LIMP_S:
                if self._up(obs) < _UPRIGHT or self._tries >= _TRIES:
                    self._set_on_belly(obs["root_pos"][:2], float(yaw_from_quat(obs["root_quat"])))
                else:
                    self._go(GettingUpPhase.FOLD, obs)
            return command
        command["stiffness"], command["damping"] = self._stiffness, self._damping
        if self.phase is GettingUpPhase.FOLD:
            share = smooth(self._time / FOLD_S)
            command["joint_pos"] = self._from + share * (self._path[0] - self._from)
            if self._time >= FOLD_S:
                self._go(GettingUpPhase.RISE, obs)
        else:
            command["joint_pos"] = along(self._path, self._time / RISE_S)
            if self._time >= RISE_S + SETTLE_S:
                stands = self._up(obs) > 0.95 and obs["root_pos"][2] > 0.7 * self._height
                self._tries += 1
                self._go(GettingUpPhase.DONE if stands and obs["other_contact"] < 0.5 else GettingUpPhase.LIMP, obs)
        return command

    def _go(self, phase: GettingUpPhase, obs: Any) -> None:
        self.phase, self._time, self._from = phase, 0.0, np.array(obs["joint_pos"])

    def _set_on_belly(self, xy: Array, yaw: float) -> None:
        """Places the robot on its belly with folded legs, in the same place and heading."""
        position = np.array([[xy[0], xy[1], self._folded_height]])
        zero = np.zeros((1, 3))
        place = Placement(position, quat_from_yaw(np.array([yaw])), self._path[:1], zero, zero, np.zeros((1, 12)))
        self._simulation.reset(*on_ground(self._simulation.ground, self._robot, place))
        self._tries = 0
        self._go(GettingUpPhase.RISE, self._simulation.observation[0])

    @staticmethod
    def _up(obs: Any) -> float:
        """Cosine of the trunk's tilt."""
        return float(quat_rotate(obs["root_quat"], np.array([0.0, 0.0, 1.0]))[2])
