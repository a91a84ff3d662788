"""The simulated robot's body: MuJoCo, sensors, motors that damp when nobody commands them, and a motion service."""

import dataclasses
from enum import Enum
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from fastmimic.base.arrays import Array
from fastmimic.deploy.driver import damping_command
from fastmimic.robot import Robot
from fastmimic.robot.kinematics import foot_positions, inverse_kinematics
from fastmimic.robot.state import COMMAND
from fastmimic.simulation.mujoco_sim import MujocoSimulation
from fastmimic.simulation.sensors import SensorConfig, Sensors

PHYSICS_RATE_HZ: Final = 1000.0
STATE_RATE_HZ: Final = 500.0
PER_STATE: Final = 2
"""Physics steps from one measurement to the next."""
COMMAND_TIMEOUT_S: Final = 0.02
"""Of a `SimulatedBody`: ten commands."""
MODE: Final = "normal"
"""The name of the motion service's mode while it is active."""

_FOLDED: Final = 0.25  # height of the hips over the feet when it lies, share of the leg's length
_STIFFNESS, _DAMPING, _MASS_KG = 120.0, 3.0, 12.5
_MOVE_S: Final = 1.5  # for standing up or lying down
_SETTLE_S: Final = 1.0
_TIPPED: Final = 0.5  # cosine of the tilt beyond which it has fallen
_IMPACT: Final = 0.7  # m/s, with which it lands on anything but its feet if it has fallen
_WIRE_S: Final = 0.002  # of the sensors' assumed latency, which the real wire and its reader have here


class Start(Enum):
    """How a simulated robot begins."""

    LYING = "lying"
    STANDING = "standing"


def robot_sensors() -> SensorConfig:
    """The sensors of `SensorConfig`, less the one period of latency which the wire adds by itself."""
    config = SensorConfig()
    return dataclasses.replace(
        config,
        imu_latency_s=config.imu_latency_s - _WIRE_S,
        joint_latency_s=config.joint_latency_s - _WIRE_S,
        foot_latency_s=config.foot_latency_s - _WIRE_S,
    )


class MotionService:
    """The robot's own software that moves it until it is released: it stands, lies down and gets up.

    Attributes:
        active: whether it has the motors.
    """

    def __init__(self, robot: Robot, lying: Array, *, active: bool) -> None:
        self._stand, self._lying = robot.home_joint_pos, lying
        self._from, self._to, self._time = self._stand, self._stand, _MOVE_S
        self._command = np.zeros(1, COMMAND)
        gain = robot.mass / _MASS_KG
        self._command["stiffness"], self._command["damping"] = _STIFFNESS * gain, _DAMPING * gain
        self.active = active

    def lie_down(self) -> None:
        """Begins to."""
        self._move(self._lying)

    def stand_up(self) -> None:
        """Begins to."""
        self._move(self._stand)

    def take_over(self, joints: Array) -> None:
        """Becomes active again with the joints (12,) where they are, and stands up."""
        self._command["joint_pos"] = joints
        self.active = True
        self.stand_up()

    def command(self, dt: float) -> NDArray[Any]:
        """(1,) of `COMMAND` for the next dt s."""
        self._time = min(self._time + dt, _MOVE_S)
        share = self._time / _MOVE_S
        share = share * share * (3 - 2 * share)
        self._command["joint_pos"] = (1 - share) * self._from + share * self._to
        return self._command

    def _move(self, to: Array) -> None:
        self._from, self._to, self._time = self._command["joint_pos"][0].copy(), to, 0.0


class SimulatedBody:
    """A robot in MuJoCo, one physics step after the other.

    Args:
        robot: the robot.
        start: how it begins; standing, its motion service is active.
        sensors: what it measures with; those of `robot_sensors` if None.
        seed: of their errors.
        command_timeout_s: after which motors without commands damp, s.

    Attributes:
        observation: (1,) of `OBSERVATION`, the truth.
        reading: (1,) of `READING`, what has arrived of the sensors.
        command: (1,) of `COMMAND`, what the motors went by in the last step.
        service: its own motion service.
        damped: whether its motors damp, because no command has come or none has come in time.
        damped_s: for how long they have, s.
        fell: whether it has tipped over or landed on anything but its feet at more than 0.7 m/s.
        time: s that it has been there.
    """

    def __init__(
        self,
        robot: Robot,
        start: Start = Start.LYING,
        sensors: SensorConfig | None = None,
        seed: int = 0,
        command_timeout_s: float = COMMAND_TIMEOUT_S,
    ) -> None:
        self._simulation = MujocoSimulation(robot, 1, control_rate_hz=PHYSICS_RATE_HZ, physics_rate_hz=PHYSICS_RATE_HZ)
        self.sensors = Sensors(robot, 1, STATE_RATE_HZ, sensors if sensors is not None else robot_sensors())
        lying = lying_joints(robot)
        self.service = MotionService(robot, lying, active=start is Start.STANDING)
        self._damping = damping_command()
        self.command = self._damping
        self._last = np.zeros(1, COMMAND)
        self._commanded_at, self._timeout_s = -np.inf, command_timeout_s
        self._steps = 0
        self.damped, self.damped_s, self.fell = True, 0.0, False
        self._place(robot, robot.home_joint_pos if start is Start.STANDING else lying, start)
        self.reading = self.sensors.reset([np.random.default_rng(seed)], self.observation)

    @property
    def observation(self) -> NDArray[Any]:
        """See the class."""
        return self._simulation.observation

    @property
    def time(self) -> float:
        """See the class."""
        return self._steps / PHYSICS_RATE_HZ

    def obey(self, command: NDArray[Any]) -> None:
        """Takes a new command (1,) of `COMMAND`."""
        self._last[...] = command
        self._commanded_at = self.time

    def step(self) -> bool:
        """One physics step; whether the sensors have measured after it."""
        fresh = self.time - self._commanded_at < self._timeout_s
        self.damped = not fresh and not self.service.active
        if self.service.active:
            self.command = self.service.command(1.0 / PHYSICS_RATE_HZ)
        else:
            self.command = self._last if fresh else self._damping
        if self.damped:
            self.damped_s += 1.0 / PHYSICS_RATE_HZ
        falling = -float(self.observation["lin_vel"][0, 2])
        self._simulation.step(self.sensors.to_motors(self.command))
        self._steps += 1
        self._watch(falling)
        if self._steps % PER_STATE:
            return False
        self.sensors.measure(self.observation, self.command)
        return True

    def _watch(self, falling: float) -> None:
        _, x, y, _ = self.observation["root_quat"][0]
        up = 1 - 2 * (x * x + y * y)
        landed = self.observation["other_contact"][0] > 0 and falling > _IMPACT
        self.fell = self.fell or bool(up < _TIPPED or landed)

    def _place(self, robot: Robot, joints: Array, start: Start) -> None:
        feet = foot_positions(robot, joints[None])[0]
        height = robot.foot_radius - float(feet[:, 2].mean())
        zero = np.zeros((1, 3))
        self._simulation.reset(
            np.array([[0.0, 0.0, height]]),
            np.array([[1.0, 0.0, 0.0, 0.0]]),
            joints[None],
            zero,
            zero,
            np.zeros((1, 12)),
        )
        for _ in range(round(_SETTLE_S * PHYSICS_RATE_HZ)):
            standing = start is Start.STANDING
            self._simulation.step(self.service.command(1.0 / PHYSICS_RATE_HZ) if standing else self._damping)


def lying_joints(robot: Robot) -> Array:
    """(12,) with the legs folded under the body, feet below the hips as in the home pose, rad."""
    feet = foot_positions(robot, robot.home_joint_pos[None])[0]
    feet[:, 2] = robot.hip_pos_b[:, 2] - _FOLDED * robot.leg_length
    joints = inverse_kinematics(robot, feet[None])[0][0]
    return np.clip(joints, robot.joint_lower, robot.joint_upper)
