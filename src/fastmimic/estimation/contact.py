"""Which feet stand, and under what load: by joint torques, to which foot sensors add once they prove right.

What a leg's motors give beyond what moves the leg comes from the ground, Jᵀ f = τ(q, q̇, q̈, ω, a) − τ. With q̈ the lead
of the joint speeds over their own lag and τ lagging as much, this is the residual of a momentum observer whose gain is
the inverse of that lag (De Luca et al. 2006), but for the change of the leg's inertia meanwhile, which is negligible.

On a leg in mid-swing nothing pushes. What is left there, r = α q̈ + β q̇, is learnt by least squares: friction, rotors,
and that a motor's torque changes between two readings. From a foot's load, the schedule and the foot's height follow
the log-odds of contact (after Bledt et al. 2018, Contact model fusion).
"""

from typing import Any, Final

import numpy as np

from fastmimic.base.jit import floats, inlined, integers
from fastmimic.base.vectors import copy
from fastmimic.robot.dynamics import cross, leg_inverse_dynamics
from fastmimic.robot.kinematics import leg_jacobian

FUSED, SENSORS = 0, 2  # indices of the choices of `EstimatorConfig.foot_force`
_AIRBORNE: Final = 0.005  # m; a leg teaches above this height only
_LEAST_HEIGHT, _MOST_HEIGHT = -0.005, 0.03  # m; beyond, height tells no more
_MARGIN: Final = 0.25  # hysteresis of the log-odds
_SETTLED: Final = 4.0  # lags after which a change of torque has passed
_STANCE_SHARE: Final = 0.5  # of what a leg in mid-swing teaches; a standing leg's motors are softer
_SINGULAR: Final = 1e-4  # m³; least determinant of a leg's Jacobian: a straight leg's torques do not tell its load
_PRIOR: Final = np.array([1e4, 0.0, 10.0])  # for α = β = 0: sums of q̈², q̈ q̇ and q̇²
_LEARNT: Final = 10.0  # times the prior; before, the loads of swinging legs are not believed
_MOST_NOISE: Final = 9.0  # a squared load in mid-swing counts at most as this many times the mean so far
_TOUCHES: Final = 0.1  # N; told of a foot that touches the ground but bears next to nothing
_LEAST_SENSOR_NOISE: Final = 0.25  # squared, of a believed sensor, as a share of the torques'
_KEEP, _DROP = 0.7, 0.5  # squared correlation at which a foot sensor is believed, and no more

CONTACT_STATE: Final = [
    *floats(tare=4, filtered=4, force=4, swing_time=4, stance_time=4, unloaded_time=4),
    *integers(loaded=4, believed=4),
    *floats(lagged_speed=12, lagged_torque=12, swing_sums=3, swing_products=2, swing_fit=2, swinging=4),
    *floats(load=4, noise=4, moments=(4, 5)),
]
"""By foot: the sensor's offset in swing, its smoothed reading and the load that is told, N; how long it has swung, has
borne the estimate and has been without load, s; whether it is loaded, and its sensor believed. By joint, speed and
torque that lag. Of the fit in mid-swing: the sums of q̈², q̈ q̇ and q̇², and of q̈ r and q̇ r; (α, β), and its present share
by leg. By foot: the load by torques, N, and its mean square in mid-swing, N²; of load and sensor, the means, variances
and covariance."""

CONTACT_SCRATCH: Final = floats(residual=(4, 3), rate=(4, 3))
"""By leg: what its torques have too much, N·m, and its joints' accelerations, rad/s²."""


@inlined
def begin_contact(config: Any, state: Any, reading: Any, planned: Any) -> None:
    """Starts at the first readings, with the feet loaded that are planned to stand, (4,); what is not set here is 0."""
    copy(reading.joint_vel, state.lagged_speed)
    copy(reading.torque, state.lagged_torque)
    copy(reading.foot_force, state.filtered)
    copy(_PRIOR, state.swing_sums)
    for leg in range(4):
        state.loaded[leg], state.force[leg] = planned[leg], 0.25 * config.weight * planned[leg]
        if config.foot_force == SENSORS:
            state.loaded[leg] = 1 if reading.foot_force[leg] > config.contact_force else 0
            state.force[leg] = reading.foot_force[leg] * state.loaded[leg]
        # the first readings may be from before the motors were switched on
        state.unloaded_time[leg] = -config.latency - _SETTLED * config.torque_time
        state.noise[leg] = config.load_noise * config.load_noise
        state.moments[leg, 0], state.moments[leg, 1] = 0.25 * config.weight, reading.foot_force[leg]


@inlined
def feel_ground(config: Any, model: Any, state: Any, reading: Any, scratch: Any) -> None:
    """Vertical loads by joint torques, into `state.load` (4,). `model` is a record of `MODEL`."""
    fit = state.swing_fit
    for leg in range(4):
        first, residual, rate = 3 * leg, scratch.residual[leg], scratch.rate[leg]
        q, dq = reading.joint_pos[first : first + 3], reading.joint_vel[first : first + 3]
        speed, torque = state.lagged_speed[first : first + 3], state.lagged_torque[first : first + 3]
        for i in range(3):
            rate[i] = (dq[i] - speed[i]) / (config.torque_time + config.dt)
            speed[i] += config.torque_gain * (dq[i] - speed[i])
            torque[i] += config.torque_gain * (reading.torque[first + i] - torque[i])
        leg_inverse_dynamics(model, leg, q, dq, rate, reading.gyro, reading.accel, residual)
        share = 1.0 if state.swing_time[leg] > 0.0 else _STANCE_SHARE
        state.swinging[leg] += config.swing_gain * (share - state.swinging[leg])
        for i in range(3):
            residual[i] += model.armature[first + i] * rate[i] + model.joint_damping[first + i] * dq[i] - torque[i]
            residual[i] -= state.swinging[leg] * (fit[0] * rate[i] + fit[1] * speed[i])
        leg_jacobian(config.geometry[leg], q[0], q[1], q[2], scratch.jacobian)
        state.load[leg] = _vertical(scratch.jacobian, scratch.rotation[2], residual)


@inlined
def _vertical(j: Any, up: Any, residual: Any) -> float:
    """The component along `up` (3,), body frame, of the force f with Jᵀ f = `residual` (3,)."""
    total = det = 0.0
    for i in range(3):
        b, c = (i + 1) % 3, (i + 2) % 3
        x, y, z = cross(j[0, b], j[1, b], j[2, b], j[0, c], j[1, c], j[2, c])
        total += residual[i] * (up[0] * x + up[1] * y + up[2] * z)
        det = j[0, i] * x + j[1, i] * y + j[2, i] * z
    return total * np.sign(det) / max(abs(det), _SINGULAR)


@inlined
def _learn_swing(config: Any, state: Any, scratch: Any, leg: int) -> None:
    """Learns from a leg in mid-swing what its torques have too much, and how noisy its loads are."""
    sums, products, fit = state.swing_sums, state.swing_products, state.swing_fit
    for k in range(3):
        sums[k] -= config.learn_gain * (sums[k] - _PRIOR[k])
    for k in range(2):
        products[k] -= config.learn_gain * products[k]
    for i in range(3):
        rate, speed = scratch.rate[leg, i], state.lagged_speed[3 * leg + i]
        left = scratch.residual[leg, i] + state.swinging[leg] * (fit[0] * rate + fit[1] * speed)
        sums[0] += rate * rate
        sums[1] += rate * speed
        sums[2] += speed * speed
        products[0] += rate * left
        products[1] += speed * left
    before, least = state.noise[leg], config.load_noise * config.load_noise
    square = min(state.load[leg] * state.load[leg], _MOST_NOISE * before)  # a push hardly counts
    state.noise[leg] = max(before + config.tare_gain * (square - before), least)


@inlined
def solve_swing(state: Any) -> None:
    """The least squares (α, β) of what the legs in mid-swing have taught."""
    sums, products, fit = state.swing_sums, state.swing_products, state.swing_fit
    det = sums[0] * sums[2] - sums[1] * sums[1]
    fit[0] = (sums[2] * products[0] - sums[1] * products[1]) / det
    fit[1] = (sums[0] * products[1] - sums[1] * products[0]) / det


@inlined
def _judge_sensor(config: Any, state: Any, leg: int) -> None:
    """Compares a foot's sensor with the load by torques, whose sum is the weight. It is believed when the load has
    changed much (the foot was lifted and stood) and the reading with it; its scale and offset are those of the
    regression line. While the robot stands still nothing is learnt."""
    if max(state.swing_time[0], state.swing_time[1], state.swing_time[2], state.swing_time[3]) == 0.0:
        return
    m, gain = state.moments[leg], config.learn_gain
    df, ds = state.load[leg] - m[0], state.filtered[leg] - m[1]
    m[0] += gain * df
    m[1] += gain * ds
    m[2] += gain * (df * df - m[2])
    m[3] += gain * (ds * ds - m[3])
    m[4] += gain * (df * ds - m[4])
    least = _DROP if state.believed[leg] == 1 else _KEEP
    changed = m[2] > config.contact_force * config.contact_force and m[4] > 0.0
    state.believed[leg] = 1 if changed and m[4] * m[4] > least * m[2] * m[3] else 0


@inlined
def _fuse_contact(config: Any, state: Any, leg: int, rate: Any, height: float, planned: bool) -> None:
    """One foot's contact from its load, its `height` over the ground, m, and whether it is scheduled to stand; `rate`
    (3,) are the joints' accelerations, rad/s²: what moves a leg in haste is no load, and its sensor is then told from
    it. Loads by torques and by a believed sensor count by the inverse of their squared errors."""
    hasty, usual = config.load_rate_noise * max(abs(rate[0]), abs(rate[1]), abs(rate[2])), state.noise[leg]
    load, noise = state.load[leg], usual + hasty * hasty
    if state.believed[leg] == 1:
        m = state.moments[leg]
        own = max(m[2] - m[4] * m[4] / m[3] - usual, _LEAST_SENSOR_NOISE * usual)  # the rest of what the line leaves
        share = noise / (noise + own)
        load += share * (m[0] + (state.filtered[leg] - m[1]) * m[2] / m[4] - load)
        noise = max(share * own, usual)
    noise = np.sqrt(noise)
    lifted = 0.0 < state.swing_time[leg] < config.latency + _SETTLED * config.torque_time
    if lifted or (not planned and state.swing_sums[0] < _LEARNT * _PRIOR[0]):
        load = 0.0  # what is felt is from before the leg was lifted, or what moves it
    odds = load / noise - config.load_odds + (config.schedule_odds if planned else -config.schedule_odds)
    odds -= min(max(height, _LEAST_HEIGHT), _MOST_HEIGHT) / config.height_scale
    state.unloaded_time[leg] = state.unloaded_time[leg] + config.dt if odds < -_MARGIN else 0.0
    if odds > _MARGIN:
        state.loaded[leg] = 1
    elif state.unloaded_time[leg] > (config.release_time if planned else 0.0):
        state.loaded[leg] = 0
    least = config.release_force if state.force[leg] > _TOUCHES else config.contact_force
    state.force[leg] = (load if load > least else _TOUCHES) * state.loaded[leg]


@inlined
def _trust_sensor(config: Any, state: Any, leg: int) -> None:
    """One foot's contact from its sensor alone, by hysteresis. The offset is learnt while the leg swings, as it cannot
    be told from a load otherwise."""
    load = state.filtered[leg] - state.tare[leg]
    if state.loaded[leg] == 1:
        if load < config.release_force:
            state.loaded[leg] = 0
    elif load > config.contact_force:
        state.loaded[leg] = 1
    if state.loaded[leg] == 0 and state.swing_time[leg] > config.tare_delay:
        state.tare[leg] += config.tare_gain * load
    state.force[leg] = max(load, 0.0) if state.loaded[leg] == 1 else 0.0


@inlined
def estimate_contact(config: Any, state: Any, reading: Any, scratch: Any, leg: int, planned: bool) -> None:
    """Advances one foot's contact by one control step; `planned` means scheduled stance. A foot bears the base's
    estimate if it is loaded in scheduled stance: a loaded foot in early swing is being pulled away."""
    state.swing_time[leg] = 0.0 if planned else state.swing_time[leg] + config.dt
    state.filtered[leg] += config.force_gain * (reading.foot_force[leg] - state.filtered[leg])
    if config.foot_force == SENSORS:
        _trust_sensor(config, state, leg)
    else:
        if config.foot_force == FUSED:
            _judge_sensor(config, state, leg)
        height = state.estimate[2, 0] + scratch.foot[leg, 2] - config.foot_radius
        if state.swing_time[leg] > config.tare_delay and height > _AIRBORNE:
            _learn_swing(config, state, scratch, leg)
        rising = state.estimate[2, 1] - scratch.velocity[leg, 2]
        _fuse_contact(config, state, leg, scratch.rate[leg], height + config.height_lead * rising, planned)
    bears = planned and state.force[leg] > _TOUCHES
    state.stance_time[leg] = state.stance_time[leg] + config.dt if bears else 0.0
