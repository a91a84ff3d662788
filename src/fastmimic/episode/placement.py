"""The state of a robot that tracks its reference exactly."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fastmimic.base.arrays import Array
from fastmimic.base.rotations import quat_rotate_inverse, rotate_planar
from fastmimic.reference.table import world_root


class Placement(NamedTuple):
    """State of n robots, in the order of `Simulation.reset`.

    Attributes:
        root_pos, root_quat: (n, 3) m and (n, 4), world frame.
        joint_pos: (n, 12) rad.
        lin_vel: (n, 3) m/s, world frame.
        ang_vel_b: (n, 3) rad/s, body frame.
        joint_vel: (n, 12) rad/s.
    """

    root_pos: Array
    root_quat: Array
    joint_pos: Array
    lin_vel: Array
    ang_vel_b: Array
    joint_vel: Array


def on_reference(table: NDArray[Any], sample: NDArray[np.int64], origin: Array) -> Placement:
    """The states at samples (n,) of a table (t,) of `SAMPLE` with its origin at (n, 3) (x, y, yaw) in the world."""
    position, quat = world_root(table, sample, origin)
    velocity, turning = np.array(table["lin_vel"][sample]), np.array(table["ang_vel"][sample])
    velocity[:, :2] = rotate_planar(origin[:, 2], velocity[:, :2])
    turning[:, :2] = rotate_planar(origin[:, 2], turning[:, :2])
    return Placement(
        position,
        quat,
        table["joint_pos"][sample],
        velocity,
        quat_rotate_inverse(quat, turning),
        table["joint_vel"][sample],
    )
