"""The animal of a clip in a panel of a video: its bones as capsules."""

from dataclasses import dataclass
from typing import Final

import mujoco
import numpy as np

from fastmimic.base.arrays import Array
from fastmimic.base.rotations import rotate_planar, yaw_from_quat
from fastmimic.clips.clip import Clip
from fastmimic.motion.motion import Motion
from fastmimic.render.tracks import Animal, Shown, Track, interpolated, motion_track
from fastmimic.render.video_scene import CameraView, flatten, start_shadow
from fastmimic.robot import Robot

BONE_RGBA: Final = (0.66, 0.47, 0.30, 1.0)


@dataclass(frozen=True, eq=False, kw_only=True)
class ShownAnimal(Shown):
    """What the panel of an animal shows: its bones."""

    bones: Array  # (n, b, 2, 3) their ends, world, m
    radii: tuple[float, ...]  # (b,) m

    def mark(self, view: CameraView, frame: int, width: float) -> None:
        """Draws the bones as capsules, with their shadows."""
        kind, zero = mujoco.mjtGeom.mjGEOM_CAPSULE, np.zeros(3)
        for (start, end), radius in zip(self.bones[frame], self.radii, strict=True):
            geom = view.add(kind, zero, zero, BONE_RGBA)
            mujoco.mjv_connector(geom, kind, radius, start, end)
            geom.category = mujoco.mjtCatBit.mjCAT_DYNAMIC  # decoration has no shadow in the depth map
            if not view.video_scene.quality.shadow_map:
                shadow = view.add(kind, zero, zero, BONE_RGBA)
                start_shadow(geom, shadow)
                flatten(geom, shadow)


@dataclass(frozen=True, eq=False, kw_only=True)
class AnimalTrack(Track):
    """What an animal does: points and the bones between them."""

    points: Array  # (t, k, 3) world, m
    bones: tuple[tuple[int, int], ...]  # numbers of the points that each joins
    radii: tuple[float, ...]  # of the bones, m

    @classmethod
    def of(
        cls, clip: Clip, robot: Robot, motion: Motion, seconds: float, title: str = "", caption: str = ""
    ) -> "AnimalTrack":
        """The first `seconds` of a clip's animal, at the robot's size, on the path and at the rate of `motion`."""
        animal, path = Animal(clip, robot, motion), motion_track(motion.target, seconds).pose
        points = animal.at(animal.local(clip.drawn_w), np.arange(len(path)) % motion.target.n_samples)
        points[..., :2] = path[:, None, :2] + rotate_planar(yaw_from_quat(path[:, 3:7])[:, None], points[..., :2])
        radii = tuple(animal.scale * radius for radius in clip.skeleton.radii)
        return cls(path, title, caption, points=points, bones=clip.skeleton.bones, radii=radii)

    def shown(self, robot: Robot, rate_hz: float, times: Array, *, marks: bool) -> Shown:
        """What it shows in frames at `times` (n,) s."""
        points = interpolated(self.points, rate_hz * times)
        middle = (points.min(axis=1) + points.max(axis=1)) / 2
        heading = float(np.arctan2(*(middle[-1] - middle[0])[1::-1]))  # of its travel
        return ShownAnimal(middle, heading, bones=points[:, np.array(self.bones)], radii=self.radii)
