"""Recovery steps: a trot at a motion's own mean velocity and posture, which a robot takes when it is pushed out of it.

A motion's schedule may have the wrong leg stand: a pace that is pushed over its standing side would have to cross its
legs, and a walk has three feet on the ground. In a trot each next step can be taken in any direction. Its table and the
regulator's gains along it are those of any reference motion.
"""

from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

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
from fastmimic.motion.ground import differentiate, pad
from fastmimic.motion.motion import Motion
from fastmimic.reference.regulator import GAINS, regulator_gains
from fastmimic.reference.regulator_config import RegulatorConfig
from fastmimic.reference.table import SAMPLE, once, reference_table
from fastmimic.robot import Robot
from fastmimic.robot.kinematics import foot_positions, inverse_kinematics

STEP_S: Final = 0.16  # from one pair's touch-down to the other's
SWING_S: Final = 0.135
HEIGHT_M: Final = 0.05  # of the swings of an A1
PIECE_S: Final = 1.0  # of a passage, over which it has one mean


class RecoveryGaits(NamedTuple):
    """For each piece of a motion its trot: tables (p, m) of `SAMPLE` and gains (p, g) of `GAINS`."""

    tables: NDArray[Any]
    gains: NDArray[Any]


NO_RECOVERY: Final = RecoveryGaits(np.zeros((1, 1), SAMPLE), np.zeros((1, 1), GAINS))


@once
def recovery_gaits(motion: Motion, robot: Robot, config: RegulatorConfig) -> RecoveryGaits:
    """The trots of a motion's demonstration: one for a cycle, one for each second of a passage."""
    count = 1 if motion.cycle is not None else max(1, round(motion.period_s / PIECE_S))
    trots = [_trot(motion, part, robot) for part in np.array_split(np.arange(motion.n_samples), count)]
    tables = [reference_table(trot, robot) for trot in trots]
    gains = [
        regulator_gains(table, robot, config, motion.dt, float(trot.cycle[2]))  # type: ignore[index]
        for table, trot in zip(tables, trots, strict=True)
    ]
    return RecoveryGaits(np.stack(tables), np.stack(gains))


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
