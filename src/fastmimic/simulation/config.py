"""Settings of the simulated sensors."""

import math
from dataclasses import dataclass
from typing import Final

from fastmimic.base.configuration import check, parameters, tabulated

_A1_GEAR: Final = 9.1


@tabulated
@dataclass(frozen=True)
class SensorConfig:
    """Sensors of a small quadruped such as the A1. Noise is white, drawn for each reading; errors that last are drawn
    for each episode. `ideal_sensors()` has none of it.

    Sources of the magnitudes: [A] the simulated A1 of S. Katayama's legged_state_estimator; [B] Bosch's data sheet of
    the BMI088, a usual IMU of this class: its offsets move by 0.2 mg and 0.015 °/s a kelvin, which leaves some 3 mg and
    0.1 °/s after a cold calibration at rest; [C] the motors' serial protocol in Unitree's actuator SDK (position 2¹⁴
    counts a turn of the rotor, speed 1/128 rad/s, torque 1/256 N·m before the gear of 9.1); [D] users' reports that the
    feet's pressure sensors drift (unitree_legged_sdk, issue 86). The rest is assumed: latency, as of messages at 500 Hz
    read one period late; the feet's offsets after zeroing in the air; joint offsets; the tilt error by walking.
    """

    imu_rate_hz: float = 500.0
    joint_rate_hz: float = 500.0
    foot_rate_hz: float = 250.0
    imu_latency_s: float = 0.004
    joint_latency_s: float = 0.004
    foot_latency_s: float = 0.006
    gyro_noise: float = 0.01
    gyro_bias: float = 0.002
    gyro_bias_walk: float = 1e-4
    accel_noise: float = 0.1
    accel_bias: float = 0.03
    accel_bias_walk: float = 1e-3
    orientation_noise: float = 0.001
    tilt_error: float = 0.002
    tilt_time: float = 5.0
    joint_pos_noise: float = 0.001
    joint_pos_quantum: float = 2 * math.pi / 2**14 / _A1_GEAR
    joint_offset: float = 0.003
    joint_vel_noise: float = 0.1
    joint_vel_quantum: float = 1 / 128 / _A1_GEAR
    torque_noise: float = 0.1
    torque_quantum: float = _A1_GEAR / 256
    torque_gain_error: float = 0.05
    foot_noise: float = 4.0
    foot_quantum: float = 1.0
    foot_gain_error: float = 0.1
    foot_offset: float = 5.0
    foot_offset_walk: float = 1.0

    def __post_init__(self) -> None:
        check(self, "sensors: ")


def ideal_sensors() -> SensorConfig:
    """Sensors without noise, bias, quantum or latency."""
    free = {name: 0.0 for name, (known, _) in parameters(SensorConfig).items() if known.above is None}
    return SensorConfig(imu_rate_hz=1e9, joint_rate_hz=1e9, foot_rate_hz=1e9, **free)
