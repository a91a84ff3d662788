"""The field's measures of motion tracking, summed while an episode runs: success, body positions, root, speeds.

They compare 13 points: the trunk's base and each leg's hip, knee and foot, the joints' centres in the leg's plane.
`docs/formulas.md` defines them and names their sources.
"""

from typing import Any, Final

import numpy as np

from fastmimic.base.arrays import Array, Records
from fastmimic.base.jit import floats, inlined, integers, record_dtype
from fastmimic.base.vectors import turned
from fastmimic.reference.table import next_period

POINTS: Final = 13
SUCCESS_DISTANCE: Final = 0.5  # m from the reference
SUCCESS_ANGLE: Final = 1.0  # rad from the reference
FRAME_S: Final = 1 / 30  # between the frames of the acceleration, nearest number of control steps

TRACKING_ERRORS: Final = record_dtype(
    [
        ("success", "?"),
        *floats(mpjpe_mm=(), mpbpe_root_mm=(), root_position_error_m=(), root_heading_error_rad=()),
        *floats(joint_velocity_error_rad_s=(), acceleration_distance=()),
    ]
)
"""Measures of an episode, means over its steps until a fall; NaN without any. `success`: no fall, and never more than
0.5 m or 1 rad from the reference that the reward sees. `root_position_error_m` and the acceleration are against the
reference that is never re-synchronised, all others against the one that the reward sees."""

TRACKING_SUMS: Final = [
    *floats(point_error=(), point_error_root=(), root_error=(), heading_error=(), joint_speed_error=()),
    *floats(acceleration_error=()),
    *integers(far=(), frames=()),  # steps too far from the reference, and frames of the acceleration
    *floats(moved=2, last_origin=3, course=(3, POINTS, 3)),
    *integers(last_cycle=()),
]
"""Fields of a tally: sums over the steps; by how far re-synchronisation has `moved` the reference, world, m; and the
points' errors now and in the last two frames, without these moves."""


@inlined
def count_tracking(context: Any, ref: Any, clock: Any, obs: Any, tally: Any, apart: tuple[Any, ...]) -> None:
    """Adds a step to a tally. Of the context's scratch memory, the first two (3, 3) are the rotations of the robot and
    of the reference; `apart` is the reference's position from the robot's, world, m, the angle between them, rad, and
    the squared difference of their joint velocities, (rad/s)²."""
    x, y, z, angle, speeds_sq = apart
    frames = context.work
    _follow_moves(clock, tally)
    distance_sq = x * x + y * y + z * z
    tally.far += distance_sq > SUCCESS_DISTANCE * SUCCESS_DISTANCE or angle > SUCCESS_ANGLE
    due_x, due_y = x - tally.moved[0], y - tally.moved[1]
    tally.root_error += np.sqrt(due_x * due_x + due_y * due_y + z * z)
    turn = np.arctan2(frames[1, 1, 0], frames[1, 0, 0]) - np.arctan2(frames[0, 1, 0], frames[0, 0, 0])
    tally.heading_error += abs(np.arctan2(np.sin(turn), np.cos(turn)))
    tally.joint_speed_error += np.sqrt(speeds_sq)
    _compare_points(context, ref, obs, tally, x, y, z)
    _count_acceleration(tally, max(1, int(FRAME_S / context.dt + 0.5)), context.dt)


@inlined
def _follow_moves(clock: Any, tally: Any) -> None:
    """Adds what re-synchronisation has moved the reference since the last step."""
    if tally.steps > 0:
        x, y = tally.last_origin[0], tally.last_origin[1]
        if clock.cycle != tally.last_cycle:
            x, y, _ = next_period(clock, x, y, tally.last_origin[2])
        tally.moved[0] += clock.origin[0] - clock.held[0] - x
        tally.moved[1] += clock.origin[1] - clock.held[1] - y
    for k in range(2):
        tally.last_origin[k] = clock.origin[k] - clock.held[k]
    tally.last_origin[2] = clock.origin[2]
    tally.last_cycle = clock.cycle


@inlined
def _compare_points(context: Any, ref: Any, obs: Any, tally: Any, x: float, y: float, z: float) -> None:
    """Errors of all points, in the world and relative to the root."""
    geometry, frames = context.geometry, context.work
    _put(tally, 0, x, y, z)
    tally.point_error += np.sqrt(x * x + y * y + z * z) / POINTS
    for leg in range(4):
        q, due = obs.joint_pos[3 * leg : 3 * leg + 3], ref.joint_pos[3 * leg : 3 * leg + 3]
        own, wanted = _leg_points(geometry[leg], q), _leg_points(geometry[leg], due)
        for k in range(3):
            here, due_there = turned(frames[0], *own[k]), turned(frames[1], *wanted[k])
            dx, dy, dz = due_there[0] - here[0], due_there[1] - here[1], due_there[2] - here[2]
            tally.point_error_root += np.sqrt(dx * dx + dy * dy + dz * dz) / (POINTS - 1)
            dx, dy, dz = dx + x, dy + y, dz + z
            tally.point_error += np.sqrt(dx * dx + dy * dy + dz * dz) / POINTS
            _put(tally, 1 + 3 * leg + k, dx, dy, dz)


@inlined
def _put(tally: Any, point: int, x: float, y: float, z: float) -> None:
    """Keeps a point's error from the reference that is never re-synchronised."""
    tally.course[0, point, 0], tally.course[0, point, 1] = x - tally.moved[0], y - tally.moved[1]
    tally.course[0, point, 2] = z


@inlined
def _leg_points(g: Array, q: Array) -> tuple[tuple[float, float, float], ...]:
    """Hip, knee and foot of a leg, body frame, m; `g` is its row of `Robot.geometry`."""
    ca, sa, ch, sh, ck, sk = np.cos(q[0]), np.sin(q[0]), np.cos(q[1]), np.sin(q[1]), np.cos(q[2]), np.sin(q[2])
    knee_x, knee_z = g[4] + ch * g[6] + sh * g[7], g[5] - sh * g[6] + ch * g[7]
    calf_x, calf_z = ck * g[8] + sk * g[9], ck * g[9] - sk * g[8]
    foot_x, foot_z = knee_x + ch * calf_x + sh * calf_z, knee_z - sh * calf_x + ch * calf_z
    return (
        (g[0] + g[4], g[1] + ca * g[3] - sa * g[5], g[2] + sa * g[3] + ca * g[5]),
        (g[0] + knee_x, g[1] + ca * g[3] - sa * knee_z, g[2] + sa * g[3] + ca * knee_z),
        (g[0] + foot_x, g[1] + ca * g[3] - sa * foot_z, g[2] + sa * g[3] + ca * foot_z),
    )


@inlined
def _count_acceleration(tally: Any, spacing: int, dt: float) -> None:
    """At each frame, the second difference of the points' errors over three frames, which is that of accelerations."""
    if tally.steps % spacing != 0:
        return
    if tally.steps >= 2 * spacing:
        tally.frames += 1
    course = tally.course
    for point in range(POINTS):
        total = 0.0
        for axis in range(3):
            now, before, earlier = course[0, point, axis], course[1, point, axis], course[2, point, axis]
            d = now - 2.0 * before + earlier
            total += d * d
            course[2, point, axis], course[1, point, axis] = before, now
        if tally.steps >= 2 * spacing:
            tally.acceleration_error += np.sqrt(total) / (POINTS * (spacing * dt) ** 2)


def tracking_errors(tallies: Records) -> Records:
    """The measures (n,) of `TRACKING_ERRORS` of episodes, or of parts of them, from their tallies (n,)."""
    steps = np.where(tallies["steps"] > 0, tallies["steps"], np.nan)
    found = np.zeros(len(tallies), TRACKING_ERRORS)
    found["success"] = (tallies["fallen"] == 0) & (tallies["far"] == 0)
    found["mpjpe_mm"] = 1e3 * tallies["point_error"] / steps
    found["mpbpe_root_mm"] = 1e3 * tallies["point_error_root"] / steps
    found["root_position_error_m"] = tallies["root_error"] / steps
    found["root_heading_error_rad"] = tallies["heading_error"] / steps
    found["joint_velocity_error_rad_s"] = tallies["joint_speed_error"] / steps
    frames = np.where(tallies["frames"] > 0, tallies["frames"], np.nan)
    found["acceleration_distance"] = tallies["acceleration_error"] / frames
    return found
