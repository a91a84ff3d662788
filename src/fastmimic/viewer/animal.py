"""The animal beside the robot: its keypoints at the robot's size, posture against posture."""

from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from fastmimic.conventions import LEGS
from fastmimic.motion.clip import POINT_NAMES
from fastmimic.motion.retarget import choose_scale
from fastmimic.motion.retarget_config import RetargetConfig
from fastmimic.motion.retarget_source import extract
from fastmimic.rotations import rotate_planar, yaw_from_quat

if TYPE_CHECKING:
    from fastmimic.motion.clip import Clip
    from fastmimic.motion.motion import Motion
    from fastmimic.robot import Robot
    from fastmimic.viewer.take import Take

Array = NDArray[np.float64]

_BONES: Final = (
    ("pelvis", "neck"),
    *(("neck" if leg.startswith("F") else "pelvis", f"{leg}_hip") for leg in LEGS),
    *((f"{leg}_hip", f"{leg}_toe") for leg in LEGS),
)
BONES: Final = tuple((POINT_NAMES.index(a), POINT_NAMES.index(b)) for a, b in _BONES)
"""Pairs of keypoints that are drawn as a line: trunk, girdles, and a straight line for each leg."""


class Animal:
    """A clip's keypoints in its own heading frame, scaled as retargeting scales them, on the ground.

    Args:
        clip: the animal.
        robot: whose size it takes.
        motion: what was made of the clip; one of another length is run through at its own speed, from start to end.
    """

    def __init__(self, clip: "Clip", robot: "Robot", motion: "Motion") -> None:
        scale = choose_scale(clip, robot)
        source = extract(clip, scale, RetargetConfig().roll_share)
        points = scale * clip.points_w
        ground = np.percentile(scale * clip.toes_w[..., 2], 10, axis=0).mean()
        self.name = str(clip.meta.get("name", "animal"))
        self.points = points.copy()
        self.points[..., :2] = rotate_planar(-source.heading[:, None], points[..., :2] - source.root_xy[:, None])
        self.points[..., 2] -= ground
        self._periodic = motion.target.cycle is not None
        self._samples = motion.target.n_samples

    def local(self, sample: int) -> Array:
        """Keypoints (10, 3) at a sample of the demonstration: heading frame, origin on the ground under the middle of
        neck and pelvis, m."""
        n = len(self.points)
        share = sample / self._samples if self._periodic else sample / max(self._samples - 1, 1)
        at = share * (n if self._periodic else n - 1)
        low = min(int(at), n - 1)
        high = (low + 1) % n if self._periodic else min(low + 1, n - 1)
        return np.asarray(self.points[low] + (at - low) * (self.points[high] - self.points[low]))

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
