"""How the body has to sway over the reference's footholds: the path of a linear inverted pendulum.

A retargeted reference is consistent as geometry, not as dynamics: over feet that stand wider than the animal's, the body
cannot help swaying further than the reference does. A pendulum of height h whose support point p(t) moves with the
reference's feet obeys ÿ = ω² (y − p), ω² = g / h; its only bounded solution is the two-sided exponential average
y(t) = ω/2 ∫ e^(−ω|t−s|) p(s) ds (Kajita et al. 2001; Englsberger et al. 2015 for the capture-point view). The controller
tracks the reference plus a share of the difference, so that feedback does not fight what physics does anyway.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from fastmimic.conventions import GRAVITY
from fastmimic.motion.motion import Motion
from fastmimic.robot import Robot
from fastmimic.rotations import quat_rotate, rotate_planar, yaw_from_quat

Array = NDArray[np.float64]

LOADING_TIME: Final = 0.05  # s over which a foot takes up its share of the load after touch-down, and gives it up before take-off
_MEMORY: Final = 8.0  # the average reaches this many time constants 1/ω each way


def pendulum_sway(motion: Motion, robot: Robot) -> tuple[Array, Array, Array]:
    """The pendulum's path relative to the reference's centre of mass.

    Args:
        motion: the reference.
        robot: for its centre of mass.

    Returns:
        Displacement, velocity, acceleration to be added to the reference's, (t, 2) each, x and y in the
        reference's heading frame, m, m/s, m/s².
    """
    n, dt = motion.n_samples, motion.dt
    omega = np.sqrt(GRAVITY / float(np.mean(motion.root_pos_w[:, 2])))
    reach = int(np.ceil(_MEMORY / (omega * dt)))
    cycles = int(np.ceil(reach / n)) if motion.cycle is not None else 0
    com_w = motion.root_pos_w + quat_rotate(motion.root_quat_wxyz, np.broadcast_to(robot.com_b, (n, 3)))
    support = _unrolled(_support_point(motion, com_w[:, :2]), motion, cycles, reach)
    lags = np.arange(-reach, reach + 1) * dt
    kernel = np.exp(-omega * np.abs(lags))
    kernel /= kernel.sum()
    first = cycles * n if motion.cycle is not None else reach
    wide = slice(first - 1, first + n + 1)  # one sample more at each end, for the derivatives
    path = np.stack([_convolve(support[:, k], kernel)[wide] for k in range(2)], axis=1)
    com = _unrolled(com_w[:, :2], motion, cycles, reach)[wide]
    offset = path - com
    turn = -yaw_from_quat(motion.root_quat_wxyz)
    velocity = (offset[2:] - offset[:-2]) / (2 * dt)
    acceleration = (offset[2:] - 2 * offset[1:-1] + offset[:-2]) / dt**2
    return tuple(rotate_planar(turn, v) for v in (offset[1:-1], velocity, acceleration))  # type: ignore[return-value]


def _convolve(signal: Array, kernel: Array) -> Array:
    from scipy.signal import fftconvolve

    return fftconvolve(signal, kernel, mode="same")


def _support_point(motion: Motion, com_xy: Array) -> Array:
    """Load-weighted mean of the standing feet, (t, 2) world, m; interpolated through flight."""
    feet = motion.root_pos_w[:, None] + quat_rotate(motion.root_quat_wxyz[:, None], motion.foot_pos_b)
    load = np.stack([_load(c, motion) for c in motion.contact.T], axis=1)
    total = load.sum(axis=1)
    standing = np.flatnonzero(total > 0)
    if not len(standing):
        return com_xy
    relative = np.zeros((motion.n_samples, 2))
    weights = load[standing] / total[standing, None]
    relative[standing] = np.einsum("tl,tlk->tk", weights, feet[standing][..., :2]) - com_xy[standing]
    every = np.arange(motion.n_samples)
    for k in range(2):  # relative to the moving body, so that flight does not leave the support behind
        relative[:, k] = np.interp(every, standing, relative[standing, k])
    return relative + com_xy


def _load(contact: NDArray[np.bool_], motion: Motion) -> Array:
    """Share of a foot's load (t,): up within `LOADING_TIME` of touch-down, down again before take-off."""
    if contact.all():
        return np.ones(len(contact))
    n = len(contact)
    c = np.tile(contact, 3) if motion.cycle is not None else np.concatenate([np.full(n, contact[0]), contact, np.full(n, contact[-1])])
    index = np.arange(3 * n)
    since = index - np.maximum.accumulate(np.where(c, -1, index))
    until = (np.minimum.accumulate(np.where(c, 3 * n, index)[::-1])[::-1]) - index
    steps = np.minimum(since, until) * c
    return np.clip(steps * motion.dt / LOADING_TIME, 0.0, 1.0)[n : 2 * n]


def _unrolled(xy: Array, motion: Motion, cycles: int, reach: int) -> Array:
    """A planar path continued `cycles` periods each way, or held at its ends for `reach` samples."""
    if motion.cycle is None:
        return np.concatenate([np.repeat(xy[:1], reach, axis=0), xy, np.repeat(xy[-1:], reach, axis=0)])
    yaw0 = float(yaw_from_quat(motion.root_quat_wxyz[0]))
    origin = motion.root_pos_w[0, :2]
    local = rotate_planar(-yaw0, xy - origin)
    parts = []
    for k in range(-cycles, cycles + 1):
        shift, turn = _moved(motion.cycle, k)
        parts.append(rotate_planar(yaw0, rotate_planar(turn, local) + shift) + origin)
    return np.concatenate(parts)


def _moved(cycle: Array, k: int) -> tuple[Array, float]:
    """Displacement and turn after k periods (k may be negative), in sample 0's heading frame."""
    shift, turn = np.zeros(2), 0.0
    for _ in range(abs(k)):
        if k > 0:
            shift = shift + rotate_planar(turn, cycle[:2])
            turn += float(cycle[2])
        else:
            turn -= float(cycle[2])
            shift = shift - rotate_planar(turn, cycle[:2])
    return shift, turn
