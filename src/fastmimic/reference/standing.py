"""Standing: the motion, the joint path up to it, and its joint gains."""

from typing import Final

import numpy as np

from fastmimic.base.arrays import Array
from fastmimic.clips.clip import ClipOrigin
from fastmimic.clips.synthesis import GaitSpec, keypoints
from fastmimic.motion.motion import Motion
from fastmimic.retargeting.retarget import retarget
from fastmimic.robot import Robot
from fastmimic.robot.kinematics import foot_positions, inverse_kinematics
from fastmimic.robot.robot import mass_ratio

STAND: Final = "stand"
_STILL: Final = GaitSpec(about="stand", lift=0.0, bob=0.0, pitch=0.0, yaw=0.0)
_FOLDED: Final = 0.3  # height of the hips above the feet with folded legs, as a share of the leg length
_STIFFNESS: Final = 120.0  # N·m/rad of an A1; scaled with the mass
_DAMPING: Final = 3.0  # N·m·s/rad
_PATH_ROWS: Final = 33


def standing(robot: Robot) -> Motion:
    """A standing animal, retargeted like any other motion."""
    return retarget(keypoints(_STILL, ClipOrigin(STAND)), robot)[0]


def rising_path(robot: Robot, stand: Array) -> tuple[Array, float]:
    """Joints (33, 12), rad, from folded legs straight up to the posture `stand` (12,); base height when folded, m."""
    feet = foot_positions(robot, stand)
    folded = np.array(feet)
    folded[:, 2] = robot.hip_pos_b[:, 2] - _FOLDED * robot.leg_length
    path, _ = inverse_kinematics(robot, feet + np.linspace(1, 0, _PATH_ROWS)[:, None, None] * (folded - feet))
    return np.clip(path, robot.joint_lower, robot.joint_upper), float(-folded[:, 2].mean()) + robot.foot_radius


def along(path: Array, share: float) -> Array:
    """The posture (12,) at a share in [0, 1] of a path (t, 12), with a smooth start and end."""
    at = smooth(share) * (len(path) - 1)
    low = min(int(at), len(path) - 2)
    return np.asarray(path[low] + (at - low) * (path[low + 1] - path[low]))


def standing_gains(robot: Robot) -> tuple[float, float]:
    """Stiffness, N·m/rad, and damping, N·m·s/rad, with which the joints carry the robot."""
    return _STIFFNESS / mass_ratio(robot), _DAMPING / mass_ratio(robot)


def smooth(u: float) -> float:
    """A smooth step from 0 to 1."""
    u = min(max(u, 0.0), 1.0)
    return u * u * (3 - 2 * u)
