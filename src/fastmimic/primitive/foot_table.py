"""Brings the feet of modulated motions into the legs' reach and computes their joints."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fastmimic.base.arrays import Array
from fastmimic.base.jit import inlined, kernel
from fastmimic.robot.kinematics import leg_forward, leg_inverse
from fastmimic.robot.robot import Robot


class FootTable(NamedTuple):
    """Feet and joints of n courses of t samples. Feet (n, t, 4, 3) are within reach, body frame, m; joints (n, t, 12)
    within their ranges, rad, with central differences as velocity, rad/s. `shift_m` and `n_shifted` (n, 4) are each
    foot's largest shift, m, and the number of its samples moved by more than 0.01 mm."""

    foot_pos_b: Array
    joint_pos: Array
    joint_vel: Array
    shift_m: Array
    n_shifted: NDArray[np.int64]


def foot_table(robot: Robot, foot_pos_b: Array, rate_hz: float, periodic: bool = True) -> FootTable:
    """Joints of n courses of foot positions `foot_pos_b` (n, t, 4, 3), body frame, m, in one compiled call. A foot out
    of reach (leg too short, or knee at its limit) moves to the nearest point in reach on the line from the hip; if
    abduction or hip are at their limits, to the foot position of the limited joints."""
    feet = np.array(foot_pos_b, dtype=np.float64, order="C")
    n, t = feet.shape[:2]
    joint_pos = np.empty((n, t, 12))
    shift, count = np.zeros((n, 4)), np.zeros((n, 4), dtype=np.int64)
    limits = np.stack([robot.joint_lower, robot.joint_upper])
    _reach(robot.geometry.rows, limits, feet, joint_pos, shift, count)
    if periodic:
        joint_vel = (np.roll(joint_pos, -1, axis=1) - np.roll(joint_pos, 1, axis=1)) * (0.5 * rate_hz)
    else:
        joint_vel = np.asarray(np.gradient(joint_pos, 1.0 / rate_hz, axis=1))
    return FootTable(feet, joint_pos, joint_vel, shift, count)


@inlined
def _limited(value: float, lower: float, upper: float) -> float:
    return lower if value < lower else (upper if value > upper else value)


@inlined
def _hip_to_foot_angle(g: Array, knee: float) -> float:
    """Angle from the thigh to the line hip → foot, in the leg's plane."""
    lt, lc = np.hypot(g[6], g[7]), np.hypot(g[8], g[9])
    bend = knee - np.arctan2(-g[6], -g[7]) + np.arctan2(-g[8], -g[9])
    return np.arctan2(lc * np.sin(bend), lt + lc * np.cos(bend))


@kernel
def _reach(rows: Array, limits: Array, feet: Array, q: Array, shift: Array, count: NDArray[np.int64]) -> None:
    """Joints `q` of `feet`, which are changed in place where out of reach."""
    lower, upper = limits[0], limits[1]
    for n in range(feet.shape[0]):
        for t in range(feet.shape[1]):
            for leg in range(4):
                g, j = rows[leg], 3 * leg
                p = feet[n, t, leg]
                a, h, k, ok = leg_inverse(g, p[0], p[1], p[2])
                knee = _limited(k, lower[j + 2], upper[j + 2])
                if knee != k:  # keep the direction from hip to foot
                    h += _hip_to_foot_angle(g, k) - _hip_to_foot_angle(g, knee)
                q[n, t, j] = _limited(a, lower[j], upper[j])
                q[n, t, j + 1] = _limited(h, lower[j + 1], upper[j + 1])
                q[n, t, j + 2] = knee
                if not ok or knee != k or q[n, t, j] != a or q[n, t, j + 1] != h:
                    x, y, z = leg_forward(g, q[n, t, j], q[n, t, j + 1], knee)
                    moved = np.sqrt((x - p[0]) ** 2 + (y - p[1]) ** 2 + (z - p[2]) ** 2)
                    p[0], p[1], p[2] = x, y, z
                    shift[n, leg] = max(shift[n, leg], moved)
                    count[n, leg] += moved > 1e-5
