"""The estimator's parameters: one set for all motions and all robots."""

import dataclasses
import math
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from fastmimic.base.conventions import GRAVITY
from fastmimic.base.errors import ConfigError
from fastmimic.base.jit import record_dtype
from fastmimic.robot import Robot


@dataclass(frozen=True)
class EstimatorConfig:
    """How base state and contacts are estimated. Standard deviations are those that the filter assumes.

    Attributes:
        latency_s: age of IMU and joint readings when they arrive; the estimate is extrapolated by it, s.
        rate_time: over which the rates of change of angular velocity and joint speeds are taken for that, s.
        orientation_time: time constant with which the gyro's integral follows the IMU's orientation, s.
        accel_noise: of the specific force, m/s² in a control step: the sensor's noise, and what a tilt error makes of
            gravity.
        position_noise: of a foot's place relative to the base by leg kinematics, m.
        velocity_noise: of the base's velocity by one standing leg, m/s.
        foot_walk: by which a standing foot creeps, m/√s.
        height_noise: of the ground's height under a standing foot, m.
        ground_time: time constant with which the frame turns into the plane of the standing feet, s.
        ground_start: the same at the start, s; it grows with the time for which two feet or more have stood.
        slip_gate: Mahalanobis distance of a standing leg's velocity beyond which the foot counts as sliding: it is then
            anchored anew and weighs less.
        contact_force, release_force: above the first a foot touches the ground, below the second it no longer does;
            multiples of the robot's weight.
        settle_time: for which a foot that has touched down weighs less, s.
        force_time: time constant with which the foot sensors are smoothed, s.
        tare_delay, tare_time: from this long after lift-off, what the force sensor says is taken for its offset, with
            this time constant, s.
    """

    latency_s: float = 0.004
    rate_time: float = 0.008
    orientation_time: float = 0.1
    accel_noise: float = 0.5
    position_noise: float = 0.002
    velocity_noise: float = 0.07
    foot_walk: float = 0.01
    height_noise: float = 0.005
    ground_time: float = 1.0
    ground_start: float = 0.05
    slip_gate: float = 4.0
    contact_force: float = 0.1
    release_force: float = 0.05
    settle_time: float = 0.04
    force_time: float = 0.004
    tare_delay: float = 0.06
    tare_time: float = 0.1

    def __post_init__(self) -> None:
        may_be_zero = ("latency_s", "foot_walk", "release_force", "settle_time", "force_time", "tare_delay")
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            if not math.isfinite(value) or value < 0 or (value == 0 and field.name not in may_be_zero):
                least = "not negative" if field.name in may_be_zero else "positive"
                raise ConfigError(f"estimator: {field.name} must be finite and {least}, found {value}")
        if self.release_force > self.contact_force:
            raise ConfigError(
                f"estimator: release_force ({self.release_force:g}) must not be above contact_force"
                f" ({self.contact_force:g})"
            )


CONFIG: Final = record_dtype(
    [
        ("dt", "f8"),
        ("latency", "f8"),
        ("ground_time", "f8"),
        ("ground_start", "f8"),
        ("rate_time", "f8"),
        ("orientation_gain", "f8"),
        ("accel_var", "f8"),
        ("position_var", "f8"),
        ("velocity_var", "f8"),
        ("foot_var", "f8"),
        ("height_var", "f8"),
        ("gate_sq", "f8"),
        ("contact_force", "f8"),
        ("release_force", "f8"),
        ("settle_time", "f8"),
        ("force_gain", "f8"),
        ("tare_delay", "f8"),
        ("tare_gain", "f8"),
        ("foot_radius", "f8"),
        ("geometry", "f8", (4, 12)),
    ]
)
"""Configuration and robot as the kernels read them; variances are those of one control step."""


def pack_config(config: EstimatorConfig, robot: Robot, rate_hz: float) -> NDArray[Any]:
    """The configuration as an array of one `CONFIG` record."""
    dt, weight = 1.0 / rate_hz, robot.mass * GRAVITY
    record = np.zeros(1, CONFIG)
    record["dt"] = dt
    record["latency"] = config.latency_s
    record["ground_time"] = config.ground_time
    record["ground_start"] = config.ground_start
    record["rate_time"] = config.rate_time
    record["orientation_gain"] = min(1.0, dt / config.orientation_time)
    record["accel_var"] = config.accel_noise**2
    record["position_var"] = config.position_noise**2
    record["velocity_var"] = config.velocity_noise**2
    record["foot_var"] = config.foot_walk**2 * dt
    record["height_var"] = config.height_noise**2
    record["gate_sq"] = config.slip_gate**2
    record["contact_force"] = config.contact_force * weight
    record["release_force"] = config.release_force * weight
    record["settle_time"] = config.settle_time
    record["force_gain"] = dt / (dt + config.force_time)
    record["tare_delay"] = config.tare_delay
    record["tare_gain"] = min(1.0, dt / config.tare_time)
    record["foot_radius"] = robot.foot_radius
    record["geometry"] = robot.geometry.rows
    return record
