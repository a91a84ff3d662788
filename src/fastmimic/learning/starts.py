"""Starts of episodes: on the reference motion at a random phase (reference-state initialisation), or slightly off
it."""

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from fastmimic.base.arrays import Array
from fastmimic.base.jit import kernel, record_dtype
from fastmimic.base.vectors import quat_to_matrix
from fastmimic.episode.plan import JOINT_NOISE, VELOCITY_NOISE
from fastmimic.robot.kinematics import leg_forward

DRAWS: Final = 16  # random numbers of a start: phase, 12 joints, 3 velocities

COUNT: Final = record_dtype([("steps", "i8"), ("limit", "i8"), ("scored", "f8")])
"""One robot's episode: policy steps so far, their limit, and the rewards of control steps paid out so far."""

PLACE: Final = record_dtype(
    [
        ("root_pos", "f8", (3,)),
        ("root_quat", "f8", (4,)),
        ("joint_pos", "f8", (12,)),
        ("lin_vel", "f8", (3,)),
        ("ang_vel_b", "f8", (3,)),
        ("joint_vel", "f8", (12,)),
    ]
)
"""One robot's start, world frame; angular velocity in the body frame."""

BODY: Final = record_dtype(
    [("geometry", "f8", (4, 12)), ("foot_radius", "f8"), ("lower", "f8", (12,)), ("upper", "f8", (12,))]
)
"""The robot's properties that determine a start."""


@kernel
def begin_episodes(
    body: Any,
    table: Any,
    rows: NDArray[np.int64],
    draws: Array,
    noise: float,
    room: int,
    steps: int,
    decimation: int,
    clocks: Any,
    senses: Any,
    counts: Any,
    places: Any,
    work: Array,
) -> None:
    """Places some robots on the reference motion at random phases, like the perturbed starts of `ClosedLoop`.

    Args:
        body: (1,) of `BODY`.
        table: (t,) of `SAMPLE`.
        rows: (k,) indices of the robots.
        draws: (k, 16) uniform in [0, 1): phase, joints, velocity.
        noise: 1 for starts off the reference motion, 0 for starts on it.
        room: number of samples where an episode may begin.
        clocks, senses, counts: (n,) records, changed in place.
        places: (k,) of `PLACE`, the result.
        work: (2, 3, 3) scratch.
    """
    for k in range(rows.shape[0]):
        i = rows[k]
        clock, count, place = clocks[i], counts[i], places[k]
        sample = min(int(draws[k, 0] * room), room - 1)
        _place(body[0], table[sample], clock, draws[k], noise, place, work[0])
        clock.sample, clock.cycle, clock.jump = sample, 0, 0.0
        count.steps, count.scored = 0, 0.0
        count.limit = steps if clock.repeats == 1 else min(steps, (table.shape[0] - 1 - sample) // decimation)
        senses[i].age = -1


@kernel
def _place(body: Any, ref: Any, clock: Any, draws: Array, noise: float, place: Any, rotation: Array) -> None:
    """The reference sample at the world's origin with heading 0, perturbed by `draws`, with all feet above the
    ground."""
    quat_to_matrix(ref.root_quat, rotation)
    yaw = -np.arctan2(rotation[1, 0], rotation[0, 0])
    c, s = np.cos(yaw), np.sin(yaw)
    x, y = ref.root_pos[0], ref.root_pos[1]
    clock.origin[0], clock.origin[1], clock.origin[2] = -(c * x - s * y), -(s * x + c * y), yaw
    q = ref.root_quat
    ch, sh = np.cos(0.5 * yaw), np.sin(0.5 * yaw)
    place.root_quat[0], place.root_quat[1] = ch * q[0] - sh * q[3], ch * q[1] - sh * q[2]
    place.root_quat[2], place.root_quat[3] = ch * q[2] + sh * q[1], ch * q[3] + sh * q[0]
    for j in range(12):
        joint = ref.joint_pos[j] + noise * JOINT_NOISE * (2 * draws[1 + j] - 1)
        place.joint_pos[j] = min(max(joint, body.lower[j]), body.upper[j])
        place.joint_vel[j] = ref.joint_vel[j]
    place.lin_vel[0] = c * ref.lin_vel[0] - s * ref.lin_vel[1]
    place.lin_vel[1] = s * ref.lin_vel[0] + c * ref.lin_vel[1]
    place.lin_vel[2] = ref.lin_vel[2]
    for a in range(3):
        place.lin_vel[a] += noise * VELOCITY_NOISE * (2 * draws[13 + a] - 1)
        # a turn about z changes the world, not the body's sensors
        place.ang_vel_b[a] = 0.0
        for b in range(3):
            place.ang_vel_b[a] += rotation[b, a] * ref.ang_vel[b]
    lowest = np.inf
    for leg in range(4):
        p = place.joint_pos[3 * leg : 3 * leg + 3]
        fx, fy, fz = leg_forward(body.geometry[leg], p[0], p[1], p[2])
        lowest = min(lowest, rotation[2, 0] * fx + rotation[2, 1] * fy + rotation[2, 2] * fz)
    place.root_pos[0], place.root_pos[1] = 0.0, 0.0
    place.root_pos[2] = max(ref.root_pos[2], body.foot_radius - lowest)
