"""The estimator's parameters: one set for all motions and all robots."""

from dataclasses import dataclass
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray

from fastmimic.base.configuration import check, documented, pack, parameter, record_fields
from fastmimic.base.conventions import GRAVITY
from fastmimic.base.errors import ConfigError
from fastmimic.base.jit import floats, record_dtype
from fastmimic.robot import Robot

FOOT_FORCES: Final = ("auto", "off", "on")


@documented
@dataclass(frozen=True)
class EstimatorConfig:
    """How base state and contacts are estimated. Standard deviations are those that the filter assumes."""

    latency_s: float = parameter(
        0.004,
        unit="s",
        key="latency",
        about="age of IMU and joint readings when they arrive; the estimate is extrapolated by it",
    )
    rate_time: float = parameter(
        0.008, unit="s", above=0.0, about="span of the rates of change of angular velocity and joint speeds for that"
    )
    orientation_time: float = parameter(
        0.1,
        unit="s",
        above=0.0,
        key="",
        about="time constant with which the gyro's integral follows the IMU's orientation",
    )
    accel_noise: float = parameter(
        0.5,
        unit="m/s²",
        above=0.0,
        key="",
        about="of the specific force in a control step: the sensor's noise, and gravity by the tilt error",
    )
    position_noise: float = parameter(
        0.002, unit="m", above=0.0, key="", about="of a foot's place relative to the base, by leg kinematics"
    )
    velocity_noise: float = parameter(
        0.07, unit="m/s", above=0.0, key="", about="of the base's velocity, by one standing leg"
    )
    foot_walk: float = parameter(0.01, unit="m/√s", key="", about="random walk of a standing foot")
    height_noise: float = parameter(
        0.005, unit="m", above=0.0, key="", about="of the ground's height under a standing foot"
    )
    ground_time: float = parameter(
        1.0, unit="s", above=0.0, about="time constant with which the frame turns into the plane of the standing feet"
    )
    ground_start: float = parameter(
        0.05,
        unit="s",
        above=0.0,
        about="the same at the start; it grows with the time for which two feet or more have stood",
    )
    slip_gate: float = parameter(
        4.0,
        above=0.0,
        key="",
        about="Mahalanobis distance of a standing leg's velocity beyond which the foot counts as sliding: it then gets"
        " a new anchor and a smaller weight",
    )
    foot_force: Literal["auto", "off", "on"] = parameter(
        "auto",
        choices=FOOT_FORCES,
        about="what tells contact. off: joint torques; auto: foot sensors as well, once they are found right; on: foot"
        " sensors alone",
    )
    torque_time: float = parameter(
        0.003, unit="s", above=0.0, about="lag of torques and joint speeds: the inverse of the momentum observer's gain"
    )
    load_noise: float = parameter(
        0.02, unit="weights", above=0.0, scale="weight", about="least noise of a load by torques; more is learnt"
    )
    load_odds: float = parameter(1.25, about="load, in units of its noise, that speaks neither for nor against contact")
    schedule_odds: float = parameter(0.5, about="log-odds of contact in scheduled stance, and against it in swing")
    height_scale: float = parameter(
        0.005, unit="m", above=0.0, about="height over the ground that takes one from the log-odds of contact"
    )
    height_lead: float = parameter(0.02, unit="s", about="how far ahead that height is, at the foot's present speed")
    release_time: float = parameter(0.016, unit="s", about="how long a foot in scheduled stance may be without load")
    learn_time: float = parameter(
        1.0, unit="s", above=0.0, key="", about="memory of what swinging legs teach, and of how foot sensors compare"
    )
    contact_force: float = parameter(
        0.1,
        unit="weights",
        above=0.0,
        scale="weight",
        about="force on a foot sensor above which the foot touches the ground; how much a load must vary for the sensor"
        " to be found right",
    )
    release_force: float = parameter(
        0.05, unit="weights", scale="weight", about="force on a foot sensor below which the foot no longer touches"
    )
    settle_time: float = parameter(0.04, unit="s", about="time after touch-down in which a foot has a smaller weight")
    force_time: float = parameter(0.004, unit="s", key="", about="time constant of the foot sensors' smoothing")
    tare_delay: float = parameter(
        0.06, unit="s", about="time after lift-off from which a leg is in mid-swing: a foot sensor feels its offset"
    )
    tare_time: float = parameter(0.1, unit="s", above=0.0, key="", about="time constant of that offset")

    def __post_init__(self) -> None:
        check(self, "estimator: ")
        if self.release_force > self.contact_force:
            raise ConfigError(
                f"estimator: release_force ({self.release_force:g}) must not be above contact_force"
                f" ({self.contact_force:g})"
            )


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


def pack_config(config: EstimatorConfig, robot: Robot, rate_hz: float) -> NDArray[Any]:
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
