"""Recovery steps: when no step of the motion can catch a pushed robot, it trots until one can.

A trot is begun where the capture point leaves the reach of the next foot, if that foot is on one side alone: a foot of
the other side may have to step first. The motion goes on meanwhile, and is taken up again when the robot is calm and
its feet are where the motion's are.

The trot has the motion's own mean velocity and posture. A motion's schedule may have the wrong leg stand: a pace that
is pushed over its standing side would have to cross its legs, and a walk has three feet on the ground. In a trot each
next step can be taken in any direction. Its table and the regulator's gains along it are those of any reference motion.
"""

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from fastmimic.base.arrays import Records
from fastmimic.base.conventions import GRAVITY
from fastmimic.base.jit import inlined, kernel
from fastmimic.base.rotations import (
    matrix_from_quat,
    quat_conjugate,
    quat_from_yaw,
    quat_multiply,
    quat_rotate,
    rotate_planar,
    turned_about_z,
    yaw_from_quat,
)
from fastmimic.base.vectors import heading_of, quat_to_matrix, turn_rows
from fastmimic.motion.limits import differentiate, pad
from fastmimic.motion.motion import Motion
from fastmimic.reference.regulator import GAINS, motion_gains
from fastmimic.reference.regulator_config import RegulatorConfig
from fastmimic.reference.table import SAMPLE, once, put_root_at, reference_table
from fastmimic.robot import Robot
from fastmimic.robot.kinematics import foot_positions, inverse_kinematics

LOOK_S: Final = 0.15  # how far ahead the capture point is looked at, at most
ONE_SIDED: Final = 0.5  # share of the landing feet that are on one side more than on the other
LATE_S: Final = 0.12  # with less than three feet on the ground, one that lands sooner is waited for
NARROW_M: Final = 0.02  # least reach across; lengths are an A1's
CALM: Final = 0.6  # share of the reach within which a robot is back
LEAST_S: Final = 0.35  # of a recovery
NEAR_M: Final = 0.07  # how far feet and motion may be apart when it is taken up again
PATIENCE_S: Final = 0.3  # in which this distance grows by itself
VELOCITY_S: Final = 0.15  # by which a difference in velocity counts as a distance
UPRIGHT: Final = 2.0  # by which a difference in a foot's height counts more
SWINGING: Final = 0.25  # share of the distance of a foot that lifts off at once
UNLIKE_M: Final = 0.02  # that another leg state counts
LOADED_M: Final = 0.03  # that a foot counts which carries everything and lifts off soon
SOON_S: Final = 0.03
WITHIN_S: Final = 0.5  # how far from its own time a motion is taken up again
EACH_S: Final = 0.008  # from one that is tried to the next
RECOVERS, LEAVES = 1, 2  # states of a recovery; in the last step of it the motion is told where it is taken up


@inlined
def find_urgency(config: Any, ref: Any, gain: Any, memory: Any, scratch: Any, x: float, y: float) -> None:
    """How far the capture point, now at (x, y) from the reference's, will be off at the next touch-down, as a share of
    what a foot can reach; 0 while it is between three feet or more."""
    rate = np.sqrt(GRAVITY / ref.root_pos[2])
    growth = np.exp(rate * min(gain.landing / (1.0 + config.most_haste), LOOK_S))
    reach = config.recovery_reach
    across = reach[1] + gain.side * reach[2] * (1.0 if y > 0.0 else -1.0)
    memory.urgency = growth * np.hypot(x / reach[0], y / max(across, NARROW_M * config.size))
    if _supported(memory, scratch, scratch.lin_vel[0] / rate, scratch.lin_vel[1] / rate):
        memory.urgency = 0.0


@inlined
def _supported(memory: Any, scratch: Any, x: float, y: float) -> bool:
    """Whether a point (from the centre of mass, heading frame, m) is between at least three standing feet."""
    if _standing(memory) < 3:
        return False
    first, last = -1, -1
    for leg in (0, 1, 3, 2):  # anticlockwise
        if memory.stance[leg] == 0:
            continue
        if last >= 0 and not _left_of(scratch.arms[last], scratch.arms[leg], x, y):
            return False
        first = leg if first < 0 else first
        last = leg
    return _left_of(scratch.arms[last], scratch.arms[first], x, y)


@inlined
def _left_of(a: Any, b: Any, x: float, y: float) -> bool:
    return (b[0] - a[0]) * (y - a[1]) - (b[1] - a[1]) * (x - a[0]) > 0.0


@inlined
def _standing(memory: Any) -> int:
    return memory.stance[0] + memory.stance[1] + memory.stance[2] + memory.stance[3]


@kernel
def begin_or_end_recovery(
    config: Any, table: Any, clock: Any, gain: Any, trot: Any, own: Any, obs: Any, memory: Any, scratch: Any
) -> bool:
    """Whether the robot changes between its motion, `table` (t,) of `SAMPLE`, and its `trot` (m,) at clock `own`."""
    if memory.recovering == 0:
        waits = _standing(memory) < 3 and gain.landing <= LATE_S
        fast = np.hypot(trot[0].lin_vel[0], trot[0].lin_vel[1]) > config.recovery_top_speed
        if not memory.urgency > 1.0 or abs(gain.side) <= ONE_SIDED or waits or fast:
            return False
        memory.recovering, memory.since_recovery, memory.calm = RECOVERS, 0.0, 0.0
        _begin(config, table[clock.sample], clock, trot, own, obs, memory, scratch)
        return True
    if memory.recovering == LEAVES:
        memory.recovering = 0
        for leg in range(4):  # one that has just landed may have to swing at once
            memory.since_switch[leg] = max(memory.since_switch[leg], config.min_switch_time)
        return True
    memory.since_recovery += config.dt
    memory.calm = memory.calm + config.dt if memory.urgency < CALM else 0.0
    if memory.since_recovery >= LEAST_S and memory.calm > 0.0:
        near = config.size * NEAR_M * (1.0 + memory.calm / PATIENCE_S)
        sample = _taken_up_at(config, table, clock, obs, memory, scratch, near * near)
        if sample >= 0:
            memory.recovering, memory.taken_up = LEAVES, sample
    return False


@inlined
def _begin(config: Any, ref: Any, clock: Any, trot: Any, own: Any, obs: Any, memory: Any, scratch: Any) -> None:
    """Puts the trot's clock at the sample whose feet are as high as the robot's, and that lifts unloaded feet next."""
    n, weight, tilt = trot.shape[0], 1.0, scratch.candidate
    soon = int(SOON_S / config.dt)
    quat_to_matrix(trot[0].root_quat, tilt)  # the heading does not count
    for leg in range(4):
        weight += max(obs.foot_force[leg, 2], 0.0)
    best, least = 0, np.inf
    for k in range(n):
        row, cost = trot[k], 0.0
        for leg in range(4):
            height = obs.root_pos[2] - row.root_pos[2]
            for a in range(3):
                height += scratch.rotation[2, a] * scratch.feet[leg, a]
                height -= tilt[2, a] * row.foot_pos[leg, a]
            cost += height * height
            if row.contact[leg] != memory.stance[leg]:
                cost += (config.size * UNLIKE_M) ** 2
            if memory.stance[leg] == 1 and trot[(k + soon) % n].contact[leg] == 0:
                cost += (config.size * LOADED_M) ** 2 * max(obs.foot_force[leg, 2], 0.0) / weight
        if cost < least:
            best, least = k, cost
    own.sample, own.repeats = best, 1
    own.part = own.ahead = 0.0
    turn = heading_of(trot[n - 1].root_quat) - heading_of(trot[0].root_quat)
    own.cycle_step[2] = turn * n / (n - 1)
    own.origin[2] = clock.origin[2] + heading_of(ref.root_quat) - heading_of(trot[best].root_quat)
    put_root_at(own, trot, obs.root_pos[0], obs.root_pos[1])


@inlined
def _taken_up_at(config: Any, table: Any, clock: Any, obs: Any, memory: Any, scratch: Any, most: float) -> int:
    """The sample of a motion that is nearest to the robot, not farther than `most`, m², or −1. Of a motion that repeats
    those within half a second count, of another one the present one alone."""
    n, best, least = table.shape[0], -1, most
    away = 0 if clock.repeats == 0 else min(int(WITHIN_S / config.dt), n // 2)
    for d in range(-away, away + 1, max(1, int(EACH_S / config.dt))):
        k = (clock.sample + d) % n
        cost = _mismatch(table[k], obs, memory, scratch)
        if cost < least:
            best, least = k, cost
    return best


@inlined
def _mismatch(row: Any, obs: Any, memory: Any, scratch: Any) -> float:
    """Squared distance of a robot from a sample, m²: of the feet that stand here or there, of all feet's heights, and
    of the velocity, in the heading frame of each. A foot that stands only there is out of the question."""
    rotation = scratch.candidate
    quat_to_matrix(row.root_quat, rotation)
    yaw = np.arctan2(rotation[1, 0], rotation[0, 0])
    c, s = np.cos(yaw), np.sin(yaw)
    turn_rows(c, -s, rotation)
    x = c * row.lin_vel[0] + s * row.lin_vel[1] - scratch.lin_vel[0]
    y = c * row.lin_vel[1] - s * row.lin_vel[0] - scratch.lin_vel[1]
    cost = VELOCITY_S**2 * (x * x + y * y)
    for leg in range(4):
        if row.contact[leg] == 1 and memory.stance[leg] == 0:
            return np.inf
        for k in range(3):
            d = obs.root_pos[2] - row.root_pos[2] if k == 2 else 0.0
            for a in range(3):
                d += scratch.rotation[k, a] * scratch.feet[leg, a] - rotation[k, a] * row.foot_pos[leg, a]
            if k == 2:
                cost += (UPRIGHT * d) ** 2
            elif memory.stance[leg] == 1:
                cost += d * d if row.contact[leg] == 1 else SWINGING * d * d
    return cost


STEP_S: Final = 0.16  # from one pair's touch-down to the other's
SWING_S: Final = 0.135
HEIGHT_M: Final = 0.05  # of the swings of an A1
PIECE_S: Final = 1.0  # of a passage, over which it has one mean


NO_RECOVERY: Final = np.zeros((1, 1), SAMPLE), np.zeros((1, 1), GAINS)


@once
def recovery_gaits(motion: Motion, robot: Robot, config: RegulatorConfig) -> tuple[Records, Records]:
    """Tables (p, m) of `SAMPLE` and gains (p, g) of `GAINS`: a trot for a cycle, one for each second of a passage."""
    count = 1 if motion.cycle is not None else max(1, round(motion.period_s / PIECE_S))
    trots = [_trot(motion, part, robot) for part in np.array_split(np.arange(motion.n_samples), count)]
    tables = [reference_table(trot, robot) for trot in trots]
    return np.stack(tables), np.stack([motion_gains(trot, robot, config) for trot in trots])


def _trot(motion: Motion, part: NDArray[np.int_], robot: Robot) -> Motion:
    """A trot with the mean velocity, height, tilt and footprint of a part of a motion."""
    quat = motion.root_quat_wxyz[part]
    yaw = yaw_from_quat(quat)
    velocity = turned_about_z(motion.root_lin_vel_w[part], -yaw).mean(axis=0)[:2]
    turning = float(motion.root_ang_vel_w[part, 2].mean())
    level = quat_multiply(quat_from_yaw(-yaw), quat)
    tilt = np.sum(level * np.sign(level[:, :1]), axis=0)
    tilt /= np.linalg.norm(tilt)
    feet = quat_rotate(level[:, None], motion.foot_pos_b[part])[..., :2]
    stands = motion.contact[part][..., None]
    hips = robot.hip_pos_b[:, :2] + np.column_stack([np.zeros(4), robot.lateral_offset])
    counted = stands.sum(axis=0)
    home = np.where(counted > 0, (feet * stands).sum(axis=0) / np.maximum(counted, 1), hips)
    home += (matrix_from_quat(tilt) @ robot.com_b)[:2] - home.mean(axis=0)

    half = round(STEP_S * motion.rate_hz)
    n, swing = 2 * half, SWING_S * motion.rate_hz
    since = (np.arange(n)[:, None] - half * np.array([0, 1, 1, 0])) % n  # samples since lift-off, (n, 4)
    contact = since >= swing
    against = -(velocity + turning * np.column_stack([-home[:, 1], home[:, 0]]))  # velocity of a standing foot
    stance_s = (n - swing) / motion.rate_hz
    stood = (since - swing) / (n - swing)
    swung = np.clip(since / swing, 0.0, 1.0)
    place = np.where(contact, stood - 0.5, 0.5 - swung**3 * (10 - 15 * swung + 6 * swung**2))
    height = float(motion.root_pos_w[part, 2].mean())
    foot = np.zeros((n, 4, 3))
    foot[..., :2] = home + stance_s * place[..., None] * against
    lift = HEIGHT_M * robot.leg_length / 0.4
    foot[..., 2] = robot.foot_radius - height + np.where(contact, 0.0, lift * np.sin(np.pi * swung) ** 2)
    joints = np.unwrap(inverse_kinematics(robot, quat_rotate(quat_conjugate(tilt), foot))[0], axis=0)
    heading = turning * motion.dt * np.arange(n + 1, dtype=np.float64)
    path = np.concatenate([np.zeros((1, 2)), np.cumsum(rotate_planar(heading[:-1], velocity) * motion.dt, axis=0)])
    return Motion(
        rate_hz=motion.rate_hz,
        root_pos_w=np.column_stack([path[:-1], np.full(n, height)]),
        root_quat_wxyz=quat_multiply(quat_from_yaw(heading[:-1]), np.tile(tilt, (n, 1))),
        joint_pos=joints,
        joint_vel=differentiate(pad(joints, True), motion.dt),
        foot_pos_b=foot_positions(robot, joints),
        contact=contact,
        root_lin_vel_w=np.column_stack([rotate_planar(heading[:-1], velocity), np.zeros(n)]),
        root_ang_vel_w=np.tile([0.0, 0.0, turning], (n, 1)),
        cycle=np.array([*path[-1], heading[-1]]),
    )
