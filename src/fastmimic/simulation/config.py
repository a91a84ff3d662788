"""Settings of the simulated sensors."""

import math
from dataclasses import dataclass
from typing import Final

from fastmimic.base.configuration import check, documented, parameter, parameters

_A1_GEAR: Final = 9.1


@documented
@dataclass(frozen=True)
class SensorConfig:
    """Sensors of a small quadruped such as the A1. Noise is white, drawn for each reading; errors that last are drawn
    for each episode. `ideal_sensors()` has none of it.

    Sources of the magnitudes: [A] the simulated A1 of S. Katayama's legged_state_estimator; [B] Bosch's data sheet of
    the BMI088, a usual IMU of this class: its offsets move by 0.2 mg and 0.015 °/s a kelvin, which leaves some 3 mg and
    0.1 °/s after a cold calibration at rest; [C] the motors' serial protocol in Unitree's actuator SDK (position 2¹⁴
    counts a turn of the rotor, speed 1/128 rad/s, torque 1/256 N·m before the gear of 9.1); [D] users' reports that the
    feet's pressure sensors drift (unitree_legged_sdk, issue 86). The rest is assumed: latency, as of state messages of
    500 Hz read one period late; the feet's offsets after zeroing in the air; joint offsets; and the tilt error by
    walking.
    """

    imu_rate_hz: float = parameter(
        500.0, unit="Hz", above=0.0, key="", about="IMU readings, at most one a control step; each holds until the next"
    )
    joint_rate_hz: float = parameter(500.0, unit="Hz", above=0.0, key="", about="joint readings")
    foot_rate_hz: float = parameter(250.0, unit="Hz", above=0.0, key="", about="foot readings")
    imu_latency_s: float = parameter(
        0.004, unit="s", key="", about="until an IMU reading arrives, rounded to control steps"
    )
    joint_latency_s: float = parameter(0.004, unit="s", key="", about="until a joint reading arrives")
    foot_latency_s: float = parameter(0.006, unit="s", key="", about="until a foot reading arrives")
    gyro_noise: float = parameter(0.01, unit="rad/s", about="of each reading [A]")
    gyro_bias: float = parameter(0.002, unit="rad/s", about="of each axis [B]")
    gyro_bias_walk: float = parameter(1e-4, unit="rad/s/√s", about="random walk of the bias")
    accel_noise: float = parameter(0.1, unit="m/s²", about="of each reading [A]")
    accel_bias: float = parameter(0.03, unit="m/s²", about="of each axis [B]")
    accel_bias_walk: float = parameter(1e-3, unit="m/s²/√s", about="random walk of the bias")
    orientation_noise: float = parameter(
        0.001,
        unit="rad",
        about="of the IMU's own orientation about each axis; its vertical is off by the accelerometer's bias over g,"
        " and its heading drifts by the gyro's bias and noise",
    )
    tilt_error: float = parameter(0.002, unit="rad", about="a slow additional error in roll and pitch")
    tilt_time: float = parameter(5.0, unit="s", above=0.0, about="correlation time of the tilt error")
    joint_pos_noise: float = parameter(0.001, unit="rad", about="of each reading [A]")
    joint_pos_quantum: float = parameter(2 * math.pi / 2**14 / _A1_GEAR, unit="rad", about="resolution [C]")
    joint_offset: float = parameter(
        0.003, unit="rad", about="of the zero position; the motor's own position loop has the same offset"
    )
    joint_vel_noise: float = parameter(0.1, unit="rad/s", about="of each reading [A]")
    joint_vel_quantum: float = parameter(1 / 128 / _A1_GEAR, unit="rad/s", about="resolution [C]")
    torque_noise: float = parameter(0.1, unit="N·m", about="of each reading [A]")
    torque_quantum: float = parameter(_A1_GEAR / 256, unit="N·m", about="resolution [C]")
    torque_gain_error: float = parameter(0.05, about="of each joint, relative")
    foot_noise: float = parameter(4.0, unit="N", about="of each reading")
    foot_quantum: float = parameter(1.0, unit="N", about="resolution")
    foot_gain_error: float = parameter(0.1, about="of each foot, relative")
    foot_offset: float = parameter(5.0, unit="N", about="of each foot [D]")
    foot_offset_walk: float = parameter(1.0, unit="N/√s", about="random walk of the offset [D]")

    def __post_init__(self) -> None:
        check(self, "sensors: ")


def ideal_sensors() -> SensorConfig:
    """Sensors without noise, bias, quantum or latency."""
    free = {name: 0.0 for name, (known, _) in parameters(SensorConfig).items() if known.above is None}
    return SensorConfig(imu_rate_hz=1e9, joint_rate_hz=1e9, foot_rate_hz=1e9, **free)
