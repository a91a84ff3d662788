"""Settings of a policy's observation, action, rates and gains, as in Peng et al. 2020."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from fastmimic.base.arrays import Array, Records
from fastmimic.base.configuration import check, pack, record_fields, tabulated
from fastmimic.base.errors import ConfigError
from fastmimic.base.jit import floats, record_dtype
from fastmimic.robot import Robot
from fastmimic.robot.robot import joint_ratio

HISTORY: Final = 3  # policy steps of sensors and actions in an observation, the present one included
IMU_SIZE: Final = 4
FRAMES: Final = (1, 2, 10, 30)  # target frames, policy steps ahead
FRAME_SIZE: Final = 19
OBSERVATION_SIZE: Final = HISTORY * (IMU_SIZE + 12 + 12) + len(FRAMES) * FRAME_SIZE
ACTION_SIZE: Final = 12


@tabulated
@dataclass(frozen=True)
class PolicyConfig:
    """The interface between a policy and the robot. A policy works only with the one of its training."""

    control_rate_hz: float = 500.0
    decimation: int = 17
    action_scale: float = 0.25
    filter_cutoff_hz: float = 4.0
    stiffness: tuple[float, float, float] = (100.0, 100.0, 100.0)
    damping: tuple[float, float, float] = (1.0, 2.0, 2.0)

    def __post_init__(self) -> None:
        check(self, "policy configuration: ")
        if self.filter_cutoff_hz >= 0.5 * self.rate_hz:
            raise ConfigError("policy configuration: filter_cutoff_hz must be below half the rate of actions")

    @property
    def rate_hz(self) -> float:
        """Actions per second."""
        return self.control_rate_hz / self.decimation


SETTINGS: Final = record_dtype(
    [
        *record_fields(PolicyConfig),
        *floats(numerator=3, denominator=2),  # of the filter, without the leading 1
        *floats(home=12, lower=12, upper=12),  # rad; home: the target of a zero action
    ]
)  # `PolicyConfig` and the robot's limits in the kernels' format


def pack_settings(config: PolicyConfig, robot: Robot) -> Records:
    numerator, denominator = low_pass(config.filter_cutoff_hz, config.rate_hz)
    record = np.zeros(1, SETTINGS)
    pack(config, record, {"joint": joint_ratio(robot)})
    record["numerator"], record["denominator"] = numerator, denominator[1:]
    record["home"], record["lower"], record["upper"] = robot.home_joint_pos, robot.joint_lower, robot.joint_upper
    return record


def low_pass(cutoff_hz: float, rate_hz: float) -> tuple[Array, Array]:
    """Second-order Butterworth low-pass by the bilinear transform: numerator (3,) and denominator (3,)."""
    k = np.tan(np.pi * cutoff_hz / rate_hz)
    norm = 1.0 + np.sqrt(2.0) * k + k * k
    b = k * k / norm
    return np.array([b, 2 * b, b]), np.array([1.0, 2 * (k * k - 1) / norm, (1 - np.sqrt(2.0) * k + k * k) / norm])


def action_bounds(config: PolicyConfig, robot: Robot) -> tuple[Array, Array]:
    """Least and greatest action (12,), for joint targets at the joints' limits."""
    home, scale = robot.home_joint_pos, config.action_scale
    return (robot.joint_lower - home) / scale, (robot.joint_upper - home) / scale
