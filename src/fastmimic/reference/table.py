"""The reference for the compiled loop: a table of samples, and a clock for each robot.

A table holds one period, relative to the heading frame of its sample 0. A clock holds the present sample and the
period's origin in the world (x, y, yaw). At each wrap the origin moves by the period's displacement. At each start of a
cycle (a cyclic motion's wrap, or a stitched one's sample with `sync`) its x and y, never its yaw, follow the robot.
"""

from collections.abc import Callable, Sequence
from functools import wraps
from typing import Any, Final, TypeVar
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from fastmimic.base.arrays import Array, Records
from fastmimic.base.conventions import GRAVITY
from fastmimic.base.errors import MotionError
from fastmimic.base.jit import floats, inlined, integers, kernel, record_dtype
from fastmimic.base.rotations import (
    quat_continuous,
    quat_from_yaw,
    quat_multiply,
    quat_rotate,
    quat_rotate_inverse,
    rotate_planar,
    turned_about_z,
    yaw_from_quat,
)
from fastmimic.motion.contacts import swung
from fastmimic.motion.limits import ground_demand
from fastmimic.motion.motion import Motion
from fastmimic.robot import Robot

_Result = TypeVar("_Result")

SAMPLE: Final = record_dtype(
    [
        *floats(root_pos=3, root_quat=4, lin_vel=3, ang_vel=3, lin_acc=3, ang_acc=3),
        *floats(joint_pos=12, joint_vel=12, joint_acc=12, foot_pos=(4, 3)),
        ("contact", "i8", 4),
        *floats(swung=4, leg_lin_acc=3, leg_ang_acc=3),
        *integers(sync=(), gain=()),
    ]
)
"""One sample of a reference, in the heading frame of the period's first sample. `swung` is the share of a leg's swing
that is over; `leg_lin_acc` and `leg_ang_acc` are the accelerations that the ground must give beyond those of the body
(`ground_acceleration`). `sync` is 1 where a cycle starts; `gain` the row of gains, one for `GAIN_SAMPLES` samples."""

GAIN_SAMPLES: Final = 4

CLOCK: Final = record_dtype(
    [*integers(sample=(), cycle=(), repeats=()), *floats(origin=3, cycle_step=3, jump=(), part=(), ahead=(), held=2)]
)
"""A robot's progress in its reference: sample, period, whether the motion repeats, (x, y, yaw) of the period's origin,
one period's displacement, and the distance by which synchronisation has moved the origin so far, m. After haste, it is
`ahead` of its own time by so many samples, and by `part` of the next one; `held` is how far the origin has moved so
that the root stays in its own time, m."""

_CATCHING_UP: Final = 0.1  # samples that a motion that does not repeat waits in each control step after haste


def reference_table(motion: Motion, robot: Robot) -> Records:
    """Packs a motion into an array (t,) of `SAMPLE`, in the frame of its demonstration's first sample. Accelerations
    are central differences of the velocities, periodic if the motion is."""
    origin = motion.target  # a reference and its demonstration share one frame
    yaw0 = float(yaw_from_quat(origin.root_quat_wxyz[0]))
    dt = motion.dt
    periodic = motion.cycle is not None

    table = np.zeros(motion.n_samples, SAMPLE)
    root = (motion.root_pos_w, motion.root_quat_wxyz, motion.root_lin_vel_w, motion.root_ang_vel_w)
    put_root(table, origin, *root)
    table["joint_pos"] = motion.joint_pos
    table["joint_vel"] = motion.joint_vel
    table["joint_acc"] = _difference(motion.joint_vel, dt, 0.0 if periodic else None)
    table["foot_pos"] = motion.foot_pos_b
    table["contact"], table["swung"] = motion.contact, swung(motion.contact, periodic)
    if motion.demonstration is not None:
        # of the demonstration: a modulation moves the feet little, and search and saved motion must agree
        demonstration = reference_table(motion.demonstration, robot)
        for name in ("leg_lin_acc", "leg_ang_acc"):
            table[name] = demonstration[name]
    else:
        linear, angular = ground_acceleration(motion, robot)
        table["leg_lin_acc"] = turned_about_z(linear, -yaw0) - table["lin_acc"]
        table["leg_ang_acc"] = turned_about_z(angular, -yaw0) - table["ang_acc"]
    table["sync"][origin.cycle_starts] = 1
    table["gain"] = np.arange(motion.n_samples) // GAIN_SAMPLES
    return table


def put_root(
    table: Records, demonstration: Motion, position: Array, quat: Array, lin_vel: Array, ang_vel: Array
) -> None:
    """Puts a root's path into a table (t,) of `SAMPLE`, in the frame of the demonstration's first sample. `position`
    (t, 3), m, `quat` (t, 4), wxyz, and the velocities (t, 3), m/s and rad/s, are in the world frame."""
    yaw0 = float(yaw_from_quat(demonstration.root_quat_wxyz[0]))
    turn = None if demonstration.cycle is None else float(demonstration.cycle[2])
    table["root_pos"] = turned_about_z(position - np.array([*demonstration.root_pos_w[0, :2], 0.0]), -yaw0)
    table["root_quat"] = quat_continuous(quat_multiply(quat_from_yaw(-yaw0)[None], quat))
    for name, velocity in (("lin", lin_vel), ("ang", ang_vel)):
        table[f"{name}_vel"] = turned_about_z(velocity, -yaw0)
        table[f"{name}_acc"] = _difference(table[f"{name}_vel"], demonstration.dt, turn)


def once(compute: Callable[..., _Result]) -> Callable[..., _Result]:
    """A function of a motion's demonstration, a robot and settings, computed once: none of them changes."""
    known: WeakKeyDictionary[Motion, dict[tuple[Any, ...], _Result]] = WeakKeyDictionary()

    @wraps(compute)
    def found(motion: Motion, robot: Robot, *settings: Any) -> _Result:
        of = known.setdefault(motion.target, {})
        key = robot.content, robot.mass, robot.com_b.tobytes(), robot.inertia_b.tobytes(), *settings
        if key not in of:
            of[key] = compute(motion.target, robot, *settings)
        return of[key]

    return found


@once
def ground_acceleration(motion: Motion, robot: Robot) -> tuple[Array, Array]:
    """Linear (t, 3), m/s², and angular (t, 3), rad/s², world: a motion's ground wrench as rigid-body acceleration.

    It is F/m − g and I⁻¹τ about the centre of mass, by inverse dynamics of the whole robot. It differs from the trunk's
    acceleration by the momentum of the legs, the position of the centre of mass and the gyroscopic moment; without
    these, the stance QP's forces would be wrong by some newtons at each swing, and a robot with heavy legs would sway.
    """
    demand = ground_demand(robot, motion, np.arange(motion.n_samples))
    yaw = yaw_from_quat(motion.root_quat_wxyz)
    linear = demand.wrench[:, :3] / robot.mass - np.array([0.0, 0.0, GRAVITY])
    level = quat_multiply(quat_from_yaw(-yaw), motion.root_quat_wxyz)  # body → heading frame
    moment_b = quat_rotate_inverse(level, demand.wrench[:, 3:])
    angular = quat_rotate(level, np.asarray(np.linalg.solve(robot.inertia_b, moment_b.T).T, dtype=np.float64))
    return turned_about_z(linear, yaw), turned_about_z(angular, yaw)


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


def make_clocks(motion: Motion, n: int) -> Records:
    """Clocks of n robots at the start of the motion, (n,) of `CLOCK`."""
    clocks = np.zeros(n, CLOCK)
    if motion.cycle is not None:
        clocks["repeats"], clocks["cycle_step"] = 1, motion.cycle
    return clocks


def place_clocks(clocks: Records, sample: NDArray[np.int64], table: Records, pose: Array) -> None:
    """Sets clocks (n,) to samples (n,) with the reference root there at `pose` (n, 3): x, y, yaw, world, m and rad."""
    clocks["sample"] = sample
    for name in ("cycle", "jump", "part", "ahead", "held"):
        clocks[name] = 0
    root = table["root_pos"][sample]
    yaw = pose[:, 2] - yaw_from_quat(table["root_quat"][sample])
    clocks["origin"][:, :2] = pose[:, :2] - rotate_planar(yaw, root[:, :2])
    clocks["origin"][:, 2] = yaw


@inlined
def steps_due(clock: Any, n_samples: int, haste: float, table: Any) -> int:
    """How many samples a clock advances in a control step: one, with haste two at times. After haste, a motion that
    does not repeat waits at times, while its root goes on, until it is back in its own time."""
    clock.part += haste
    if haste == 0.0 and clock.repeats == 0 and clock.ahead > 0.0:
        clock.part -= _CATCHING_UP
    if clock.part >= 1.0:
        clock.part -= 1.0
        clock.ahead += 1.0
        return 2
    if clock.part <= -1.0:
        clock.part += 1.0
        clock.ahead -= 1.0
        if clock.sample + 1 < n_samples:
            here, there = table[clock.sample].root_pos, table[clock.sample + 1].root_pos
            _hold(clock, in_world(clock, here), in_world(clock, there))
        return 0
    return 1


@inlined
def next_period(clock: Any, x: float, y: float, yaw: float) -> tuple[float, float, float]:
    """The place of a period's origin, one period later."""
    c, s, step = np.cos(yaw), np.sin(yaw), clock.cycle_step
    return x + (c * step[0] - s * step[1]), y + (s * step[0] + c * step[1]), yaw + step[2]


@inlined
def in_world(clock: Any, position: Array) -> tuple[float, float]:
    """World x and y of a sample's position (≥2,), m."""
    c, s = np.cos(clock.origin[2]), np.sin(clock.origin[2])
    return clock.origin[0] + c * position[0] - s * position[1], clock.origin[1] + s * position[0] + c * position[1]


@inlined
def _hold(clock: Any, at: tuple[float, float], wanted: tuple[float, float]) -> None:
    """Moves the origin from one place to another, world, m."""
    for k in range(2):
        clock.origin[k] += wanted[k] - at[k]
        clock.held[k] += wanted[k] - at[k]


@inlined
def put_root_at(clock: Any, table: Any, x: float, y: float) -> None:
    """Moves the origin so that the reference is at (x, y)."""
    c, s, root = np.cos(clock.origin[2]), np.sin(clock.origin[2]), table[clock.sample].root_pos
    clock.origin[0] = x - (c * root[0] - s * root[1])
    clock.origin[1] = y - (s * root[0] + c * root[1])


@inlined
def synchronise(clock: Any, table: Any, x: float, y: float, moved_x: float, moved_y: float) -> None:
    """Moves the origin from where it had moved so that the reference is at (x, y)."""
    put_root_at(clock, table, x, y)
    clock.jump += np.hypot(clock.origin[0] - moved_x, clock.origin[1] - moved_y)


@inlined
def advance_clock(clock: Any, n_samples: int, x: float, y: float, table: Any) -> None:
    """Advances by one sample, at most to a motion's end; at a cycle's start the origin follows a robot at (x, y)."""
    if clock.repeats == 0 and clock.sample + 1 >= n_samples:
        return
    clock.sample += 1
    moved_x, moved_y = clock.origin[0], clock.origin[1]
    if clock.sample >= n_samples:
        clock.sample = 0
        clock.cycle += 1
        moved_x, moved_y, clock.origin[2] = next_period(clock, moved_x, moved_y, clock.origin[2])
    if table[clock.sample].sync == 1:
        synchronise(clock, table, x, y, moved_x, moved_y)


@inlined
def taken_up_at(sample: int) -> float:
    """What a controller gives in place of a haste: its motion, if it repeats, goes on from another sample and from
    where the robot is."""
    return -1.0 - sample


@inlined
def _take_up(clock: Any, table: Any, sample: int, x: float, y: float) -> None:
    """Goes to a sample in the same heading, with the root at (x, y)."""
    before, there = table[clock.sample].root_quat, table[sample].root_quat
    place = in_world(clock, table[clock.sample].root_pos)
    clock.origin[2] += 2.0 * (np.arctan2(before[3], before[0]) - np.arctan2(there[3], there[0]))
    clock.sample = sample
    _hold(clock, in_world(clock, table[sample].root_pos), place)
    synchronise(clock, table, x, y, clock.origin[0], clock.origin[1])


@kernel
def advance_clocks(clocks: Any, tables: Any, root_xy: Array, haste: Array) -> None:
    """Advances clocks (n,) by one control step; robot i follows table min(i, k − 1) of `tables` (k, t) of `SAMPLE`.
    `root_xy` (n, ≥2) are the robots' positions, world, m; `haste` (n,) that of `MEMORY`, or `taken_up_at`."""
    n_samples = tables.shape[1]
    for i in range(clocks.shape[0]):
        clock, table = clocks[i], tables[min(i, tables.shape[0] - 1)]
        due = steps_due(clock, n_samples, max(haste[i], 0.0), table)
        if haste[i] < 0.0 and clock.repeats == 1:
            _take_up(clock, table, int(-haste[i]) - 1, root_xy[i, 0], root_xy[i, 1])
        if due > 0:
            advance_clock(clock, n_samples, root_xy[i, 0], root_xy[i, 1], table)
        if due > 1:  # by a sample more: the feet go on, the root stays where it is
            before = in_world(clock, table[clock.sample].root_pos)
            advance_clock(clock, n_samples, root_xy[i, 0], root_xy[i, 1], table)
            if table[clock.sample].sync == 0:
                _hold(clock, in_world(clock, table[clock.sample].root_pos), before)


def stack_tables(motions: Sequence[Motion], robot: Robot) -> Records:
    """Tables (k, t) of `SAMPLE` of several references; `MotionError` if their lengths differ."""
    lengths = {m.n_samples for m in motions}
    if len(lengths) != 1:
        raise MotionError(f"references of one batch must have the same number of samples, found {sorted(lengths)}")
    return np.stack([reference_table(m, robot) for m in motions])


def world_root(table: Records, sample: NDArray[np.int64], origin: Array) -> tuple[Array, Array]:
    """Root position (…, 3) and quaternion (…, 4) in the world at samples, for origins (…, 3) (x, y, yaw)."""
    position = np.array(table["root_pos"][sample])
    position[..., :2] = rotate_planar(origin[..., 2], position[..., :2]) + origin[..., :2]
    return position, quat_multiply(quat_from_yaw(origin[..., 2]), table["root_quat"][sample])
