"""The animal at the robot's size: its keypoints in its heading frame over time."""

import numpy as np

from fastmimic.base.arrays import Array
from fastmimic.base.rotations import rotate_planar, yaw_from_quat
from fastmimic.clips.clip import Clip, Skeleton
from fastmimic.motion.motion import Motion
from fastmimic.render.tracks import AnimalTrack, motion_track
from fastmimic.retargeting.config import RetargetConfig
from fastmimic.retargeting.retarget import choose_scale
from fastmimic.retargeting.track import extract
from fastmimic.robot import Robot


class Animal:
    """A clip's points on the ground in its own heading frame, scaled as in retargeting. `motion`, made of the clip, may
    have another length; it is then run through from start to end.

    Attributes:
        name: of the clip.
        points: (t, 10, 3) keypoints, heading frame, origin on the ground under the middle of neck and pelvis, m.
        body: (t, k, 3) the points that the skeleton joins, in the same frame.
        skeleton: of the clip, with radii at the robot's size.
    """

    def __init__(self, clip: Clip, robot: Robot, motion: Motion) -> None:
        scale = choose_scale(clip, robot)
        source = extract(clip, scale, RetargetConfig().roll_share)
        ground = np.percentile(scale * clip.toes_w[..., 2], 10, axis=0).mean()

        def local(points_w: Array) -> Array:
            points = scale * points_w
            points[..., :2] = rotate_planar(-source.heading[:, None], points[..., :2] - source.root_xy[:, None])
            points[..., 2] -= ground
            return points

        self.name = str(clip.meta.get("name", "animal"))
        self.points, self.body = local(clip.points_w), local(clip.drawn_w)
        bones = clip.skeleton
        self.skeleton = Skeleton(bones.points, bones.bones, tuple(scale * radius for radius in bones.radii))
        self._periodic = motion.target.cycle is not None
        self._samples = motion.target.n_samples

    def local(self, sample: int) -> Array:
        """Keypoints (10, 3) at a sample of the demonstration, in the frame of `points`, m."""
        return self._at(self.points, sample)

    def local_body(self, sample: int) -> Array:
        """The points that the skeleton joins, (k, 3), in the same frame."""
        return self._at(self.body, sample)

    def _at(self, points: Array, sample: int) -> Array:
        n = len(points)
        share = sample / self._samples if self._periodic else sample / max(self._samples - 1, 1)
        at = share * (n if self._periodic else n - 1)
        low = min(int(at), n - 1)
        high = (low + 1) % n if self._periodic else min(low + 1, n - 1)
        return np.asarray(points[low] + (at - low) * (points[high] - points[low]))


def animal_track(
    clip: Clip, robot: Robot, motion: Motion, duration_s: float, title: str = "", caption: str = ""
) -> AnimalTrack:
    """The first `duration_s` of a clip's animal, at the robot's size, on the path and at the rate of `motion`."""
    animal = Animal(clip, robot, motion)
    path = motion_track(motion.target, duration_s)
    heading = yaw_from_quat(path.root_quat_wxyz)
    points = np.array([animal.local_body(i % motion.target.n_samples) for i in range(len(path.root_pos_w))])
    points[..., :2] = path.root_pos_w[:, None, :2] + rotate_planar(heading[:, None], points[..., :2])
    return AnimalTrack(points, animal.skeleton, title, caption)
