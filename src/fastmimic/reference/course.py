"""A motion in its own moving frame. Each sample is in the heading frame of the reference's root, and the root's path is
the step to the next sample. A cycle is then periodic, a motion continuous into a transition, and gaits can be mixed.
Stitching's transitions between motions are courses, too.

`fill_table` turns a course into the table that the controller reads, from any place in it, and from one course into the
next. Samples are interpolated: after haste the place lies between two of them.
"""

from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from fastmimic.base.arrays import Array, Records
from fastmimic.base.errors import MotionError
from fastmimic.base.jit import floats, inlined, integers, kernel, record_dtype
from fastmimic.base.rotations import quat_from_yaw, quat_multiply, quat_rotate, turned_about_z, yaw_from_quat
from fastmimic.base.vectors import copy, quat_about_z, quat_turned
from fastmimic.motion.motion import Motion
from fastmimic.reference.regulator import motion_gains
from fastmimic.reference.regulator_config import RegulatorConfig
from fastmimic.reference.table import reference_table
from fastmimic.retargeting.track import steps
from fastmimic.robot import Robot
from fastmimic.robot.kinematics import leg_inverse
from fastmimic.stitching.join import default_cycles, stitch_motions
from fastmimic.stitching.transition import Layout

COURSE: Final = record_dtype(
    [
        *floats(step=2, turn=(), root_z=(), tilt=4, lin_vel=3, ang_vel=3, lin_acc=3, ang_acc=3),
        *floats(swung=4, leg_lin_acc=3, leg_ang_acc=3, foot=(4, 3)),
        ("contact", "i8", 4),
        *integers(sync=(), gain=()),
    ]
)
"""One sample, heading frame of the root, SI units: `step` and `turn` of the root to the next sample; `tilt` heading →
body; `foot` from the root on the ground, z of its centre; and velocities, accelerations and `gain` as in `SAMPLE`."""


def course_of(motion: Motion, robot: Robot) -> Records:
    """A cycle or stitched motion, at the controller's rate, as an array (t,) of `COURSE`."""
    table = reference_table(motion, robot)
    course = np.zeros(motion.n_samples, COURSE)
    yaw = np.unwrap(yaw_from_quat(table["root_quat"]))
    course["step"], course["turn"] = steps(table["root_pos"][:, :2], yaw, motion.cycle)
    course["root_z"] = table["root_pos"][:, 2]
    course["tilt"] = quat_multiply(quat_from_yaw(-yaw), table["root_quat"])
    for name in ("lin_vel", "ang_vel", "lin_acc", "ang_acc", "leg_lin_acc", "leg_ang_acc"):
        course[name] = turned_about_z(table[name], -yaw)
    course["foot"] = quat_rotate(course["tilt"][:, None], table["foot_pos"])
    course["foot"][..., 2] += course["root_z"][:, None]
    course["contact"], course["swung"] = table["contact"], table["swung"]
    course["sync"], course["gain"] = table["sync"], table["gain"]
    return course


_MARGIN: Final = 4  # rows of the motions before and after a transition, for interpolation
_OPTIMISED: Final = ("root_z", "lin_vel", "ang_vel", "foot")


@dataclass(frozen=True, eq=False)
class CourseTransition:
    """A transition between two cyclic motions: it leaves one before row `leave` ≥ 1 and enters the other at `arrive`.

    `course` (t,) of `COURSE` is for the controller, with `_MARGIN` rows of the motions at either end, `demonstration`
    for the score. Rows [first, last) are the transition itself. `gains` (g,) of `GAINS` are those that the rows name.
    """

    course: Records
    demonstration: Records
    first: int
    last: int
    leave: int
    arrive: int
    gains: Records


def make_course_transition(
    robot: Robot, before: Motion, after: Motion, regulator: RegulatorConfig
) -> CourseTransition | None:
    """The transition between two cyclic motions, optimised or not; None if no executable one joins them. It joins their
    demonstrations. An optimised motion's difference from its own is blended with the same weights."""
    try:
        cycles = [max(2, default_cycles(motion)) for motion in (before, after)]
        stitched = stitch_motions(robot, [before.target, after.target], cycles)
    except MotionError:
        return None
    layout = Layout.of(stitched)
    first, second = layout.segments
    assert second.rebuilt is not None
    start, end = second.rebuilt.start, second.rebuilt.end
    rows = np.arange(max(start - _MARGIN, 0), min(end + _MARGIN, layout.n))
    demonstration = course_of(stitched, robot)
    course = demonstration.copy()
    trunk, feet = layout.trunk_weights(), layout.foot_weights()
    for i, (segment, motion) in enumerate(zip((first, second), (before, after), strict=True)):
        if motion.demonstration is None:
            continue
        at = (np.arange(layout.n) - segment.shift) % motion.n_samples
        own, target = course_of(motion, robot), course_of(motion.target, robot)
        for name in _OPTIMISED:
            share = feet[i][..., None] if name == "foot" else trunk[i]
            change = (own[name] - target[name])[at]
            course[name] += (share if change.ndim in (1, 3) else share[:, None]) * change
    course, demonstration = course[rows], demonstration[rows]
    used = slice(int(course["gain"][0]), int(course["gain"][-1]) + 1)
    course["gain"] -= used.start
    return CourseTransition(
        course=course,
        demonstration=demonstration,
        first=start - int(rows[0]),
        last=end - int(rows[0]),
        leave=(start - 1) % before.n_samples + 1,
        arrive=(end - second.shift) % after.n_samples,
        gains=motion_gains(stitched, robot, regulator)[used],
    )


PLACE: Final = record_dtype([*floats(position=(), pose=3, jump=()), *integers(exit=(), entry=(), left=(), synced=())])
"""Position in a course: row `position` and (x, y, yaw) of its root in the world. Before row `exit` ≥ 1 it continues in
the next course at row `entry`; −1 for never. `left` and `synced` say whether the last step did so or started a cycle.
`jump` is the sum of the distances moved by synchronisation, m."""

WORK: Final = record_dtype(floats(dt=(), geometry=(4, 12), lower=12, upper=12, feet=(3, 4, 3), joints=(3, 12), tilt=4))
"""The control step, s, the robot's legs and joint limits, rad, and work memory."""


def make_place() -> Records:
    """A place at the start of a course, (1,) of `PLACE`."""
    place = np.zeros(1, PLACE)
    place["exit"] = -1
    return place


def make_work(robot: Robot, dt: float) -> Records:
    """Work memory (1,) of `WORK` for a robot and a control step of `dt` s."""
    work = np.zeros(1, WORK)
    work["dt"], work["geometry"] = dt, robot.geometry
    work["lower"], work["upper"] = robot.joint_lower, robot.joint_upper
    return work


@kernel
def advance_place(course: Any, following: Any, place: Any, tempo: float, follow: bool, x: float, y: float) -> None:
    """Advances a place by one control step in `course` (t,) of `COURSE` and the `following` one, sample by sample, so
    that exits and starts of cycles are met exactly. With `follow`, x and y are synchronised at the start of a cycle to
    the robot at (x, y), m. The feet advance by `tempo` samples, and the root goes on at its own pace."""
    place.left, place.synced = 0, 0
    remaining = tempo
    pose = place.pose
    while remaining > 0.0:
        here = course if place.left == 0 else following
        i = int(place.position)
        share = min(i + 1.0 - place.position, remaining)
        moved = share / tempo
        c, s = np.cos(pose[2]), np.sin(pose[2])
        pose[0] += moved * (c * here[i].step[0] - s * here[i].step[1])
        pose[1] += moved * (s * here[i].step[0] + c * here[i].step[1])
        pose[2] += moved * here[i].turn
        remaining -= share
        place.position += share
        if place.position < i + 1.0 - 1e-9:
            continue
        i += 1
        if place.left == 0 and i == place.exit:
            place.left = 1
            here, i = following, place.entry
        i %= here.shape[0]
        place.position = float(i)
        if follow and here[i].sync == 1:
            place.synced = 1
            place.jump += np.hypot(x - pose[0], y - pose[1])
            pose[0], pose[1] = x, y


@kernel
def fill_table(course: Any, following: Any, place: Any, work: Any, table: Any) -> None:
    """Writes the coming reference to a table (t,) of `SAMPLE`, in the root's present heading frame; uses `place` up."""
    x0, y0, yaw0 = place.pose[0], place.pose[1], place.pose[2]
    co, so = np.cos(yaw0), np.sin(yaw0)
    beyond = False
    for k in range(table.shape[0]):
        if k > 0:
            here = following if beyond else course
            if beyond:
                place.exit = -1
            advance_place(here, following, place, 1.0, False, 0.0, 0.0)
            beyond = beyond or place.left == 1
        dx, dy = place.pose[0] - x0, place.pose[1] - y0
        here = following if beyond else course
        exit_row = -1 if beyond or place.position > place.exit else place.exit
        _sample(here, following, exit_row, place.entry, place.position, k == 0, work, table[k])
        if k == 0:  # planning ahead needs only forces and feet
            put_joints(work, table[k])
        put_at(co * dx + so * dy, -so * dx + co * dy, place.pose[2] - yaw0, table[k])
        table[k].sync = place.synced if k > 0 else 0


@inlined
def _row(course: Any, following: Any, exit_row: int, entry: int, i: int) -> Any:
    """Row i of a course that repeats, or of the next course after the exit."""
    if exit_row >= 0 and i >= exit_row and i - exit_row < 8:
        return following[(entry + i - exit_row) % following.shape[0]]
    return course[i % course.shape[0]]


@kernel
def _feet(course: Any, following: Any, exit_row: int, entry: int, position: float, out: Array) -> None:
    """Feet (4, 3) at a position, heading frame of the root; cubic interpolation."""
    i = int(np.floor(position))
    u = position - i
    a = _row(course, following, exit_row, entry, i - 1)
    b = _row(course, following, exit_row, entry, i)
    c = _row(course, following, exit_row, entry, i + 1)
    d = _row(course, following, exit_row, entry, i + 2)
    for leg in range(4):
        for k in range(3):
            out[leg, k] = _cubic(a.foot[leg, k], b.foot[leg, k], c.foot[leg, k], d.foot[leg, k], u)


@inlined
def _blend(tilt: Array, later: Array, share: float, out: Array) -> None:
    """A share of the way from one unit quaternion to another, (4,) each."""
    same = 0.0
    for k in range(4):
        same += tilt[k] * later[k]
    sign = -1.0 if same < 0 else 1.0
    norm = 0.0
    for k in range(4):
        out[k] = tilt[k] + share * (sign * later[k] - tilt[k])
        norm += out[k] * out[k]
    norm = np.sqrt(norm)
    for k in range(4):
        out[k] /= norm


@inlined
def _cubic(p0: float, p1: float, p2: float, p3: float, u: float) -> float:
    """At a share `u` of the way from p1 to p2, with the slopes of central differences there."""
    m1, m2 = 0.5 * (p2 - p0), 0.5 * (p3 - p1)
    return p1 + u * (m1 + u * (3 * (p2 - p1) - 2 * m1 - m2 + u * (2 * (p1 - p2) + m1 + m2)))


@kernel
def _sample(
    course: Any, following: Any, exit_row: int, entry: int, position: float, neighbours: bool, work: Any, out: Any
) -> None:
    """One row of the table without joints and pose, in its root's heading frame; feet in `work`, with `neighbours` also
    those one control step before and after."""
    i = int(np.floor(position))
    u = position - i
    b = _row(course, following, exit_row, entry, i)
    c = _row(course, following, exit_row, entry, i + 1)
    out.root_pos[0], out.root_pos[1] = 0.0, 0.0
    out.root_pos[2] = b.root_z + u * (c.root_z - b.root_z)
    _blend(b.tilt, c.tilt, u, out.root_quat)
    for k in range(3):
        out.lin_vel[k] = b.lin_vel[k] + u * (c.lin_vel[k] - b.lin_vel[k])
        out.ang_vel[k] = b.ang_vel[k] + u * (c.ang_vel[k] - b.ang_vel[k])
        out.lin_acc[k] = b.lin_acc[k] + u * (c.lin_acc[k] - b.lin_acc[k])
        out.ang_acc[k] = b.ang_acc[k] + u * (c.ang_acc[k] - b.ang_acc[k])
        out.leg_lin_acc[k] = b.leg_lin_acc[k] + u * (c.leg_lin_acc[k] - b.leg_lin_acc[k])
        out.leg_ang_acc[k] = b.leg_ang_acc[k] + u * (c.leg_ang_acc[k] - b.leg_ang_acc[k])
    out.gain = b.gain
    out.contact, out.swung = b.contact, b.swung
    for k in range(3):
        if k != 1 and not neighbours:
            continue
        at = position + (k - 1)
        _feet(course, following, exit_row, entry, at, work.feet[k])
        low = int(np.floor(at))
        v = at - low
        p = _row(course, following, exit_row, entry, low)
        q = _row(course, following, exit_row, entry, low + 1)
        z = p.root_z + v * (q.root_z - p.root_z)
        for leg in range(4):
            to_body(p.tilt, q.tilt, v, z, work.tilt, work.feet[k, leg])
    for leg in range(4):
        copy(work.feet[1, leg], out.foot_pos[leg])


@inlined
def to_body(tilt: Array, later: Array, share: float, z: float, q: Array, foot: Array) -> None:
    """A foot (3,) from the root's heading frame (z from the ground) to its body frame; `q` (4,) is work memory."""
    _blend(tilt, later, share, q)
    back, above = (q[0], -q[1], -q[2], -q[3]), (foot[0], foot[1], foot[2] - z)
    foot[0], foot[1], foot[2] = quat_turned(back, above)


@kernel
def put_joints(work: Any, out: Any) -> None:
    """Joints by inverse kinematics; their velocity and acceleration by central differences."""
    dt = work.dt
    for k in range(3):
        for leg in range(4):
            foot = work.feet[k, leg]
            joints = leg_inverse(work.geometry[leg], foot[0], foot[1], foot[2])[:3]
            for i in range(3):
                j = 3 * leg + i
                work.joints[k, j] = min(max(joints[i], work.lower[j]), work.upper[j])
    for j in range(12):
        before, now, after = work.joints[0, j], work.joints[1, j], work.joints[2, j]
        out.joint_pos[j] = now
        out.joint_vel[j] = 0.5 * (after - before) / dt
        out.joint_acc[j] = (after - 2 * now + before) / (dt * dt)


@inlined
def put_at(x: float, y: float, yaw: float, out: Any) -> None:
    """Moves one row of the table from its root's heading frame to (x, y, yaw)."""
    if yaw == 0.0 and x == 0.0 and y == 0.0:
        return
    c, s = np.cos(yaw), np.sin(yaw)
    out.root_pos[0], out.root_pos[1] = x, y
    for v in (out.lin_vel, out.ang_vel, out.lin_acc, out.ang_acc, out.leg_lin_acc, out.leg_ang_acc):
        v[0], v[1] = c * v[0] - s * v[1], s * v[0] + c * v[1]
    q = out.root_quat
    q[0], q[1], q[2], q[3] = quat_about_z(yaw, q)
