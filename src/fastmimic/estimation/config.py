"""The estimator's parameters: one set for all motions and all robots."""

from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from fastmimic.base.arrays import Records
from fastmimic.base.configuration import check, pack, record_fields, tabulated
from fastmimic.base.conventions import GRAVITY
from fastmimic.base.errors import ConfigError
from fastmimic.base.jit import floats, record_dtype
from fastmimic.robot import Robot


@tabulated
@dataclass(frozen=True)
class EstimatorConfig:
    """How base state and contacts are estimated. Standard deviations are those that the filter assumes."""

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
    foot_force: Literal["auto", "off", "on"] = "auto"
    torque_time: float = 0.003
    load_noise: float = 0.02
    load_rate_noise: float = 1e-4
    load_odds: float = 1.25
    schedule_odds: float = 0.5
    height_scale: float = 0.005
    height_lead: float = 0.02
    release_time: float = 0.016
    learn_time: float = 1.0
    contact_force: float = 0.1
    release_force: float = 0.05
    settle_time: float = 0.04
    force_time: float = 0.004
    tare_delay: float = 0.06
    tare_time: float = 0.1

    def __post_init__(self) -> None:
        check(self, "estimator: ")
        if self.release_force > self.contact_force:
            release, contact = f"release_force ({self.release_force:g})", f"contact_force ({self.contact_force:g})"
            raise ConfigError(f"estimator: {release} must not be above {contact}")


CONFIG: Final = record_dtype(
    [
        *floats(dt=()),
        *record_fields(EstimatorConfig),
        *floats(accel_var=(), position_var=(), velocity_var=(), foot_var=(), height_var=(), gate_sq=()),
        *floats(orientation_gain=(), force_gain=(), tare_gain=(), torque_gain=(), swing_gain=(), learn_gain=()),
        *floats(weight=(), foot_radius=(), geometry=(4, 12)),
    ]
)
"""Configuration and robot as the kernels read them; variances are those of one control step."""


def pack_config(config: EstimatorConfig, robot: Robot, rate_hz: float) -> Records:
    """(1,) of `CONFIG`."""
    dt = 1.0 / rate_hz
    record = np.zeros(1, CONFIG)
    pack(config, record, {"weight": robot.mass * GRAVITY})
    record["dt"] = dt
    record["orientation_gain"] = min(1.0, dt / config.orientation_time)
    record["accel_var"] = config.accel_noise**2
    record["position_var"] = config.position_noise**2
    record["velocity_var"] = config.velocity_noise**2
    record["foot_var"] = config.foot_walk**2 * dt
    record["height_var"] = config.height_noise**2
    record["gate_sq"] = config.slip_gate**2
    record["force_gain"] = dt / (dt + config.force_time)
    record["tare_gain"] = min(1.0, dt / config.tare_time)
    record["torque_gain"] = dt / (dt + config.torque_time)
    record["swing_gain"] = dt / (dt + config.latency_s + config.torque_time)
    record["learn_gain"] = min(1.0, dt / config.learn_time)
    record["weight"] = robot.mass * GRAVITY
    record["foot_radius"] = robot.foot_radius
    record["geometry"] = robot.geometry
    return record
