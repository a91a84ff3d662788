"""How the body has to sway over the reference's footholds: a dynamics filter for the horizontal motion.

A retargeted reference is consistent as geometry, not as dynamics: over feet that stand wider than the animal's, the body
cannot help swaying further than the reference does. The whole robot moving exactly along the reference would need its
ground force at the zero-moment point z(t) (Vukobratović), which is seldom where the feet are. A horizontal shift δ(t) of the
body moves that point by δ − δ̈/ω², ω² = g / h (linear inverted pendulum; Kajita et al. 2003), so bringing it under the load-weighted
mean p(t) of the standing feet takes the only bounded solution of δ̈ = ω² (δ − (p − z)), the two-sided exponential average

    δ(t) = ω/2 ∫ e^(−ω|t−s|) (p(s) − z(s)) ds.

The controller tracks the reference plus a share of δ, so that feedback does not fight what physics does anyway.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from fastmimic.conventions import GRAVITY
from fastmimic.motion.motion import Motion
from fastmimic.robot import Robot
from fastmimic.rotations import quat_rotate, quat_rotate_inverse, rotate_planar, yaw_from_quat

Array = NDArray[np.float64]

LOADING_TIME: Final = 0.05  # s in which a foot takes up its load after touch-down, and gives it up before take-off
_MEMORY: Final = 8.0  # the average reaches this many time constants 1/ω each way
_LEAST_LOAD: Final = 0.3  # share of the weight below which the zero-moment point says nothing (flight)


def pendulum_sway(motion: Motion, robot: Robot, acceleration: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
    """The shift δ of the body that brings the zero-moment point under the standing feet.

    Args:
        motion: the reference.
        robot: whose masses it moves.
        acceleration: the motion's linear (t, 3) and angular (t, 3), world, and joint accelerations (t, 12).

    Returns:
        δ, its velocity and acceleration, (t, 2) each, x and y in the reference's heading frame, m, m/s, m/s².
    """
    n, dt = motion.n_samples, motion.dt
    omega = np.sqrt(GRAVITY / float(np.mean(motion.root_pos_w[:, 2])))
    mismatch, known = _mismatch(motion, robot, acceleration)
    every = np.arange(n)
    known = np.flatnonzero(known)
    if not len(known):
        zero = np.zeros((n, 2))
        return zero, zero, zero
    yaw = yaw_from_quat(motion.root_quat_wxyz)
    local = rotate_planar(-yaw, mismatch)  # turns with the body, so that it repeats with the motion
    local = np.stack([np.interp(every, known, local[known, k]) for k in range(2)], axis=1)
    reach = int(np.ceil(_MEMORY / (omega * dt)))
    wide_yaw, wide = _extended(yaw, local, motion, reach)
    lags = np.arange(-reach, reach + 1) * dt
    kernel = np.exp(-omega * np.abs(lags))
    kernel /= kernel.sum()
    source = rotate_planar(wide_yaw, wide)
    shift = np.stack([_average(source[:, k], kernel) for k in range(2)], axis=1)  # (n + 2, 2)
    velocity = (shift[2:] - shift[:-2]) / (2 * dt)
    turn = -yaw
    inner = shift[1:-1]
    second = omega**2 * (inner - rotate_planar(yaw, local))
    return rotate_planar(turn, inner), rotate_planar(turn, velocity), rotate_planar(turn, second)


def _average(signal: Array, kernel: Array) -> Array:
    from scipy.signal import fftconvolve

    return fftconvolve(signal, kernel, mode="valid")


def _extended(yaw: Array, local: Array, motion: Motion, reach: int) -> tuple[Array, Array]:
    """Yaw and mismatch continued by `reach` + 1 samples each way: repeated if the motion is periodic, else held."""
    n = motion.n_samples
    index = np.arange(-reach - 1, n + reach + 1)
    if motion.cycle is None:
        index = np.clip(index, 0, n - 1)
        return yaw[index], local[index]
    return np.unwrap(yaw)[index % n] + (index // n) * _winding(yaw, motion), local[index % n]


def _winding(yaw: Array, motion: Motion) -> float:
    """Turn of one period along the way that the unwrapped yaw takes."""
    assert motion.cycle is not None
    travelled = np.unwrap(yaw)[-1] - yaw[0]
    cycle = float(motion.cycle[2])
    return cycle + 2 * np.pi * round((travelled - cycle) / (2 * np.pi))


def _mismatch(motion: Motion, robot: Robot, acceleration: tuple[Array, Array, Array]) -> tuple[Array, NDArray[np.bool_]]:
    """Support point minus zero-moment point, (t, 2) world, m, and where it is known: some foot stands, and bears load."""
    feet = motion.root_pos_w[:, None] + quat_rotate(motion.root_quat_wxyz[:, None], motion.foot_pos_b)
    load = np.stack([_load(c, motion) for c in motion.contact.T], axis=1)
    total = load.sum(axis=1)
    force, moment = _ground_wrench(motion, robot, acceleration)
    known = (total > 0) & (force[:, 2] > _LEAST_LOAD * robot.mass * GRAVITY)
    weights = load / np.where(total > 0, total, 1.0)[:, None]
    support = np.einsum("tl,tlk->tk", weights, feet[..., :2])
    vertical = np.where(known, force[:, 2], 1.0)
    zmp = np.stack([-moment[:, 1], moment[:, 0]], axis=1) / vertical[:, None]
    return support - zmp, known


def _ground_wrench(motion: Motion, robot: Robot, acceleration: tuple[Array, Array, Array]) -> tuple[Array, Array]:
    """Force and moment about the world's origin, (t, 3) each, that the ground must give for the motion as it stands."""
    import mujoco

    spec = robot.spec()
    spec.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT) | int(mujoco.mjtDisableBit.mjDSBL_LIMIT)
    spec.option.gravity = [0, 0, -GRAVITY]
    model = spec.compile()
    data = mujoco.MjData(model)
    joints = [model.joint(name).id for name in robot.joint_names]
    position, speed = model.jnt_qposadr[joints], model.jnt_dofadr[joints]
    linear, angular, joint = acceleration
    quat = motion.root_quat_wxyz
    turning_b, angular_b = quat_rotate_inverse(quat, motion.root_ang_vel_w), quat_rotate_inverse(quat, angular)
    wrench = np.empty((motion.n_samples, 6))
    for i in range(motion.n_samples):
        data.qpos[:3], data.qpos[3:7], data.qpos[position] = motion.root_pos_w[i], quat[i], motion.joint_pos[i]
        data.qvel[:3], data.qvel[3:6], data.qvel[speed] = motion.root_lin_vel_w[i], turning_b[i], motion.joint_vel[i]
        data.qacc[:3], data.qacc[3:6], data.qacc[speed] = linear[i], angular_b[i], joint[i]
        mujoco.mj_inverse(model, data)
        wrench[i] = data.qfrc_inverse[:6]
    force, moment_base = wrench[:, :3], quat_rotate(quat, wrench[:, 3:])
    return force, moment_base + np.cross(motion.root_pos_w, force)


def _load(contact: NDArray[np.bool_], motion: Motion) -> Array:
    """Share of a foot's load (t,): up within `LOADING_TIME` of touch-down, down again before take-off."""
    if contact.all():
        return np.ones(len(contact))
    n = len(contact)
    before, after = (contact, contact) if motion.cycle is not None else (np.full(n, contact[0]), np.full(n, contact[-1]))
    c = np.concatenate([before, contact, after])
    index = np.arange(3 * n)
    since = index - np.maximum.accumulate(np.where(c, -1, index))
    until = np.minimum.accumulate(np.where(c, 3 * n, index)[::-1])[::-1] - index
    steps = np.minimum(since, until) * c
    return np.clip(steps * motion.dt / LOADING_TIME, 0.0, 1.0)[n : 2 * n]
