"""The reference in the form that the compiled loop reads: a table of samples and a clock for each robot.

A table holds one period, relative to the heading frame of its sample 0. A robot's clock says which sample is now
and where the period's origin lies in the world (x, y, yaw); at each wrap the origin moves on by the period's
displacement and its x and y are re-synchronised to the robot, never its yaw.
"""

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from fastmimic.control.sway import pendulum_sway
from fastmimic.errors import MotionError
from fastmimic.jit import inlined, kernel, record_dtype
from fastmimic.motion.motion import Motion
from fastmimic.robot import Robot
from fastmimic.rotations import (
    quat_continuous,
    quat_from_yaw,
    quat_multiply,
    rotate_planar,
    yaw_from_quat,
)

Array = NDArray[np.float64]

SAMPLE: Final = record_dtype(
    [
        ("root_pos", "f8", (3,)),
        ("root_quat", "f8", (4,)),
        ("lin_vel", "f8", (3,)),
        ("ang_vel", "f8", (3,)),
        ("lin_acc", "f8", (3,)),
        ("ang_acc", "f8", (3,)),
        ("joint_pos", "f8", (12,)),
        ("joint_vel", "f8", (12,)),
        ("joint_acc", "f8", (12,)),
        ("foot_pos", "f8", (4, 3)),
        ("contact", "i8", (4,)),
        ("sway_pos", "f8", (2,)),
        ("sway_vel", "f8", (2,)),
        ("sway_acc", "f8", (2,)),
    ]
)
"""One instant of a reference, relative to the heading frame of the period's first sample; the sway in its own
heading frame."""

CLOCK: Final = record_dtype(
    [("sample", "i8"), ("cycle", "i8"), ("origin", "f8", (3,)), ("cycle_step", "f8", (3,)), ("jump", "f8")]
)
"""Where a robot is in its reference: sample, period, (x, y, yaw) of the period's origin, one period's displacement, and
the sum of the distances by which synchronisation has moved the origin, m."""


def reference_table(motion: Motion, robot: Robot) -> NDArray[Any]:
    """Packs a motion into an array of `SAMPLE`, shape (t,), in the frame of its demonstration's first sample.

    Accelerations are central differences of the motion's velocities, periodic if the motion is.
    """
    origin = motion.target  # a reference and its demonstration share one frame
    yaw0 = float(yaw_from_quat(origin.root_quat_wxyz[0]))
    unturn = quat_from_yaw(-yaw0)
    dt = motion.dt
    turn = 0.0 if motion.cycle is None else float(motion.cycle[2])
    periodic = motion.cycle is not None

    table = np.zeros(motion.n_samples, SAMPLE)
    position = motion.root_pos_w - np.array([*origin.root_pos_w[0, :2], 0.0])
    table["root_pos"] = planar_turned(position, -yaw0)
    table["root_quat"] = quat_continuous(quat_multiply(unturn[None], motion.root_quat_wxyz))
    for name, velocity in (("lin", motion.root_lin_vel_w), ("ang", motion.root_ang_vel_w)):
        table[f"{name}_vel"] = planar_turned(velocity, -yaw0)
        table[f"{name}_acc"] = _difference(table[f"{name}_vel"], dt, turn if periodic else None)
    table["joint_pos"] = motion.joint_pos
    table["joint_vel"] = motion.joint_vel
    table["joint_acc"] = _difference(motion.joint_vel, dt, 0.0 if periodic else None)
    table["foot_pos"] = motion.foot_pos_b
    table["contact"] = motion.contact
    if motion.demonstration is not None:
        # the sway belongs to the motion, not to its modulation: what is optimised is what is saved
        sway = tuple(reference_table(motion.demonstration, robot)[f"sway_{k}"] for k in ("pos", "vel", "acc"))
    else:
        linear, angular = (planar_turned(table[f"{name}_acc"], yaw0) for name in ("lin", "ang"))
        sway = pendulum_sway(motion, robot, (linear, angular, table["joint_acc"]))
    table["sway_pos"], table["sway_vel"], table["sway_acc"] = sway
    return table


def planar_turned(v: Array, angle: float) -> Array:
    """Vectors (t, 3) turned by `angle` about z."""
    out = np.array(v)
    out[:, :2] = rotate_planar(angle, out[:, :2])
    return out


def _difference(v: Array, dt: float, turn: float | None) -> Array:
    """Central difference of (t, k); with `turn` the signal repeats, its x and y turned by that angle each period."""
    if turn is None:
        return np.gradient(v, dt, axis=0)
    before, after = v[-1:].copy(), v[:1].copy()
    if v.shape[1] == 3:
        before[:, :2] = rotate_planar(-turn, before[:, :2])
        after[:, :2] = rotate_planar(turn, after[:, :2])
    extended = np.concatenate([before, v, after])
    return (extended[2:] - extended[:-2]) / (2 * dt)


def make_clocks(motion: Motion, n: int) -> NDArray[Any]:
    """Clocks of n robots at the start of the motion, (n,) of `CLOCK`."""
    clocks = np.zeros(n, CLOCK)
    clocks["cycle_step"] = (0.0, 0.0, 0.0) if motion.cycle is None else motion.cycle
    return clocks


def place_clocks(clocks: NDArray[Any], sample: NDArray[np.int64], table: NDArray[Any], pose: Array) -> None:
    """Sets each clock to a sample and its origin so that the reference root there has the given (x, y, yaw).

    Args:
        clocks: (n,) of `CLOCK`, changed in place.
        sample: (n,) sample indices.
        table: (t,) of `SAMPLE`.
        pose: (n, 3) x, y, yaw in the world, m and rad.
    """
    clocks["sample"] = sample
    clocks["cycle"] = 0
    clocks["jump"] = 0.0
    root = table["root_pos"][sample]
    yaw = pose[:, 2] - yaw_from_quat(table["root_quat"][sample])
    clocks["origin"][:, :2] = pose[:, :2] - rotate_planar(yaw, root[:, :2])
    clocks["origin"][:, 2] = yaw


@inlined
def advance_clock(clock: Any, n_samples: int, x: float, y: float, table: Any) -> None:
    """One control step on; at a wrap the origin moves by one period and is re-synchronised to the robot at (x, y)."""
    clock.sample += 1
    if clock.sample < n_samples:
        return
    clock.sample = 0
    clock.cycle += 1
    c, s = np.cos(clock.origin[2]), np.sin(clock.origin[2])
    moved_x = clock.origin[0] + c * clock.cycle_step[0] - s * clock.cycle_step[1]
    moved_y = clock.origin[1] + s * clock.cycle_step[0] + c * clock.cycle_step[1]
    clock.origin[2] += clock.cycle_step[2]
    c, s = np.cos(clock.origin[2]), np.sin(clock.origin[2])
    root = table[0].root_pos
    clock.origin[0] = x - (c * root[0] - s * root[1])
    clock.origin[1] = y - (s * root[0] + c * root[1])
    clock.jump += np.hypot(clock.origin[0] - moved_x, clock.origin[1] - moved_y)


@kernel
def advance_clocks(clocks: Any, tables: Any, root_xy: Array) -> None:
    """Advances all clocks by one control step.

    Args:
        clocks: (n,) of `CLOCK`.
        tables: (k, t) of `SAMPLE`; robot i follows table min(i, k − 1).
        root_xy: (n, ≥2) where the robots are now, world, m.
    """
    for i in range(clocks.shape[0]):
        k = min(i, tables.shape[0] - 1)
        advance_clock(clocks[i], tables.shape[1], root_xy[i, 0], root_xy[i, 1], tables[k])


def stack_tables(motions: Sequence[Motion], robot: Robot) -> NDArray[Any]:
    """Tables of several references with one period, (k, t) of `SAMPLE`.

    Raises:
        MotionError: their lengths differ.
    """
    lengths = {m.n_samples for m in motions}
    if len(lengths) != 1:
        raise MotionError(f"references of one batch must have the same number of samples, found {sorted(lengths)}")
    return np.stack([reference_table(m, robot) for m in motions])


def world_root(table: NDArray[Any], sample: NDArray[np.int64], origin: Array) -> tuple[Array, Array]:
    """Root position (…, 3) and quaternion (…, 4) in the world of samples seen from origins (…, 3) (x, y, yaw)."""
    position = np.array(table["root_pos"][sample])
    position[..., :2] = rotate_planar(origin[..., 2], position[..., :2]) + origin[..., :2]
    return position, quat_multiply(quat_from_yaw(origin[..., 2]), table["root_quat"][sample])
