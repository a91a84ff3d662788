"""Settings of a policy's observation, action, rates and gains, as in Peng et al. 2020."""

import dataclasses
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from fastmimic.base.errors import ConfigError
from fastmimic.base.jit import record_dtype
from fastmimic.robot import Robot

HISTORY: Final = 3  # policy steps of sensors and actions in an observation, the present one included
IMU_SIZE: Final = 4
FRAMES: Final = (1, 2, 10, 30)  # target frames, policy steps ahead
FRAME_SIZE: Final = 19
OBSERVATION_SIZE: Final = HISTORY * (IMU_SIZE + 12 + 12) + len(FRAMES) * FRAME_SIZE
ACTION_SIZE: Final = 12


@dataclass(frozen=True)
class PolicyConfig:
    """The interface between a policy and the robot. A policy works only with the one of its training.

    Attributes:
        control_rate_hz: of the loop that sends joint targets to the motors, equal to the model-based controller's.
        decimation: control steps per action; 17 at 500 Hz are 29.4 actions a second.
        action_scale: rad of joint target per unit of action.
        filter_cutoff_hz: of the second-order Butterworth low-pass on actions.
        stiffness, damping: of abduction, hip and knee, N·m/rad and N·m·s/rad.
    """

    control_rate_hz: float = 500.0
    decimation: int = 17
    action_scale: float = 0.25
    filter_cutoff_hz: float = 4.0
    stiffness: tuple[float, float, float] = (100.0, 100.0, 100.0)
    damping: tuple[float, float, float] = (1.0, 2.0, 2.0)

    def __post_init__(self) -> None:
        checks = (
            (self.control_rate_hz > 0, "control_rate_hz must be positive"),
            (self.decimation >= 1, "decimation must be at least 1"),
            (self.action_scale > 0, "action_scale must be positive"),
            (
                0 < self.filter_cutoff_hz < 0.5 * self.control_rate_hz / max(self.decimation, 1),
                "filter_cutoff_hz must be above 0 and below half the rate of actions",
            ),
            (len(self.stiffness) == len(self.damping) == 3, "stiffness and damping have three numbers each"),
            (all(g >= 0 for g in (*self.stiffness, *self.damping)), "gains must not be negative"),
        )
        for ok, message in checks:
            if not ok:
                raise ConfigError(f"policy configuration: {message}")

    @property
    def rate_hz(self) -> float:
        """Actions per second."""
        return self.control_rate_hz / self.decimation

    def as_dict(self) -> dict[str, Any]:
        return dataclasses.asdict(self)

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> "PolicyConfig":
        """Inverse of `as_dict`; raises `ConfigError` for other content."""
        try:
            gains = {name: tuple(float(g) for g in values[name]) for name in ("stiffness", "damping")}
            return cls(**{**values, **gains})
        except (TypeError, KeyError, ValueError) as error:
            raise ConfigError(f"policy configuration: not readable ({error})") from None


SETTINGS: Final = record_dtype(
    [
        ("decimation", "i8"),
        ("action_scale", "f8"),
        ("numerator", "f8", (3,)),  # of the filter
        ("denominator", "f8", (2,)),  # without the leading 1
        ("home", "f8", (12,)),  # rad, the target of a zero action
        ("lower", "f8", (12,)),
        ("upper", "f8", (12,)),
        ("stiffness", "f8", (12,)),
        ("damping", "f8", (12,)),
    ]
)
"""`PolicyConfig` and the robot's limits in the kernels' format."""


def pack_settings(config: PolicyConfig, robot: Robot) -> NDArray[Any]:
    numerator, denominator = low_pass(config.filter_cutoff_hz, config.rate_hz)
    record = np.zeros(1, SETTINGS)
    record["decimation"] = config.decimation
    record["action_scale"] = config.action_scale
    record["numerator"] = numerator
    record["denominator"] = denominator[1:]
    record["home"] = robot.home_joint_pos
    record["lower"] = robot.joint_lower
    record["upper"] = robot.joint_upper
    record["stiffness"] = np.tile(config.stiffness, 4)
    record["damping"] = np.tile(config.damping, 4)
    return record


def low_pass(cutoff_hz: float, rate_hz: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Second-order Butterworth low-pass by the bilinear transform: numerator (3,) and denominator (3,)."""
    k = np.tan(np.pi * cutoff_hz / rate_hz)
    norm = 1.0 + np.sqrt(2.0) * k + k * k
    b = k * k / norm
    return np.array([b, 2 * b, b]), np.array([1.0, 2 * (k * k - 1) / norm, (1 - np.sqrt(2.0) * k + k * k) / norm])


def action_bounds(config: PolicyConfig, robot: Robot) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Least and greatest action (12,), for joint targets at the joints' limits."""
    lower = (robot.joint_lower - robot.home_joint_pos) / config.action_scale
    upper = (robot.joint_upper - robot.home_joint_pos) / config.action_scale
    return lower, upper
