"""Simulated sensors: readings of an IMU, joint encoders and foot sensors from a robot's true state."""

from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from fastmimic.base.arrays import Array, Records
from fastmimic.base.configuration import pack, record_fields
from fastmimic.base.conventions import GRAVITY
from fastmimic.base.jit import floats, inlined, integers, kernel, record_dtype
from fastmimic.base.vectors import quat_to_matrix, transposed_times
from fastmimic.estimation.estimator import turn_by
from fastmimic.robot import Robot
from fastmimic.robot.dynamics import cross
from fastmimic.robot.state import COMMAND, READING
from fastmimic.simulation.conditions import Delay, World, make_world
from fastmimic.simulation.config import SensorConfig

_BLOCK: Final = 128  # control steps for which noise is drawn at once


_ERRORS: Final = record_dtype(
    [
        *integers(tick=()),
        *floats(gyro_bias=3, accel_bias=3, attitude=3, joint_offset=12, torque_gain=12, foot_gain=4, foot_offset=4),
        *floats(velocity=3, foot_scale=(), foot_constant=()),
    ]
)
"""One robot's lasting errors, with its foot sensors' unit, and its velocity at the last IMU reading. `attitude` is the
error of the IMU's orientation, a small rotation vector in the world frame."""

_NOISE: Final = record_dtype(
    [
        *floats(gyro=3, gyro_bias=3, accel=3, accel_bias=3, orientation=3, tilt=2),
        *floats(joint_pos=12, joint_vel=12, torque=12, foot=4, foot_offset=4),
    ]
)  # standard normal numbers for one control step of a robot

_DRAWN: Final = _NOISE.itemsize // 8

_CONFIG: Final = record_dtype(
    [*floats(dt=(), torque_limit=12), *integers(periods=3, delays=3), *record_fields(SensorConfig)]
)  # `periods` and `delays` are control steps between readings of IMU, joints and feet, and until they arrive


def _pack(config: SensorConfig, robot: Robot, rate_hz: float) -> Records:
    record = np.zeros(1, _CONFIG)
    pack(config, record)
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
    """Orientation, angular velocity, and mean specific force since the last reading in the orientation halfway, like an
    IMU that samples much faster and sums up."""
    quat_to_matrix(truth.root_quat, rotation)
    transposed_times(rotation, truth.ang_vel, out.gyro)
    span = c.dt * c.periods[0]
    for k in range(3):
        work[k] = (truth.lin_vel[k] - errors.velocity[k]) / span if errors.tick > 0 else 0.0
        errors.velocity[k] = truth.lin_vel[k]
    work[2] += GRAVITY
    transposed_times(rotation, work, out.accel)
    half, g, f = 0.5 * span if errors.tick > 0 else 0.0, out.gyro, out.accel
    turned = cross(g[0], g[1], g[2], f[0], f[1], f[2])
    for k in range(3):
        f[k] += half * turned[k] + errors.accel_bias[k] + c.accel_noise * noise.accel[k]
        g[k] += errors.gyro_bias[k] + c.gyro_noise * noise.gyro[k]
    # an attitude filter takes its vertical from the accelerometer: u × ε = b / g for the vertical u in the body frame
    b, u, e, s = errors.accel_bias, rotation[2], errors.attitude, c.orientation_noise
    out.quat = truth.root_quat
    x, y, z = cross(b[0], b[1], b[2], u[0], u[1], u[2])
    turn_by(out.quat, x / GRAVITY, y / GRAVITY, z / GRAVITY, True)
    turn_by(out.quat, s * noise.orientation[0], s * noise.orientation[1], s * noise.orientation[2], True)
    turn_by(out.quat, e[0], e[1], 0.0, False)
    turn_by(out.quat, 0.0, 0.0, e[2], False)


@inlined
def _measure_joints(c: Any, errors: Any, noise: Any, truth: Any, command: Any, out: Any) -> None:
    """Angles, speeds and the torques that the motors make of the command."""
    for j in range(12):
        q, dq = truth.joint_pos[j], truth.joint_vel[j]
        angle = q + errors.joint_offset[j] + c.joint_pos_noise * noise.joint_pos[j]
        out.joint_pos[j] = _rounded(angle, c.joint_pos_quantum)
        out.joint_vel[j] = _rounded(dq + c.joint_vel_noise * noise.joint_vel[j], c.joint_vel_quantum)
        torque = command.torque[j] + command.stiffness[j] * (command.joint_pos[j] - q)
        torque += command.damping[j] * (command.joint_vel[j] - dq)
        torque = min(max(torque, -c.torque_limit[j]), c.torque_limit[j])
        out.torque[j] = _rounded(torque * errors.torque_gain[j] + c.torque_noise * noise.torque[j], c.torque_quantum)


@inlined
def _drift(c: Any, errors: Any, noise: Any) -> None:
    """One control step of the lasting errors. The heading drifts with the errors of the IMU's gyro."""
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
    """Writes all measurements into a ring (n, depth) of readings; `outs` are those that have arrived by now."""
    c = config[0]
    depth = ring.shape[1]
    for i in range(truths.shape[0]):
        e, truth, noise = errors[i], truths[i], noises[i, at]
        ring[i, e.tick % depth] = ring[i, (e.tick + depth - 1) % depth]  # what is not measured now stays
        now = ring[i, e.tick % depth]
        if e.tick % c.periods[0] == 0:
            _measure_imu(c, e, noise, truth, now, work[:3], work[3])
        if e.tick % c.periods[1] == 0:
            _measure_joints(c, e, noise, truth, commands[i], now)
        if e.tick % c.periods[2] == 0:
            for leg in range(4):
                force = e.foot_gain[leg] * max(truth.foot_force[leg, 2], 0.0) + e.foot_offset[leg]
                force = e.foot_scale * (force + c.foot_noise * noise.foot[leg]) + e.foot_constant
                now.foot_force[leg] = _rounded(force, c.foot_quantum)
        out = outs[i]
        imu = ring[i, max(e.tick - c.delays[0], 0) % depth]
        joints = ring[i, max(e.tick - c.delays[1], 0) % depth]
        feet = ring[i, max(e.tick - c.delays[2], 0) % depth]
        out.quat, out.gyro, out.accel = imu.quat, imu.gyro, imu.accel
        out.joint_pos, out.joint_vel, out.torque = joints.joint_pos, joints.joint_vel, joints.torque
        out.foot_force = feet.foot_force
        _drift(c, e, noise)
        e.tick += 1


class Sensors:
    """Sensors of n robots, with noise of each one's own generator alone. `command` is what `to_motors` last made."""

    def __init__(self, robot: Robot, n: int, rate_hz: float, config: SensorConfig, world: World | None = None) -> None:
        """`world` has the delay of the motors' commands, and scale and offset of the foot sensors; None for neither."""
        self._world = world = world if world is not None else make_world((), n, "mujoco")
        self.config, self._config = config, _pack(config, robot, rate_hz)
        self._errors = np.zeros(n, _ERRORS)
        self._delay = Delay(world["delay"], rate_hz)
        self._ring = np.zeros((n, 1 + int(self._config["delays"].max())), READING)
        self._noise = np.zeros((n, _BLOCK), _NOISE)
        self._normals = self._noise.view(np.float64).reshape(n, _BLOCK, _DRAWN)
        self._generators: Sequence[np.random.Generator] = ()
        self._work = np.zeros((4, 3))
        self._step = 0
        self.command = np.zeros(n, COMMAND)
        self.reading = np.zeros(n, READING)

    def reset(self, generators: Sequence[np.random.Generator], truth: Records) -> Records:
        """Begins n episodes with one random stream each; `truth` is (n,) of `OBSERVATION`.

        Returns the first readings, (n,) of `READING`; overwritten by the next call.
        """
        assert len(generators) == len(self._errors)
        self._generators, self._step = generators, 0
        errors, config = self._errors, self.config
        errors[...] = np.zeros((), _ERRORS)
        errors["foot_scale"] = self._world["foot-force-scale"]
        errors["foot_constant"] = self._world["foot-force-offset"]
        for i, rng in enumerate(generators):
            errors["gyro_bias"][i] = config.gyro_bias * rng.standard_normal(3)
            errors["accel_bias"][i] = config.accel_bias * rng.standard_normal(3)
            errors["attitude"][i, :2] = config.tilt_error * rng.standard_normal(2)
            errors["joint_offset"][i] = config.joint_offset * rng.standard_normal(12)
            errors["torque_gain"][i] = 1.0 + config.torque_gain_error * rng.standard_normal(12)
            errors["foot_gain"][i] = 1.0 + config.foot_gain_error * rng.standard_normal(4)
            errors["foot_offset"][i] = config.foot_offset * rng.standard_normal(4)
        return self.measure(truth, np.zeros(len(errors), COMMAND))

    def measure(self, truth: Records, commands: Records) -> Records:
        """Readings (n,) of `READING` that have arrived at the end of a control step; overwritten by the next call.
        `truth` (n,) of `OBSERVATION` is the state at its end, `commands` (n,) of `COMMAND` are the motors'."""
        at = self._step % _BLOCK
        if at == 0:
            for rng, block in zip(self._generators, self._normals, strict=True):
                rng.standard_normal(out=block)
        self._delay.send(commands, self._step)
        motors = self._delay.arrived(self._step)
        self._step += 1
        _measure(self._config, self._errors, self._noise, truth, motors, self._ring, self.reading, at, self._work)
        return self.reading

    def to_motors(self, commands: Records) -> Records:
        """Commands (n,) of `COMMAND` as motors with encoder offsets take them: they close their position loops on what
        they measure. Overwritten by the next call."""
        self.command[...] = commands
        self.command["joint_pos"] -= self._errors["joint_offset"]
        return self.command
