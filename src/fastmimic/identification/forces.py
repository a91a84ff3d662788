"""Ground reaction forces and sliding of the feet from a log: leg statics and dynamics, no force sensor.

A leg's motors carry and accelerate it, and the ground does the rest: τ = τ_free(q, q̇, q̈) − Jᵀ f, so f = J⁻ᵀ (τ_free −
τ), in the body frame, with J of the point under the foot's sphere.
"""

from dataclasses import dataclass
from typing import Final

import mujoco
import numpy as np
from scipy.signal import savgol_filter

from fastmimic.base.arrays import Array, Flags
from fastmimic.base.conventions import GRAVITY
from fastmimic.base.errors import LogError
from fastmimic.base.rotations import matrix_from_quat
from fastmimic.robot import Robot
from fastmimic.robot.dynamics import inverse_dynamics, leg_torques
from fastmimic.robot.kinematics import foot_jacobians, foot_positions
from fastmimic.robot.state import RunLog, commanded_torque

SMOOTHING_S: Final = 0.03  # window of the smoothing quadratic: short against a stance, long against the noise
LEAST_S: Final = 1.0  # shortest usable log
LOADED: Final = 0.1  # foot sensor in contact, multiples of the weight (as the estimator's)
UPRIGHT: Final = 0.7  # least cosine of the trunk's tilt: after a fall, feet tell nothing
START_S: Final = 0.3  # left out at the beginning, while the robot finds its gait


@dataclass(frozen=True, eq=False)
class GroundForces:
    """Forces and speeds of the feet over t control steps, in the frame of the ground (z normal to it)."""

    dt: float  # control step, s
    arm: Array  # (t, 4, 3, 3) J⁻ᵀ: force by joint torque, 1/m
    torque: Array  # (t, 4, 3) by the motors, N·m
    free: Array  # (t, 4, 3) torque of the legs alone, N·m
    velocity: Array  # (t, 4, 2) of the points under the feet along the ground, m/s
    sensed: Array  # (t, 4) the foot sensors without their offsets, N
    loaded: Flags  # (t, 4) touches the ground by its sensor
    settled_s: Array  # (t, 4) time to the nearer end of that contact, or of its absence, s
    usable: Flags  # (t,) upright and past the start
    need: Array  # (t,) vertical force that the robot without payload needs, N
    lift: Array  # (t,) vertical acceleration minus gravity's, which a payload on the trunk would share, m/s²

    def force(self, gain: Array | float = 1.0) -> Array:
        """(t, 4, 3) ground reaction force on each foot, N; `gain` (4, 3) is true over measured motor torque."""
        return np.asarray(np.einsum("tlij,tlj->tli", self.arm, self.free - self.torque * gain))


def ground_forces(log: RunLog, robot: Robot) -> GroundForces:
    """Forces and speeds of the feet in a log; raises `LogError` for another robot's, too short or not finite ones."""
    if log.robot != robot.name:
        raise LogError(f"the log is of robot '{log.robot}', not of '{robot.name}'; give --robot {log.robot}")
    if log.duration_s < LEAST_S:
        raise LogError(f"the log is {log.duration_s:.2f} s long; at least {LEAST_S:g} s are needed")
    for record in (log.reading, log.command, log.estimate):
        for name in record.dtype.names or ():
            if not np.isfinite(record[name]).all():
                raise LogError(f"the log's '{name}' is not always finite; identify from another deployment")
    dt, late, reading = 1.0 / log.rate_hz, round(log.latency_s * log.rate_hz), log.reading

    window = 2 * round(0.5 * SMOOTHING_S / dt) + 1

    def smooth(x: Array, derivative: int = 0) -> Array:
        return np.asarray(savgol_filter(x, window, 2, deriv=derivative, delta=dt, axis=0))

    q, dq, ddq = (smooth(reading[f], d) for f, d in (("joint_pos", 0), ("joint_vel", 0), ("joint_vel", 1)))
    gyro, turning, accel = smooth(reading["gyro"]), smooth(reading["gyro"], 1), smooth(reading["accel"])
    rotation = matrix_from_quat(_delayed(log.estimate["root_quat"], late))
    velocity = _delayed(log.estimate["lin_vel"], late)

    t = len(reading)
    jacobian, point = _contact_points(robot, q, rotation[:, 2])
    arm_b = np.linalg.inv(np.swapaxes(jacobian, -1, -2))
    foot_b = np.einsum("tlij,tlj->tli", jacobian, dq.reshape(t, 4, 3)) + np.cross(gyro[:, None], point)
    foot = velocity[:, None] + np.einsum("tij,tlj->tli", rotation, foot_b)
    sensed = _sensed(log)
    loaded = sensed > LOADED * robot.mass * GRAVITY
    usable = (rotation[:, 2, 2] > UPRIGHT) & (np.arange(t) * dt >= START_S)
    usable &= np.cumsum(rotation[:, 2, 2] <= UPRIGHT) == 0
    return GroundForces(
        dt=dt,
        arm=np.einsum("tij,tljk->tlik", rotation, arm_b),
        torque=smooth(_mean_torque(log, robot, late)).reshape(t, 4, 3),
        free=leg_torques(robot, q, dq, ddq, gyro, accel).reshape(t, 4, 3),
        velocity=foot[..., :2],
        sensed=sensed,
        loaded=loaded,
        settled_s=_settled(loaded) * dt,
        usable=usable,
        need=_vertical_need(robot, rotation, q, dq, ddq, gyro, turning, accel),
        lift=np.einsum("ti,ti->t", rotation[:, 2], accel),
    )


def _delayed(x: Array, steps: int) -> Array:
    """Rows `steps` earlier: estimates are for now, readings are older."""
    return np.concatenate([np.repeat(x[:1], steps, axis=0), x[: len(x) - steps]]) if steps else x


def _mean_torque(log: RunLog, robot: Robot, late: int) -> Array:
    """(t, 12) mean motor torque over each control step. While a command holds, the motor law lets the torque fall off;
    a reading is that at the step's end. Half of the law's change between the readings at both ends is added."""
    command, q, dq = log.command, log.reading["joint_pos"], log.reading["joint_vel"]
    sent = {name: _delayed(command[name], late) for name in command.dtype.names or ()}

    def law(q: Array, dq: Array) -> Array:
        return np.clip(commanded_torque(sent, q, dq), -robot.torque_limit, robot.torque_limit)

    return np.asarray(log.reading["torque"] + 0.5 * (law(_delayed(q, 1), _delayed(dq, 1)) - law(q, dq)))


def _contact_points(robot: Robot, q: Array, up_b: Array) -> tuple[Array, Array]:
    """Jacobians (t, 4, 3, 3) and places (t, 4, 3), body frame, of the contact points under the feet's spheres, which
    turn with the calves; `up_b` (t, 3) is the ground's normal."""
    jacobian, below = foot_jacobians(robot, q), -robot.foot_radius * up_b
    roll = q.reshape(-1, 4, 3)[..., 0]
    zero = np.zeros_like(roll)
    forward = np.stack([zero + 1.0, zero, zero], axis=-1)
    across = np.stack([zero, np.cos(roll), np.sin(roll)], axis=-1)
    for j, axis in enumerate((forward, across, across)):
        jacobian[..., j] += np.cross(axis, below[:, None])
    return jacobian, foot_positions(robot, q) + below[:, None]


def _sensed(log: RunLog) -> Array:
    """(t, 4) foot sensors less their offsets, taken where the leg swings; N."""
    sensed = np.array(log.reading["foot_force"])
    for leg in range(4):
        swings = ~log.stance[:, leg]
        if swings.any():
            sensed[:, leg] -= np.median(sensed[swings, leg])
    return sensed


def _settled(on: Flags) -> Array:
    """(t, 4) samples to the nearer change of each column."""
    t = np.arange(len(on))[:, None]
    change = np.diff(on, axis=0, prepend=~on[:1])
    before = t - np.maximum.accumulate(np.where(change, t, 0), axis=0)
    last = np.diff(on, axis=0, append=~on[-1:])
    after = np.minimum.accumulate(np.where(last, t, len(on))[::-1], axis=0)[::-1] - t
    return np.asarray(np.minimum(before, after), dtype=np.float64)


def _vertical_need(
    robot: Robot, rotation: Array, q: Array, dq: Array, ddq: Array, gyro: Array, turning: Array, accel: Array
) -> Array:
    """(t,) vertical ground reaction force of the unloaded robot in the logged motion, by inverse dynamics, N."""
    position = np.zeros((len(q), 19))
    position[:, :3], position[:, 7:] = robot.model().qpos0[:3], q
    for row, frame in zip(position, rotation, strict=True):
        mujoco.mju_mat2Quat(row[3:7], frame.ravel())
    linear = np.array([frame @ sensed for frame, sensed in zip(rotation, accel, strict=True)])
    linear[:, 2] -= GRAVITY
    velocity = np.hstack([np.zeros_like(gyro), gyro, dq])
    return inverse_dynamics(robot, position, velocity, np.hstack([linear, turning, ddq]))[0][:, 2]
