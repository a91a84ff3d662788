"""Small exact motions for the tests of the closed loop: feet planted in the world, the body on a constant twist."""

import dataclasses

import numpy as np

from fastmimic.base.rotations import quat_from_yaw, quat_multiply, rotate_planar, yaw_from_quat
from fastmimic.motion.motion import Motion
from fastmimic.motion.provenance import Provenance
from fastmimic.robot import Robot
from fastmimic.robot.kinematics import foot_positions, inverse_kinematics

RATE_HZ = 500.0
TROT = (0.0, 0.5, 0.5, 0.0)
"""When each leg touches down, in periods: the diagonal pairs alternate."""


def standing(robot: Robot, n_samples: int = 100) -> Motion:
    """The home pose, feet on the ground, not moving."""
    return gait(robot, n_samples=n_samples, duty=1.0)


def gait(
    robot: Robot,
    velocity: tuple[float, float] = (0.0, 0.0),
    yaw_rate: float = 0.0,
    *,
    n_samples: int = 250,
    duty: float = 0.6,
    lift: float = 0.05,
    touchdown: tuple[float, ...] = TROT,
    yaw0: float = 0.0,
) -> Motion:
    """A periodic gait: every foot stands still in the world during its stance and lands under its home position.

    The body moves with a constant velocity (body axes) and yaw rate at constant height.
    """
    dt = 1.0 / RATE_HZ
    period = n_samples * dt
    home = foot_positions(robot, robot.home_joint_pos)
    height = robot.foot_radius - float(home[:, 2].mean())
    time = dt * np.arange(n_samples)
    xy, yaw = _body(time, velocity, yaw_rate, yaw0)
    feet_b = np.tile(home, (n_samples, 1, 1))
    contact = np.ones((n_samples, 4), dtype=bool)
    for leg in range(4):
        share = (time / period - touchdown[leg]) % 1.0
        landed = time - share * period  # of the step that this sample belongs to
        contact[:, leg] = share < duty
        swing = np.clip((share - duty) / (1.0 - duty), 0.0, 1.0) if duty < 1.0 else np.zeros(n_samples)
        holds = [_foothold(landed + (k + 0.5 * duty) * period, home[leg], velocity, yaw_rate, yaw0) for k in (0, 1)]
        smooth = swing - np.sin(2 * np.pi * swing) / (2 * np.pi)
        foot_w = holds[0] + smooth[:, None] * (holds[1] - holds[0])
        if duty < 1.0:
            feet_b[:, leg, :2] = rotate_planar(-yaw, foot_w - xy)
        feet_b[:, leg, 2] = robot.foot_radius - height + lift * 0.5 * (1 - np.cos(2 * np.pi * swing))
    joints, reachable = inverse_kinematics(robot, feet_b)
    assert reachable.all()
    end_xy, end_yaw = _body(np.array([period]), velocity, yaw_rate, yaw0)
    ones = np.ones(n_samples)
    return Motion(
        rate_hz=RATE_HZ,
        root_pos_w=np.column_stack([xy, height * ones]),
        root_quat_wxyz=quat_from_yaw(yaw),
        joint_pos=joints,
        joint_vel=(np.roll(joints, -1, axis=0) - np.roll(joints, 1, axis=0)) * (RATE_HZ / 2),
        foot_pos_b=feet_b,
        contact=contact,
        root_lin_vel_w=np.column_stack([rotate_planar(yaw, np.tile(velocity, (n_samples, 1))), 0 * ones]),
        root_ang_vel_w=np.column_stack([0 * ones, 0 * ones, yaw_rate * ones]),
        cycle=np.array([*rotate_planar(-yaw0, end_xy[0] - xy[0]), end_yaw[0] - yaw0]),
        provenance=Provenance("synthetic", robot.name),
    )


def turned(motion: Motion, yaw: float, shift: tuple[float, float] = (0.0, 0.0)) -> Motion:
    """The same motion in a world turned by `yaw` about z and shifted."""

    def planar(v: np.ndarray) -> np.ndarray:
        return np.column_stack([rotate_planar(yaw, v[:, :2]), v[:, 2]])

    return dataclasses.replace(
        motion,
        root_pos_w=planar(motion.root_pos_w) + np.array([*shift, 0.0]),
        root_quat_wxyz=quat_multiply(quat_from_yaw(yaw)[None], motion.root_quat_wxyz),
        root_lin_vel_w=planar(motion.root_lin_vel_w),
        root_ang_vel_w=planar(motion.root_ang_vel_w),
    )


def feet_w(motion: Motion) -> np.ndarray:
    """(t, 4, 3) feet in the world of a motion whose body stays level."""
    yaw = yaw_from_quat(motion.root_quat_wxyz)
    out = np.array(motion.foot_pos_b)
    out[..., :2] = rotate_planar(yaw[:, None], out[..., :2])
    return out + motion.root_pos_w[:, None]


def _body(
    time: np.ndarray, velocity: tuple[float, float], yaw_rate: float, yaw0: float
) -> tuple[np.ndarray, np.ndarray]:
    """Position (t, 2) and heading (t,) of a body that moves with a constant twist."""
    angle = yaw_rate * time
    along = time * np.sinc(angle / np.pi)  # ∫cos
    across = 0.5 * yaw_rate * time**2 * np.sinc(angle / (2 * np.pi)) ** 2  # ∫sin
    x, y = velocity
    local = np.column_stack([along * x - across * y, across * x + along * y])
    return rotate_planar(yaw0, local), yaw0 + angle


def _foothold(
    time: np.ndarray, home_b: np.ndarray, velocity: tuple[float, float], yaw_rate: float, yaw0: float
) -> np.ndarray:
    """(t, 2) where a foot is planted so that it is in its home position, seen from the body, at `time`."""
    xy, yaw = _body(time, velocity, yaw_rate, yaw0)
    return xy + rotate_planar(yaw, np.tile(home_b[:2], (len(time), 1)))
