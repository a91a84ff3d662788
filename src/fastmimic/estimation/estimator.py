"""The estimator: from readings to what the controller is told, all robots in one compiled call."""

import math
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from fastmimic.base.arrays import Array, Records
from fastmimic.base.conventions import GRAVITY
from fastmimic.base.jit import floats, inlined, kernel, record_dtype
from fastmimic.base.vectors import copy, heading_of, quat_to_matrix, times, turned
from fastmimic.estimation.config import EstimatorConfig, pack_config
from fastmimic.estimation.contact import (
    CONTACT_SCRATCH,
    CONTACT_STATE,
    FUSED,
    SENSORS,
    begin_contact,
    estimate_contact,
    feel_ground,
    solve_swing,
)
from fastmimic.estimation.kalman import (
    STATES,
    anchor,
    predict,
    surprise,
    update_height,
    update_position,
    update_velocity,
)
from fastmimic.robot import Robot
from fastmimic.robot.dynamics import cross
from fastmimic.robot.kinematics import leg_forward, leg_jacobian
from fastmimic.robot.state import OBSERVATION, pack_model

START_VELOCITY_NOISE: Final = 0.1  # m/s
START_HEIGHT_NOISE: Final = 0.01  # m

START: Final = record_dtype(floats(position=2, heading=(), velocity=3))
"""Known start of a robot: x, y, heading and velocity of its base, world frame, m, rad and m/s."""

STATE: Final = record_dtype(
    [
        *floats(quat=4, heading=(), ground=2, ground_time=(), estimate=(3, STATES), cov=(2, STATES, STATES), slow=15),
        *CONTACT_STATE,
    ]
)
"""The estimator's state of one robot: orientation by the IMU, and the heading of its world in ours; the small rotation
about x and y from its level frame to the ground's, and the present time constant of learning it; by axis of the
ground's frame, the estimate of (p, v, four feet), with its covariance for x and y and for z; gyro and joint speeds,
smoothed; and what `CONTACT_STATE` holds of the feet."""

SCRATCH: Final = record_dtype(
    [
        *floats(rotation=(3, 3), jacobian=(3, 3), accel=3, foot=(4, 3), roll=(4, 3), velocity=(4, 3)),
        *floats(work=(2, STATES), quat=4),
        *CONTACT_SCRATCH,
    ]
)
"""Work memory of the kernels, one record per thread. In the world: the base's `accel` without gravity, the feet from
the base, the velocities of their centres where they `roll`, and that of the base by each leg."""


@inlined
def turn_by(q: Array, x: float, y: float, z: float, local: bool) -> None:
    """Turns the quaternion (4,) by the rotation vector (x, y, z), given in the body frame (`local`) or the world."""
    angle = np.sqrt(x * x + y * y + z * z)
    factor = 0.5 if angle < 1e-9 else np.sin(0.5 * angle) / angle
    a, b, c, d = np.cos(0.5 * angle), factor * x, factor * y, factor * z
    w, i, j, k = q[0], q[1], q[2], q[3]
    sign = 1.0 if local else -1.0
    q[0] = w * a - i * b - j * c - k * d
    q[1] = w * b + i * a + sign * (j * d - k * c)
    q[2] = w * c + j * a + sign * (k * b - i * d)
    q[3] = w * d + k * a + sign * (i * c - j * b)
    norm = np.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    for m in range(4):
        q[m] /= norm


@inlined
def _follow_orientation(config: Any, state: Any, reading: Any, measured: Array) -> None:
    """Integrates the gyro and slowly follows the noisy IMU orientation; `measured` (4,) is scratch."""
    g, dt = reading.gyro, config.dt
    turn_by(state.quat, g[0] * dt, g[1] * dt, g[2] * dt, True)
    copy(reading.quat, measured)
    turn_by(measured, 0.0, 0.0, state.heading, False)
    q, m = state.quat, measured
    # measured ⊗ q⁻¹, world
    w = m[0] * q[0] + m[1] * q[1] + m[2] * q[2] + m[3] * q[3]
    x = -m[0] * q[1] + m[1] * q[0] - m[2] * q[3] + m[3] * q[2]
    y = -m[0] * q[2] + m[2] * q[0] - m[3] * q[1] + m[1] * q[3]
    z = -m[0] * q[3] + m[3] * q[0] - m[1] * q[2] + m[2] * q[1]
    if w < 0.0:
        w, x, y, z = -w, -x, -y, -z
    sine = np.sqrt(x * x + y * y + z * z)
    factor = 2.0 if sine < 1e-9 else 2.0 * np.arctan2(sine, w) / sine
    factor *= config.orientation_gain
    turn_by(q, factor * x, factor * y, factor * z, False)


@inlined
def _sense_legs(config: Any, reading: Any, scratch: Any) -> None:
    """Feet, their velocities if they roll, and the base velocity that follows; all in the world frame."""
    rotation, jacobian, g = scratch.rotation, scratch.jacobian, reading.gyro
    for leg in range(4):
        geometry, j = config.geometry[leg], 3 * leg
        q, dq = reading.joint_pos[j : j + 3], reading.joint_vel[j : j + 3]
        x, y, z = leg_forward(geometry, q[0], q[1], q[2])
        leg_jacobian(geometry, q[0], q[1], q[2], jacobian)
        vx, vy, vz = cross(g[0], g[1], g[2], x, y, z)
        for i in range(3):
            vx += jacobian[0, i] * dq[i]
            vy += jacobian[1, i] * dq[i]
            vz += jacobian[2, i] * dq[i]
        # the calf's angular velocity turns the sphere over its contact point
        pitching = dq[1] + dq[2]
        wx, wy, wz = g[0] + dq[0], g[1] + pitching * np.cos(q[0]), g[2] + pitching * np.sin(q[0])
        turn_x, turn_y, _ = turned(rotation, wx, wy, wz)
        scratch.roll[leg, 0], scratch.roll[leg, 1] = config.foot_radius * turn_y, -config.foot_radius * turn_x
        scratch.roll[leg, 2] = 0.0
        for k in range(3):
            scratch.foot[leg, k] = rotation[k, 0] * x + rotation[k, 1] * y + rotation[k, 2] * z
            moving = rotation[k, 0] * vx + rotation[k, 1] * vy + rotation[k, 2] * vz
            scratch.velocity[leg, k] = scratch.roll[leg, k] - moving


@inlined
def _sense(config: Any, state: Any, reading: Any, scratch: Any) -> None:
    """All readings, in the frame of the ground."""
    quat_to_matrix(state.quat, scratch.rotation)
    # the level acceleration is the mean over a step, so the orientation is that of its middle
    half, g, f = -0.5 * config.dt, reading.gyro, reading.accel
    tx, ty, tz = cross(half * g[0], half * g[1], half * g[2], f[0], f[1], f[2])
    x, y, z = turned(scratch.rotation, f[0] + tx, f[1] + ty, f[2] + tz)
    gx, gy, a = state.ground[0], state.ground[1], scratch.accel
    a[0], a[1], a[2] = x, y, z - GRAVITY
    scratch.quat = state.quat
    turn_by(scratch.quat, gx, gy, 0.0, False)
    quat_to_matrix(scratch.quat, scratch.rotation)
    a[0], a[1], a[2] = a[0] + gy * a[2], a[1] - gx * a[2], a[2] + gx * a[1] - gy * a[0]
    _sense_legs(config, reading, scratch)


@inlined
def _lean_on_ground(config: Any, state: Any, scratch: Any) -> None:
    """Turns the frame into the plane of the standing feet, by their kinematic heights above it (normalised LMS). While
    a rotation (e_x, e_y) is missing, feet at (x, y) from the base seem higher by e_y x − e_x y."""
    x = y = total = 0.0
    standing = 0
    for leg in range(4):
        if state.stance_time[leg] > config.settle_time:
            foot = scratch.foot[leg]
            above = state.estimate[2, 0] + foot[2] - config.foot_radius
            x -= above * foot[1]
            y += above * foot[0]
            total += foot[0] * foot[0] + foot[1] * foot[1]
            standing += 1
    if standing > 1:
        gain = config.dt / state.ground_time
        state.ground[0] += gain * x / total
        state.ground[1] += gain * y / total
        state.ground_time = min(state.ground_time + config.dt, config.ground_time)


@inlined
def _take_in_leg(config: Any, state: Any, scratch: Any, leg: int) -> None:
    """Corrects the base by a foot that bears the estimate."""
    mean, cov, work = state.estimate, state.cov, scratch.work
    settled = min(state.stance_time[leg] / config.settle_time, 1.0) if config.settle_time > 0 else 1.0
    weight = 1.0 / (settled * settled)
    velocity_var = config.velocity_var * weight
    excess = surprise(mean, cov, scratch.velocity[leg], velocity_var) / config.gate_sq
    if excess > 1.0:
        anchor(mean, cov, leg, scratch.foot[leg], config.position_var)
        velocity_var *= excess * excess
    update_position(mean, cov, leg, scratch.foot[leg], config.position_var * weight, work)
    update_velocity(mean, cov, scratch.velocity[leg], velocity_var, work)
    update_height(mean, cov, leg, config.foot_radius, config.height_var * weight, work)


@inlined
def _rate_of_change(config: Any, state: Any, i: int, value: float) -> float:
    """Rate of change of an angular velocity or joint speed, by its lead over its own first-order lag."""
    ahead = value - state.slow[i]
    state.slow[i] += config.dt / (config.dt + config.rate_time) * ahead
    return ahead / config.rate_time


@inlined
def _tell(config: Any, state: Any, reading: Any, scratch: Any, out: Any) -> None:
    """The present state, `latency` after the readings were taken."""
    t, g = config.latency, reading.gyro
    out.root_quat = scratch.quat
    q = out.root_quat
    turn_by(q, g[0] * t, g[1] * t, g[2] * t, True)
    for k in range(3):
        out.root_pos[k] = state.estimate[k, 0] + t * (state.estimate[k, 1] + 0.5 * t * scratch.accel[k])
        out.lin_vel[k] = state.estimate[k, 1] + t * scratch.accel[k]
    quat_to_matrix(q, scratch.rotation)
    turning = scratch.work[0, :3]
    for k in range(3):
        turning[k] = g[k] + t * _rate_of_change(config, state, k, g[k])
    times(scratch.rotation, turning, out.ang_vel)
    for j in range(12):
        speed = reading.joint_vel[j]
        rate = _rate_of_change(config, state, 3 + j, speed)
        out.joint_vel[j] = speed + t * rate
        out.joint_pos[j] = reading.joint_pos[j] + t * (speed + 0.5 * t * rate)
    for leg in range(4):
        out.foot_force[leg, 0], out.foot_force[leg, 1] = 0.0, 0.0
        out.foot_force[leg, 2] = state.force[leg]
    out.other_contact = 0.0


@kernel
def estimate_step(
    config: Any, models: Any, states: Any, readings: Any, planned: Any, outs: Any, scratches: Any
) -> None:
    """Takes in the readings of all robots and writes what their controllers are told. (1,) records: `config`, `models`,
    `scratches`. (n,) records: `states` of `STATE`, `readings` of `READING`, `outs` of `OBSERVATION`. `planned` (n, 4):
    whether the controller lets each leg stand."""
    c, scratch = config[0], scratches[0]
    for i in range(states.shape[0]):
        state, reading = states[i], readings[i]
        _follow_orientation(c, state, reading, scratch.quat)
        _sense(c, state, reading, scratch)
        predict(state.estimate, state.cov, scratch.accel, scratch.roll, c.accel_var, c.foot_var, c.dt)
        if c.foot_force != SENSORS:
            feel_ground(c, models[0], state, reading, scratch)
        for leg in range(4):
            stood = state.stance_time[leg] > 0.0
            estimate_contact(c, state, reading, scratch, leg, planned[i, leg] == 1)
            if not stood:
                anchor(state.estimate, state.cov, leg, scratch.foot[leg], c.position_var)
        solve_swing(state)
        for leg in range(4):
            if state.stance_time[leg] > 0.0:
                _take_in_leg(c, state, scratch, leg)
        _lean_on_ground(c, state, scratch)
        _tell(c, state, reading, scratch, outs[i])


@kernel
def begin(config: Any, states: Any, readings: Any, starts: Any, planned: Any, outs: Any, scratches: Any) -> None:
    """Starts the estimates of all robots, all 0, from `starts` (n,) of `START`; the rest as in `estimate_step`."""
    c, scratch = config[0], scratches[0]
    for i in range(states.shape[0]):
        state, reading, start = states[i], readings[i], starts[i]
        state.heading = start.heading - heading_of(reading.quat)
        state.quat = reading.quat
        turn_by(state.quat, 0.0, 0.0, state.heading, False)
        state.ground_time = min(c.ground_start, c.ground_time)
        _sense(c, state, reading, scratch)
        copy(reading.gyro, state.slow[:3])
        copy(reading.joint_vel, state.slow[3:])
        lowest = np.inf
        for leg in range(4):
            lowest = min(lowest, scratch.foot[leg, 2])
        for k in range(2):
            state.estimate[k, 0] = start.position[k]
            state.cov[k, 1, 1] = START_VELOCITY_NOISE * START_VELOCITY_NOISE
        state.estimate[2, 0] = c.foot_radius - lowest
        state.cov[1, 0, 0] = START_HEIGHT_NOISE * START_HEIGHT_NOISE
        copy(start.velocity, state.estimate[:, 1])
        begin_contact(c, state, reading, planned[i])
        for leg in range(4):
            anchor(state.estimate, state.cov, leg, scratch.foot[leg], c.position_var)
            if planned[i, leg] == 1 and state.loaded[leg] == 1:
                update_velocity(state.estimate, state.cov, scratch.velocity[leg], c.velocity_var, scratch.work)
        for k in range(3):
            state.estimate[k, 0] -= c.latency * state.estimate[k, 1]
        _tell(c, state, reading, scratch, outs[i])


class Estimator:
    """Estimates of n robots. Not to be shared between threads: it owns the kernels' work arrays."""

    def __init__(self, robot: Robot, n: int, rate_hz: float, config: EstimatorConfig | None = None) -> None:
        self.config = config if config is not None else EstimatorConfig()
        self.state = np.zeros(n, STATE)
        self.observation = np.zeros(n, OBSERVATION)
        self._config, self._model = pack_config(self.config, robot, rate_hz), pack_model(robot)
        self._scratch = np.zeros(1, SCRATCH)

    @property
    def believed(self) -> NDArray[np.bool_]:
        """(n, 4): whose foot sensors count at present."""
        mode = int(self._config["foot_force"][0])
        return self.state["believed"] == 1 if mode == FUSED else np.full((len(self.state), 4), mode == SENSORS)

    @property
    def load(self) -> float:
        """What all legs of the first robot bear by their torques, N; NaN if only foot sensors count."""
        felt = int(self._config["foot_force"][0]) != SENSORS
        return float(self.state["load"][0].sum()) if felt else math.nan

    @property
    def ground(self) -> Array:
        """(2,): rotation of the first robot's ground from level, about x and y, rad."""
        return np.asarray(self.state["ground"][0])

    def reset(self, readings: Records, starts: Records, planned: NDArray[np.int64]) -> Records:
        """Starts at known places, from the first readings, at rest or in motion; arguments and result as in `step`.
        Height comes from the lowest foot, roll and pitch from the IMU; standing legs correct the velocity. `starts` is
        (n,) of `START`."""
        self.state[...] = np.zeros((), STATE)
        begin(self._config, self.state, readings, starts, planned, self.observation, self._scratch)
        return self.observation

    def step(self, readings: Records, planned: NDArray[np.int64]) -> Records:
        """The present estimate, (n,) of `OBSERVATION`, from the readings of one control step; overwritten by the next
        call. `readings` is (n,) of `READING`, `planned` (n, 4) whether the controller lets each leg stand. The base's
        pose and velocity are in the frame of the ground; foot forces are vertical, 0 where a foot does not touch."""
        estimate_step(self._config, self._model, self.state, readings, planned, self.observation, self._scratch)
        return self.observation
