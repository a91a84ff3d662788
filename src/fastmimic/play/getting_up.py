"""Getting up after a fall: relax the joints, fold the legs, rise; a robot on its side or back is first set upright."""

from enum import Enum
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from fastmimic.base.arrays import Array
from fastmimic.base.rotations import quat_from_yaw, quat_rotate, yaw_from_quat
from fastmimic.reference.standing import along, rising_path, smooth, standing_gains
from fastmimic.robot import Robot
from fastmimic.robot.state import COMMAND
from fastmimic.simulation.mujoco_sim import MujocoSimulation

LIMP_S: Final = 0.5
FOLD_S: Final = 0.7
RISE_S: Final = 1.0
SETTLE_S: Final = 0.3
_UPRIGHT: Final = 0.7  # cosine of the largest tilt from which the legs can push up
_TRIES: Final = 3


class GettingUpPhase(Enum):
    LIMP = "fallen"
    FOLD = "folding its legs"
    RISE = "getting up"
    DONE = "up"


class GettingUp:
    """Attempts to get up, until the robot stands with joints `stand`, (12,) rad, and base `height`, m."""

    def __init__(self, robot: Robot, simulation: MujocoSimulation, stand: Array, height: float, dt: float) -> None:
        self._simulation, self._dt = simulation, dt
        self._stand, self._height = stand, height
        self._path, self._folded_height = rising_path(robot, stand)
        self._stiffness, self._damping = standing_gains(robot)
        self.command = np.zeros(1, COMMAND)
        self.phase = GettingUpPhase.DONE
        self._time, self._tries = 0.0, 0
        self._from = self._path[0]
        self.was_set_up = False

    def begin(self) -> None:
        """Starts after a fall."""
        self.phase, self._time, self._tries, self.was_set_up = GettingUpPhase.LIMP, 0.0, 0, False

    def step(self, observation: NDArray[Any]) -> NDArray[Any]:
        """Commands (1,) of `COMMAND` for the next control step, from an observation (1,)."""
        obs, command = observation[0], self.command
        self._time += self._dt
        command["torque"] = 0.0
        command["joint_vel"] = 0.0
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
        self._simulation.reset(position, quat_from_yaw(np.array([yaw])), self._path[:1], zero, zero, np.zeros((1, 12)))
        self.was_set_up = True
        self._tries = 0
        self._go(GettingUpPhase.RISE, self._simulation.observation[0])

    @staticmethod
    def _up(obs: Any) -> float:
        """Cosine of the trunk's tilt."""
        return float(quat_rotate(obs["root_quat"], np.array([0.0, 0.0, 1.0]))[2])
