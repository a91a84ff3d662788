"""How the body has to sway over the reference's footholds: a dynamics filter for the horizontal motion.

A retargeted reference is consistent as geometry, not as dynamics: over feet that stand wider than the animal's, the
body cannot help swaying further than the reference does. The whole robot moving exactly along the reference would
need its ground force at the zero-moment point z(t) (Vukobratović), which is seldom where the feet are. A small
horizontal shift δ(t) of the body moves that point by δ − δ̈/ω², ω² = f_z / (m h) with the vertical force f_z and
the height h of the centre of mass (linear inverted pendulum with a varying stiffness; Kajita et al. 2003). Bringing
it under the load-weighted mean p(t) of the standing feet takes the bounded solution of

    δ̈ = ω(t)² (δ − (p − z)),

which in flight, where f_z = 0, is a straight line. The controller tracks the reference plus a share of δ, so that
feedback does not fight what physics does anyway.
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
_REACH_S: Final = 1.5  # how far beyond its ends the motion is continued: many time constants 1/ω ≈ 0.17 s
_LEAST_LOAD: Final = 0.1  # share of the weight below which the zero-moment point says nothing (flight)


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
    mismatch, stiffness = _mismatch(motion, robot, acceleration)
    yaw = yaw_from_quat(motion.root_quat_wxyz)
    local = rotate_planar(-yaw, mismatch)  # turns with the body, so that it repeats with the motion
    reach = int(np.ceil(_REACH_S / dt))
    index, wide_yaw = _extended(yaw, motion, reach)
    shift = _bounded_solution(rotate_planar(wide_yaw, local[index]), stiffness[index], dt)
    shift = shift[reach : reach + n + 2]  # one sample more at each end, for the velocity
    velocity = (shift[2:] - shift[:-2]) / (2 * dt)
    second = (shift[2:] - 2 * shift[1:-1] + shift[:-2]) / dt**2
    return rotate_planar(-yaw, shift[1:-1]), rotate_planar(-yaw, velocity), rotate_planar(-yaw, second)


def _bounded_solution(target: Array, stiffness: Array, dt: float) -> Array:
    """Solves δ̈ = stiffness (δ − target) by central differences, δ̈ = 0 at both ends; (k, 2) for (k, 2) and (k,)."""
    from scipy.linalg import solve_banded

    k = len(target)
    if not stiffness.any():  # never on the ground: nothing to sway over
        return np.zeros_like(target)
    bands = np.zeros((3, k))
    bands[0, 1:] = bands[2, :-1] = -1.0
    bands[1] = 2.0 + dt**2 * stiffness
    bands[1, [0, -1]] -= 1.0
    return solve_banded((1, 1), bands, dt**2 * stiffness[:, None] * target)


def _extended(yaw: Array, motion: Motion, reach: int) -> tuple[NDArray[np.int64], Array]:
    """Samples and yaw of the motion continued by `reach` + 1 samples each way: repeated if it is periodic, else
    held."""
    n = motion.n_samples
    index = np.arange(-reach - 1, n + reach + 1)
    if motion.cycle is None:
        index = np.clip(index, 0, n - 1)
        return index, yaw[index]
    return index % n, yaw[index % n] + (index // n) * motion.cycle[2]


def _mismatch(motion: Motion, robot: Robot, acceleration: tuple[Array, Array, Array]) -> tuple[Array, Array]:
    """Support point minus zero-moment point, (t, 2) world, m, and the pendulum's stiffness ω², (t,) 1/s², 0 in
    flight."""
    feet = motion.root_pos_w[:, None] + quat_rotate(motion.root_quat_wxyz[:, None], motion.foot_pos_b)
    load = np.stack([_load(c, motion) for c in motion.contact.T], axis=1)
    total = load.sum(axis=1)
    force, moment = _ground_wrench(motion, robot, acceleration)
    vertical = np.where(total > 0, np.maximum(force[:, 2], 0.0), 0.0)
    known = vertical > _LEAST_LOAD * robot.mass * GRAVITY
    weights = load / np.where(total > 0, total, 1.0)[:, None]
    support = np.einsum("tl,tlk->tk", weights, feet[..., :2])
    zmp = np.stack([-moment[:, 1], moment[:, 0]], axis=1) / np.where(known, force[:, 2], 1.0)[:, None]
    height = motion.root_pos_w[:, 2] + float(robot.com_b[2])
    return np.where(known[:, None], support - zmp, 0.0), np.where(known, vertical / (robot.mass * height), 0.0)


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
    before, after = (
        (contact, contact) if motion.cycle is not None else (np.full(n, contact[0]), np.full(n, contact[-1]))
    )
    c = np.concatenate([before, contact, after])
    index = np.arange(3 * n)
    since = index - np.maximum.accumulate(np.where(c, -1, index))
    until = np.minimum.accumulate(np.where(c, 3 * n, index)[::-1])[::-1] - index
    steps = np.minimum(since, until) * c
    return np.clip(steps * motion.dt / LOADING_TIME, 0.0, 1.0)[n : 2 * n]
