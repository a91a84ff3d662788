"""Computes the joints from trunk and foot paths: base height, inverse kinematics, limits, velocities."""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from scipy.ndimage import gaussian_filter1d, maximum_filter1d

from fastmimic.base.arrays import Array, Flags
from fastmimic.base.rotations import (
    quat_conjugate,
    quat_continuous,
    quat_from_yaw,
    quat_multiply,
    quat_rotate,
    quat_rotate_inverse,
    trunk_quaternion,
)
from fastmimic.motion.limits import differentiate, pad
from fastmimic.motion.motion import Motion
from fastmimic.retargeting.config import RetargetConfig
from fastmimic.retargeting.track import TrunkTrack
from fastmimic.robot import Robot
from fastmimic.robot.kinematics import foot_positions, inverse_kinematics

_STEP_M: Final = 0.005
_RISE_S: Final = 0.1  # the base rises for folded legs within this time, and stays up as long before and after


@dataclass(frozen=True, eq=False)
class Pose:
    """The robot's configuration, sample by sample, within its joint limits."""

    root_pos_w: Array  # (t, 3) m
    root_quat_wxyz: Array  # (t, 4)
    joint_pos: Array  # (t, 12) rad
    foot_pos_b: Array  # (t, 4, 3) m, the feet of those joints
    unreachable: Flags  # (t, 4) samples in which a leg was too short or too long
    limited: Flags  # (t, 12) samples in which a joint was held at its limit
    lowered_m: float = 0.0  # distance by which the base was lowered for reach


def solve_pose(
    robot: Robot, track: TrunkTrack, feet_w: Array, height: float, config: RetargetConfig, max_raising: float
) -> Pose:
    """Inverse kinematics with the base moved by a constant from its mean `height`, m, over feet (t, 4, 3), world, m. It
    is lowered until every foothold is in reach, at most `config.max_lowering_m`, or raised until folded legs keep their
    limits and knees their clearance, at most `max_raising` m."""
    lower, upper = _limits(robot, config)
    rest = track.root_z - track.root_z.mean() + height
    quat = trunk_quaternion(track.heading, track.tilt)

    def violation_at(lowering: float) -> tuple[float, float]:
        """Of all limits, rad, and the part that raising the base would reduce."""
        q, reachable = _joints(robot, track, quat, feet_w, height - lowering)
        folded, knees = _folding(robot, quat, q, rest - lowering, config)
        limits = np.maximum(lower - q, 0) + np.maximum(q - upper, 0)
        return float(limits.sum() + np.sum(~reachable) + knees.sum()), float(folded.sum() + knees.sum())

    least, best = np.inf, 0.0
    up = round(max_raising / _STEP_M) if violation_at(0.0)[1] > 0 else 0
    steps = np.arange(-up, round(config.max_lowering_m / _STEP_M) + 1)
    for lowering in _STEP_M * steps[np.argsort(np.abs(steps), kind="stable")]:
        violation = violation_at(lowering)[0]
        if violation < least:
            least, best = violation, float(lowering)
        if violation == 0:
            break
    return replace(pose_at(robot, track, feet_w, height - best, (lower, upper)), lowered_m=best)


def folding_rise(
    robot: Robot, track: TrunkTrack, feet_w: Array, height: float, config: RetargetConfig, rate_hz: float
) -> Array:
    """The rise (t,) of the base, m, that keeps folded legs within their limits and knees off the ground. It is the
    least in steps of 5 mm, at most `config.max_raising_m`, and smooth. Arguments as in `solve_pose`."""
    quat = trunk_quaternion(track.heading, track.tilt)
    rest = track.root_z - track.root_z.mean() + height
    least, best = np.full(len(rest), np.inf), np.zeros(len(rest))
    for rise in _STEP_M * np.arange(round(config.max_raising_m / _STEP_M) + 1):
        q, _ = _joints(robot, track, quat, feet_w, height + rise)
        folded, knees = _folding(robot, quat, q, rest + rise, config)
        violation = folded.sum(axis=1) + knees.sum(axis=1)
        better = violation < least - 1e-9
        least[better], best[better] = violation[better], rise
    wide = 2 * round(_RISE_S * rate_hz) + 1
    wide_rise = maximum_filter1d(best, wide, mode="nearest")
    return np.asarray(gaussian_filter1d(wide_rise, 0.5 * _RISE_S * rate_hz, mode="nearest"))


def _limits(robot: Robot, config: RetargetConfig) -> tuple[Array, Array]:
    return robot.joint_lower + config.limit_margin_rad, robot.joint_upper - config.limit_margin_rad


def _folding(robot: Robot, quat: Array, q: Array, base_z: Array, config: RetargetConfig) -> tuple[Array, Array]:
    """Excess (t, 4) of each knee's fold over its limit, rad, and missing clearance, share of the calf's length."""
    lower, upper = _limits(robot, config)
    beyond, below = np.maximum(q - upper, 0)[:, 2::3], np.maximum(lower - q, 0)[:, 2::3]
    height = _knee_height(robot, quat, q) + base_z[:, None]
    lacking = np.maximum(robot.foot_radius + config.knee_clearance_m - height, 0) / robot.calf_length
    return np.where(robot.knee_sign > 0, beyond, below), lacking


def pose_at(
    robot: Robot, track: TrunkTrack, feet_w: Array, height: float, limits: tuple[Array, Array] | None = None
) -> Pose:
    """Like `solve_pose` at one height; smooth in its arguments without joint `limits` (12,), rad."""
    quat = trunk_quaternion(track.heading, track.tilt)
    q, reachable = _joints(robot, track, quat, feet_w, height)
    joints = q if limits is None else np.clip(q, *limits)
    return Pose(
        root_pos_w=_root(track, height),
        root_quat_wxyz=quat_continuous(quat),
        joint_pos=joints,
        foot_pos_b=foot_positions(robot, joints),
        unreachable=~reachable,
        limited=joints != q,
    )


def _root(track: TrunkTrack, height: float) -> Array:
    z = track.root_z - track.root_z.mean() + height
    return np.concatenate([track.root_xy, z[:, None]], axis=1)


def _joints(robot: Robot, track: TrunkTrack, quat: Array, feet_w: Array, height: float) -> tuple[Array, Flags]:
    foot_b = quat_rotate_inverse(quat[:, None], feet_w - _root(track, height)[:, None])
    return inverse_kinematics(robot, foot_b)


def _knee_height(robot: Robot, quat: Array, joints: Array) -> Array:
    """Height of the knees (t, 4) above the base, m."""
    abduction, hip = joints[:, 0::3], joints[:, 1::3]
    x, z = robot.thigh_vector[:, 0], robot.thigh_vector[:, 2]
    forward = robot.hip_shift[:, 0] + np.cos(hip) * x + np.sin(hip) * z
    up = robot.hip_shift[:, 1] - np.sin(hip) * x + np.cos(hip) * z
    left = np.cos(abduction) * robot.lateral_offset - np.sin(abduction) * up
    up = np.sin(abduction) * robot.lateral_offset + np.cos(abduction) * up
    knee_b = robot.hip_pos_b + np.stack([forward, left, up], axis=-1)
    return np.asarray(quat_rotate(quat[:, None], knee_b)[..., 2])


def motion_of(pose: Pose, track: TrunkTrack, contact: Flags, rate_hz: float) -> Motion:
    """The motion of a pose and its contacts (t, 4), with velocities, without provenance."""
    paths = pose.root_pos_w, pose.root_quat_wxyz, pose.joint_pos
    position, quat, joint_pos = (pad(values, track.cycle is not None) for values in paths)
    if track.cycle is not None:
        turn = quat_from_yaw(track.cycle[2])
        for rows, cycles in ((slice(0, 2), -1), (slice(-2, None), 1)):
            position[rows, :2] = track.moved(position[rows, :2], cycles)
            quat[rows] = quat_multiply(turn if cycles > 0 else quat_conjugate(turn), quat[rows])
    quat = quat_continuous(quat)
    rate = quat_multiply(differentiate(quat, 1.0 / rate_hz), quat_conjugate(quat[2:-2]))
    return Motion(
        rate_hz=rate_hz,
        root_pos_w=pose.root_pos_w,
        root_quat_wxyz=pose.root_quat_wxyz,
        joint_pos=pose.joint_pos,
        joint_vel=differentiate(joint_pos, 1.0 / rate_hz),
        foot_pos_b=pose.foot_pos_b,
        contact=contact,
        root_lin_vel_w=differentiate(position, 1.0 / rate_hz),
        root_ang_vel_w=2.0 * rate[:, 1:],
        cycle=track.cycle,
    )
