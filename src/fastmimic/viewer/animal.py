"""The animal beside the robot: its keypoints at the robot's size, posture against posture."""

from typing import TYPE_CHECKING, Final

import numpy as np

from fastmimic.base.arrays import Array
from fastmimic.base.rotations import rotate_planar, yaw_from_quat
from fastmimic.clips.skeleton import KEYPOINTS
from fastmimic.render import animal

if TYPE_CHECKING:
    from fastmimic.viewer.take import Take


BONES: Final = KEYPOINTS.bones
"""Pairs of keypoints that are drawn as a line: trunk, girdles, and a straight line for each leg."""


class Animal(animal.Animal):
    """As videos show it, and placed in the viewer's scene."""

    def placed(self, take: "Take", row: int, aside: float) -> Array:
        """Keypoints (10, 3) beside the reference, in its heading, at the same moment, world, m.

        Args:
            take: what is shown.
            row: of it.
            aside: how far to the left of the reference, m; in its heading at the start, so that in a turn the animal
                stays on its side of the picture.
        """
        poses = take.reference if take.reference is not None else take.pose
        points = self.local(int(take.samples[row]))
        beside = rotate_planar(float(yaw_from_quat(poses[0, 3:7])), np.array([0.0, aside]))
        points[:, :2] = rotate_planar(float(yaw_from_quat(poses[row, 3:7])), points[:, :2]) + poses[row, :2] + beside
        return points


def bone_segments(points: Array) -> Array:
    """The lines (k, 2, 3) between keypoints (10, 3)."""
    return np.asarray(points[np.array(BONES)])
