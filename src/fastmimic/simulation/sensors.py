"""Simulated sensors: what an IMU, joint encoders and foot sensors say of a robot's true state."""

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from fastmimic.base.arrays import Array
from fastmimic.base.conventions import GRAVITY
from fastmimic.base.errors import ConfigError
from fastmimic.base.jit import inlined, kernel, record_dtype
from fastmimic.base.vectors import quat_to_matrix, transposed_times
from fastmimic.estimation.estimator import turn_by
from fastmimic.estimation.reading import READING
from fastmimic.robot import Robot
from fastmimic.robot.state import COMMAND

_BLOCK: Final = 128  # control steps for which noise is drawn at once
_A1_GEAR: Final = 9.1


@dataclass(frozen=True)
class SensorConfig:
    """Sensors of a small quadruped such as the A1. Noise is white, drawn for each reading; errors that last are drawn
    for each episode. `ideal_sensors()` has none of it.

    Where the magnitudes are from: [A] the simulated A1 of S. Katayama's legged_state_estimator (gyro 0.01 rad/s,
    accelerometer 0.1 m/s², joints 0.001 rad and 0.1 rad/s, torque 0.1 N·m); [B] Bosch's data sheet of the BMI088, a
    usual IMU of this class, whose offsets move by 0.2 mg and 0.015 °/s a kelvin: some 3 mg and 0.1 °/s are left where
    it was calibrated cold, its gyro at rest just before; [C] the motors' serial protocol in Unitree's actuator SDK
    (position 2¹⁴ counts a turn of the rotor, speed 1/128 rad/s, torque 1/256 N·m before the gear of 9.1); [D] users'
    reports that the feet's pressure sensors drift (unitree_legged_sdk, issue 86). The rest is assumed: latency, as of
    state messages of 500 Hz that are read one period late; what is left of the feet's offsets after they were zeroed in
    the air; joint offsets; and what walking adds to the tilt error.

    Attributes:
        imu_rate_hz, joint_rate_hz, foot_rate_hz: readings a second, at most one in a control step; each holds until the
            next.
        imu_latency_s, joint_latency_s, foot_latency_s: until a reading arrives, s; rounded to control steps.
        gyro_noise, gyro_bias, gyro_bias_walk: rad/s [A]; of each axis, rad/s [B]; rad/s/√s.
        accel_noise, accel_bias, accel_bias_walk: m/s² [A]; of each axis, m/s² [B]; m/s²/√s.
        orientation_noise: of the IMU's own orientation about each axis, rad. Its vertical is the accelerometer's, wrong
            by that bias over g; its heading drifts by the gyro's bias and noise.
        tilt_error, tilt_time: a slow error in roll and pitch besides, rad, and how long it lasts, s.
        joint_pos_noise, joint_pos_quantum, joint_offset: rad [A]; rad [C]; of the zero position, rad. The motor's own
            position loop has the same offset.
        joint_vel_noise, joint_vel_quantum: rad/s [A], [C].
        torque_noise, torque_quantum, torque_gain_error: N·m [A], [C]; fraction.
        foot_noise, foot_quantum, foot_gain_error: N; N; fraction.
        foot_offset, foot_offset_walk: N; N/√s [D].
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
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            least = field.name.endswith("_rate_hz") or field.name == "tilt_time"
            if not math.isfinite(value) or value < 0 or (least and value == 0):
                raise ConfigError(
                    f"sensors: {field.name} must be finite and {'positive' if least else 'not negative'}, found {value}"
                )


def ideal_sensors() -> SensorConfig:
    """Sensors without noise, bias, quantum or latency."""
    kept = ("imu_rate_hz", "joint_rate_hz", "foot_rate_hz", "tilt_time")
    zero = {f.name: 0.0 for f in dataclasses.fields(SensorConfig) if f.name not in kept}
    return SensorConfig(imu_rate_hz=1e9, joint_rate_hz=1e9, foot_rate_hz=1e9, **zero)


_ERRORS: Final = record_dtype(
    [
        ("tick", "i8"),
        ("gyro_bias", "f8", (3,)),
        ("accel_bias", "f8", (3,)),
        ("attitude", "f8", (3,)),
        ("joint_offset", "f8", (12,)),
        ("torque_gain", "f8", (12,)),
        ("foot_gain", "f8", (4,)),
        ("foot_offset", "f8", (4,)),
        ("velocity", "f8", (3,)),
        ("up", "f8", (3,)),
        ("level", "f8", (4,)),
    ]
)
"""One robot's errors that last, and its velocity at the last reading of the IMU. `attitude` is that of the IMU's
orientation, a small rotation vector in the world frame. `up` is the vertical in the simulation's frame, and `level` the
rotation from there to a frame in which it is z."""

_NOISE: Final = record_dtype(
    [
        ("gyro", "f8", (3,)),
        ("gyro_bias", "f8", (3,)),
        ("accel", "f8", (3,)),
        ("accel_bias", "f8", (3,)),
        ("orientation", "f8", (3,)),
        ("tilt", "f8", (2,)),
        ("joint_pos", "f8", (12,)),
        ("joint_vel", "f8", (12,)),
        ("torque", "f8", (12,)),
        ("foot", "f8", (4,)),
        ("foot_offset", "f8", (4,)),
    ]
)
"""Standard normal numbers for one control step of a robot."""

_DRAWN: Final = _NOISE.itemsize // 8

_CONFIG: Final = record_dtype(
    [
        ("dt", "f8"),
        ("periods", "i8", (3,)),  # control steps between readings of IMU, joints and feet
        ("delays", "i8", (3,)),  # control steps until they arrive
        *((f.name, "f8") for f in dataclasses.fields(SensorConfig) if not f.name.endswith(("_hz", "_s"))),
        ("torque_limit", "f8", (12,)),
    ]
)


def _pack(config: SensorConfig, robot: Robot, rate_hz: float) -> NDArray[Any]:
    record = np.zeros(1, _CONFIG)
    for name in _CONFIG.names or ():
        if hasattr(config, name):
            record[name] = getattr(config, name)
    rates = (config.imu_rate_hz, config.joint_rate_hz, config.foot_rate_hz)
    latencies = (config.imu_latency_s, config.joint_latency_s, config.foot_latency_s)
    record["dt"] = 1.0 / rate_hz
    record["periods"] = [max(1, round(rate_hz / r)) for r in rates]
    record["delays"] = [round(t * rate_hz) for t in latencies]
    record["torque_limit"] = robot.torque_limit
    return record


@inlined
def _rounded(value: float, quantum: float) -> float:
    return np.round(value / quantum) * quantum if quantum > 0.0 else value


@inlined
def _measure_imu(c: Any, errors: Any, noise: Any, truth: Any, out: Any, rotation: Array, work: Array) -> None:
    """Orientation, angular velocity, and the mean specific force since the last reading, with the orientation halfway:
    what an IMU says that samples much faster and sums up."""
    quat_to_matrix(truth.root_quat, rotation)
    transposed_times(rotation, truth.ang_vel, out.gyro)
    span = c.dt * c.periods[0]
    for k in range(3):
        work[k] = (truth.lin_vel[k] - errors.velocity[k]) / span if errors.tick > 0 else 0.0
        work[k] += GRAVITY * errors.up[k]
        errors.velocity[k] = truth.lin_vel[k]
    transposed_times(rotation, work, out.accel)
    half, g, f = 0.5 * span if errors.tick > 0 else 0.0, out.gyro, out.accel
    tx = half * (g[1] * f[2] - g[2] * f[1])
    ty = half * (g[2] * f[0] - g[0] * f[2])
    tz = half * (g[0] * f[1] - g[1] * f[0])
    f[0] += tx + errors.accel_bias[0] + c.accel_noise * noise.accel[0]
    f[1] += ty + errors.accel_bias[1] + c.accel_noise * noise.accel[1]
    f[2] += tz + errors.accel_bias[2] + c.accel_noise * noise.accel[2]
    for k in range(3):
        g[k] += errors.gyro_bias[k] + c.gyro_noise * noise.gyro[k]
    # an attitude filter takes its vertical from the accelerometer: u × ε = b / g for the vertical u in the body frame
    b, u, e, s = errors.accel_bias, work, errors.attitude, c.orientation_noise
    transposed_times(rotation, errors.up, u)
    w, x, y, z = errors.level[0], errors.level[1], errors.level[2], errors.level[3]
    q = truth.root_quat
    out.quat[0] = w * q[0] - x * q[1] - y * q[2] - z * q[3]
    out.quat[1] = w * q[1] + x * q[0] + y * q[3] - z * q[2]
    out.quat[2] = w * q[2] - x * q[3] + y * q[0] + z * q[1]
    out.quat[3] = w * q[3] + x * q[2] - y * q[1] + z * q[0]
    turn_by(
        out.quat,
        (b[1] * u[2] - b[2] * u[1]) / GRAVITY,
        (b[2] * u[0] - b[0] * u[2]) / GRAVITY,
        (b[0] * u[1] - b[1] * u[0]) / GRAVITY,
        True,
    )
    turn_by(out.quat, s * noise.orientation[0], s * noise.orientation[1], s * noise.orientation[2], True)
    turn_by(out.quat, e[0], e[1], 0.0, False)
    turn_by(out.quat, 0.0, 0.0, e[2], False)


@inlined
def _measure_joints(c: Any, errors: Any, noise: Any, truth: Any, command: Any, out: Any) -> None:
    """Angles, speeds and the torques that the motors make of the command."""
    for j in range(12):
        q, dq = truth.joint_pos[j], truth.joint_vel[j]
        out.joint_pos[j] = _rounded(
            q + errors.joint_offset[j] + c.joint_pos_noise * noise.joint_pos[j], c.joint_pos_quantum
        )
        out.joint_vel[j] = _rounded(dq + c.joint_vel_noise * noise.joint_vel[j], c.joint_vel_quantum)
        torque = command.torque[j] + command.stiffness[j] * (command.joint_pos[j] - q)
        torque += command.damping[j] * (command.joint_vel[j] - dq)
        torque = min(max(torque, -c.torque_limit[j]), c.torque_limit[j])
        out.torque[j] = _rounded(torque * errors.torque_gain[j] + c.torque_noise * noise.torque[j], c.torque_quantum)


@inlined
def _drift(c: Any, errors: Any, noise: Any) -> None:
    """One control step of the errors that last. The heading drifts with what the IMU's gyro gets wrong."""
    root = np.sqrt(c.dt)
    keep = np.exp(-c.dt / c.tilt_time)
    spread = c.tilt_error * np.sqrt(1.0 - keep * keep)
    for k in range(2):
        errors.attitude[k] = keep * errors.attitude[k] + spread * noise.tilt[k]
    errors.attitude[2] += c.dt * (errors.gyro_bias[2] + c.gyro_noise * noise.gyro[2])
    for k in range(3):
        errors.gyro_bias[k] += c.gyro_bias_walk * root * noise.gyro_bias[k]
        errors.accel_bias[k] += c.accel_bias_walk * root * noise.accel_bias[k]
    for leg in range(4):
        errors.foot_offset[leg] += c.foot_offset_walk * root * noise.foot_offset[leg]


@kernel
def _measure(
    config: Any, errors: Any, noises: Any, truths: Any, commands: Any, ring: Any, outs: Any, at: int, work: Array
) -> None:
    """What all robots' sensors measure now, into a ring (n, depth) of readings, and what has arrived of it by now."""
    c = config[0]
    depth = ring.shape[1]
    for i in range(truths.shape[0]):
        e, truth, noise = errors[i], truths[i], noises[i, at]
        now, last = ring[i, e.tick % depth], ring[i, (e.tick + depth - 1) % depth]
        if e.tick % c.periods[0] == 0:
            _measure_imu(c, e, noise, truth, now, work[:3], work[3])
        else:
            now.quat[:], now.gyro[:], now.accel[:] = last.quat, last.gyro, last.accel
        if e.tick % c.periods[1] == 0:
            _measure_joints(c, e, noise, truth, commands[i], now)
        else:
            now.joint_pos[:], now.joint_vel[:], now.torque[:] = last.joint_pos, last.joint_vel, last.torque
        for leg in range(4):
            now.foot_force[leg] = last.foot_force[leg]
            if e.tick % c.periods[2] == 0:
                force = e.foot_gain[leg] * max(truth.foot_force[leg, 2], 0.0) + e.foot_offset[leg]
                now.foot_force[leg] = _rounded(force + c.foot_noise * noise.foot[leg], c.foot_quantum)
        out = outs[i]
        imu = ring[i, max(e.tick - c.delays[0], 0) % depth]
        joints = ring[i, max(e.tick - c.delays[1], 0) % depth]
        feet = ring[i, max(e.tick - c.delays[2], 0) % depth]
        out.quat[:], out.gyro[:], out.accel[:] = imu.quat, imu.gyro, imu.accel
        out.joint_pos[:], out.joint_vel[:], out.torque[:] = joints.joint_pos, joints.joint_vel, joints.torque
        out.foot_force[:] = feet.foot_force
        _drift(c, e, noise)
        e.tick += 1


@kernel
def _shift(errors: Any, commands: Any, outs: Any) -> None:
    for i in range(commands.shape[0]):
        outs[i].joint_vel[:] = commands[i].joint_vel
        outs[i].stiffness[:] = commands[i].stiffness
        outs[i].damping[:] = commands[i].damping
        outs[i].torque[:] = commands[i].torque
        for j in range(12):
            outs[i].joint_pos[j] = commands[i].joint_pos[j] - errors[i].joint_offset[j]


class Sensors:
    """The sensors of n robots. What a robot draws depends on its generator alone, not on the robots beside it."""

    def __init__(
        self,
        robot: Robot,
        n: int,
        rate_hz: float,
        config: SensorConfig | None = None,
        gravity: Array | None = None,
    ) -> None:
        """
        Args:
            robot: the robot.
            n: number of robots.
            rate_hz: control steps a second.
            config: parameters; those of `SensorConfig` if None.
            gravity: (n, 3) its directions in the simulation's frame, unit vectors; downwards if None.
        """
        self.config = config if config is not None else SensorConfig()
        self._config = _pack(self.config, robot, rate_hz)
        self._errors = np.zeros(n, _ERRORS)
        self._up = -gravity if gravity is not None else np.tile([0.0, 0.0, 1.0], (n, 1))
        self._ring = np.zeros((n, 1 + int(self._config["delays"].max())), READING)
        self._noise = np.zeros((n, _BLOCK), _NOISE)
        self._normals = self._noise.view(np.float64).reshape(n, _BLOCK, _DRAWN)
        self._generators: Sequence[np.random.Generator] = ()
        self._work = np.zeros((4, 3))
        self._step = 0
        self._command = np.zeros(n, COMMAND)
        self.reading = np.zeros(n, READING)

    def reset(self, generators: Sequence[np.random.Generator], truth: NDArray[Any]) -> NDArray[Any]:
        """Begins n episodes, each with its own random stream, and measures their first states.

        Args:
            generators: n random streams.
            truth: (n,) of `OBSERVATION`.

        Returns:
            (n,) of `READING`; overwritten by the next call.
        """
        assert len(generators) == len(self._errors)
        self._generators, self._step = generators, 0
        errors, config = self._errors, self.config
        errors[...] = np.zeros((), _ERRORS)
        errors["up"] = self._up
        # the smallest rotation from up to z: (1 + up·z, up × z), normalised
        level = np.column_stack([1.0 + self._up[:, 2], self._up[:, 1], -self._up[:, 0], np.zeros(len(errors))])
        errors["level"] = level / np.linalg.norm(level, axis=1, keepdims=True)
        for i, rng in enumerate(generators):
            errors["gyro_bias"][i] = config.gyro_bias * rng.standard_normal(3)
            errors["accel_bias"][i] = config.accel_bias * rng.standard_normal(3)
            errors["attitude"][i, :2] = config.tilt_error * rng.standard_normal(2)
            errors["joint_offset"][i] = config.joint_offset * rng.standard_normal(12)
            errors["torque_gain"][i] = 1.0 + config.torque_gain_error * rng.standard_normal(12)
            errors["foot_gain"][i] = 1.0 + config.foot_gain_error * rng.standard_normal(4)
            errors["foot_offset"][i] = config.foot_offset * rng.standard_normal(4)
        return self.measure(truth, np.zeros(len(errors), COMMAND))

    def measure(self, truth: NDArray[Any], commands: NDArray[Any]) -> NDArray[Any]:
        """What has arrived of the sensors at the end of a control step.

        Args:
            truth: (n,) of `OBSERVATION`, the state at its end.
            commands: (n,) of `COMMAND`, what the motors were told for it.

        Returns:
            (n,) of `READING`; overwritten by the next call.
        """
        at = self._step % _BLOCK
        if at == 0:
            for rng, block in zip(self._generators, self._normals, strict=True):
                rng.standard_normal(out=block)
        self._step += 1
        _measure(self._config, self._errors, self._noise, truth, commands, self._ring, self.reading, at, self._work)
        return self.reading

    def to_motors(self, commands: NDArray[Any]) -> NDArray[Any]:
        """What commands (n,) of `COMMAND` mean to motors whose encoders have these offsets: they close their position
        loops on what they measure. Overwritten by the next call."""
        _shift(self._errors, commands, self._command)
        return self._command
