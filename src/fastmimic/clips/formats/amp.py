"""Frames of adversarial motion priors: DeepMimic-style JSON with velocities and feet beside the 19 numbers of a pose.

61 numbers are those of AMP_for_hardware (Escontrela et al. 2022): root position 3 and quaternion x, y, z, w; joints 12,
feet from the root in its axes 12, velocities of root 3 + 3, joints 12 and feet 12. 49 numbers are these without the
feet's velocities, or root, its velocities 3 + 3, joints 12, their velocities 12, and feet from the root in world axes.
Files differ in the order of the legs, and name no robot: forward kinematics of the right ones gives the file's feet.
"""

from itertools import product
from typing import Final

import numpy as np

from fastmimic.base.arrays import Array
from fastmimic.base.errors import ClipError
from fastmimic.base.rotations import quat_rotate_inverse
from fastmimic.robot.robot import ROBOT_NAMES, Robot, load_robot

_ORDERS: Final = {"FR, FL, RR, RL": (0, 1, 2, 3), "FL, FR, RL, RR": (1, 0, 3, 2)}
_MOST_OFF_M: Final = 0.01  # RMS; an A1's feet are 0.02 off with the lengths of a Go1's or a Go2's legs


LAYOUTS: Final = {61: ((7, 19, False),), 49: ((7, 19, False), (13, 37, True))}
"""For each number of columns: the first of the joints and of the feet, and whether the feet are in world axes."""


def identify(frames: Array, quat_wxyz: Array, robot: Robot | None) -> tuple[Robot, Array, str]:
    """The robot of `frames` (t, 49 or 61), its joints (t, 12) in the common order, rad, and a sentence on what was
    found. The trunk has the orientation `quat_wxyz` (t, 4); `robot` is tried besides the built-in ones. Raises
    `ClipError` if the feet are those of none."""
    from fastmimic.robot.kinematics import foot_positions

    robots = [*([robot] if robot is not None else []), *(load_robot(name) for name in ROBOT_NAMES)]
    found, least = None, np.inf
    for columns, (title, order), own, turned in product(LAYOUTS[frames.shape[1]], _ORDERS.items(), robots, (0, 1)):
        joints, feet = _legs(frames, columns[0], order).reshape(-1, 12), _legs(frames, columns[1], order)
        joints = joints * own.joint_sign**turned  # about the common axes, or those of the robot's file
        feet_b = quat_rotate_inverse(quat_wxyz[:, None], feet) if columns[2] else feet
        off = float(np.sqrt(np.mean(np.sum((foot_positions(own, joints) - feet_b) ** 2, axis=-1))))
        if off < least - 1e-9:
            said = f"joints are the {own.name}'s, legs {title}: the feet in the file are {1e3 * off:.1f} mm off its"
            found, least = (own, joints, said), off
    if found is None or least > _MOST_OFF_M:
        tried = ", ".join(dict.fromkeys(own.name for own in robots))
        raise ClipError(
            f"the joints belong to none of {tried}: the feet in the file are {least:.2f} m off or more;"
            " read it with the robot that they belong to (--robot FILE)"
        )
    return found


def _legs(frames: Array, first: int, order: tuple[int, ...]) -> Array:
    """Twelve columns as (t, 4, 3), legs in the common order."""
    return frames[:, first : first + 12].reshape(-1, 4, 3)[:, list(order)]
