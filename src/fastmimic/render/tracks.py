"""Tracks: poses of robots and animals over time for videos, made from logs, motions and clips."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from fastmimic.base import rotations
from fastmimic.base.arrays import Array
from fastmimic.base.errors import ConfigError
from fastmimic.clips.clip import Clip, Skeleton
from fastmimic.motion.export import at_samples
from fastmimic.motion.motion import Motion
from fastmimic.retargeting.config import RetargetConfig
from fastmimic.retargeting.retarget import choose_scale
from fastmimic.retargeting.track import extract
from fastmimic.robot import Robot
from fastmimic.robot.kinematics import foot_positions
from fastmimic.simulation.terrain import Terrain

if TYPE_CHECKING:
    from fastmimic.episode.rollout import Rollout


@dataclass(frozen=True, eq=False)
class Track:
    """What one robot does, for a panel of a video. A NaN, as after a fall, holds the last pose before it."""

    root_pos_w: Array  # (t, 3) base position, world, m
    root_quat_wxyz: Array  # (t, 4) base orientation, body → world
    joint_pos: Array  # (t, 12) rad
    title: str = ""  # first line of the panel, such as "before"
    caption: str = ""  # second line, such as "reward 0.84"
    ghost: "Track | None" = None  # the demonstration at the same times, drawn as a translucent robot; None for no ghost
    contact: NDArray[np.bool_] | None = None  # (t, 4) bool, feet marked as loaded; None for no marks
    terrain: Terrain | None = None  # None for flat ground

    @property
    def pose(self) -> Array:
        """Root position, quaternion and joints (t, 19)."""
        return np.hstack([np.asarray(a, np.float64) for a in (self.root_pos_w, self.root_quat_wxyz, self.joint_pos)])

    def __post_init__(self) -> None:
        n = len(self.root_pos_w)
        shapes = (np.shape(self.root_pos_w), np.shape(self.root_quat_wxyz), np.shape(self.joint_pos))
        if n < 1 or shapes != ((n, 3), (n, 4), (n, 12)):
            raise ConfigError(f"a track needs arrays (t, 3), (t, 4) and (t, 12) with t ≥ 1, found {shapes}")
        if not np.isfinite(self.pose[0]).all():
            raise ConfigError("a track's first pose is not finite")
        if self.ghost is not None and len(self.ghost.root_pos_w) != n:
            raise ConfigError(f"a ghost has {len(self.ghost.root_pos_w)} samples; its track has {n}")
        if self.contact is not None and np.shape(self.contact) != (n, 4):
            raise ConfigError(f"a track of {n} samples needs contacts ({n}, 4), found {np.shape(self.contact)}")


@dataclass(frozen=True, eq=False)
class AnimalTrack:
    """What an animal does, for a panel of a video: points and the bones between them."""

    points_w: Array  # (t, k, 3) world, m, finite
    skeleton: Skeleton  # which of the points are joined
    title: str = ""  # as in `Track`
    caption: str = ""

    def __post_init__(self) -> None:
        shape = np.shape(self.points_w)
        if len(shape) != 3 or shape[0] < 1 or shape[1:] != (self.skeleton.points, 3):
            raise ConfigError(f"the animal's points have shape {shape}; expected (t, {self.skeleton.points}, 3), t ≥ 1")
        if not np.all(np.isfinite(self.points_w)):
            raise ConfigError("the animal's points are not finite")


def resample(track: Track, rate_hz: float, times: Array) -> Array:
    """Poses of a track at `times` (n,) s: (n, 19) root position, quaternion and joints, all finite."""
    poses = track.pose
    bad = ~np.isfinite(poses).all(axis=1)
    poses = poses[: int(np.argmax(bad)) if bad.any() else len(poses)]
    poses[:, 3:7] = rotations.quat_continuous(poses[:, 3:7])
    between = interpolated(poses, rate_hz * times)
    between[:, 3:7] /= np.linalg.norm(between[:, 3:7], axis=1, keepdims=True)
    return between


def interpolated(rows: Array, at: Array) -> Array:
    """Values (n, ...) between rows (t, ...) at the indices (n,), those outside at the ends; without n for one index."""
    at = np.clip(at, 0, len(rows) - 1)
    low = np.minimum(at.astype(np.int64), max(len(rows) - 2, 0))
    high = np.minimum(low + 1, len(rows) - 1)
    return np.asarray(rows[low] + (at - low)[(..., *[None] * (rows.ndim - 1))] * (rows[high] - rows[low]))


def resample_contact(track: Track, rate_hz: float, times: Array) -> NDArray[np.bool_]:
    """Loaded feet at `times` (n,) s, (n, 4); none if unknown."""
    if track.contact is None:
        return np.zeros((len(times), 4), dtype=np.bool_)
    nearest = np.clip(np.round(times * rate_hz).astype(np.int64), 0, len(track.contact) - 1)
    return np.asarray(track.contact, dtype=np.bool_)[nearest]


def rollout_track(rollout: "Rollout", loaded_n: float, title: str = "", episode: int = 0, note: str = "") -> Track:
    """An episode of a logged rollout, falls included, with the demonstration as its ghost. The panel's second line
    tells the reward and the time of a fall after `note`, such as the method; `loaded_n` loads a foot, N."""
    log = rollout.course
    robot, ghost = log.observation[episode], log.demonstration[episode]
    caption = f"{note} · " if note else ""
    caption += f"reward {rollout.reward[episode]:.2f}"
    if rollout.fell[episode]:
        caption += f", fell after {rollout.steps[episode] / log.rate_hz:.1f} s"
    return Track(
        robot["root_pos"],
        robot["root_quat"],
        robot["joint_pos"],
        title=title,
        caption=caption,
        ghost=Track(ghost["root_pos"], ghost["root_quat"], ghost["joint_pos"], title="demonstration"),
        contact=robot["foot_force"][..., 2] > loaded_n,  # False for the NaN after a fall
        terrain=log.terrain,
    )


def motion_track(
    motion: Motion, duration_s: float, title: str = "", ghost: Track | None = None, caption: str = ""
) -> Track:
    """The first `duration_s` of a motion, without physics: repeated if it is cyclic. The ghost has the same length."""
    n = max(1, round(duration_s * motion.rate_hz))
    if motion.cycle is None:
        n = min(n, motion.n_samples)
    sample = np.arange(n)
    position, quat, joint_pos, *_ = at_samples(motion, sample)
    back = -float(rotations.yaw_from_quat(quat[0]))
    position = rotations.turned_about_z(position - np.array([*position[0, :2], 0.0]), back)
    quat = rotations.quat_multiply(rotations.quat_from_yaw(np.array([back])), quat)
    return Track(position, quat, joint_pos, title, caption, ghost, motion.contact[sample % motion.n_samples])


def world_feet(robot: Robot, pose: Array) -> Array:
    """Centres of the feet (t, 4, 3) at poses (t, 19), world, m."""
    feet = foot_positions(robot, np.ascontiguousarray(pose[:, 7:]))
    return np.asarray(pose[:, None, :3] + rotations.quat_rotate(pose[:, None, 3:7], feet))


class Animal:
    """A clip's points on the ground in its own heading frame, scaled as in retargeting: `points` (t, 10, 3) keypoints,
    m, from the ground under the middle of neck and pelvis; `body` (t, k, 3) those that the `skeleton` joins, its radii
    at the robot's size. `motion`, made of the clip, may have another length; it is then run through to its end."""

    def __init__(self, clip: Clip, robot: Robot, motion: Motion) -> None:
        scale = choose_scale(clip, robot)
        source = extract(clip, scale, RetargetConfig().roll_share)
        ground = np.percentile(scale * clip.toes_w[..., 2], 10, axis=0).mean()

        def local(points_w: Array) -> Array:
            points = scale * points_w
            points[..., :2] = rotations.rotate_planar(
                -source.heading[:, None], points[..., :2] - source.root_xy[:, None]
            )
            points[..., 2] -= ground
            return points

        self.points, self.body = local(clip.points_w), local(clip.drawn_w)
        bones = clip.skeleton
        self.skeleton = Skeleton(bones.points, bones.bones, tuple(scale * radius for radius in bones.radii))
        self._periodic = motion.target.cycle is not None
        self._samples = motion.target.n_samples

    def at(self, points: Array, sample: NDArray[np.int64] | int) -> Array:
        """`points` or `body` (t, k, 3) at samples (n,) of the demonstration, or at one: (n, k, 3) or (k, 3)."""
        course = np.concatenate([points, points[:1]]) if self._periodic else points
        last = self._samples if self._periodic else max(self._samples - 1, 1)
        return interpolated(course, np.asarray(sample) / last * (len(course) - 1))


def animal_track(
    clip: Clip, robot: Robot, motion: Motion, duration_s: float, title: str = "", caption: str = ""
) -> AnimalTrack:
    """The first `duration_s` of a clip's animal, at the robot's size, on the path and at the rate of `motion`."""
    animal = Animal(clip, robot, motion)
    path = motion_track(motion.target, duration_s)
    heading = rotations.yaw_from_quat(path.root_quat_wxyz)
    points = animal.at(animal.body, np.arange(len(path.root_pos_w)) % motion.target.n_samples)
    points[..., :2] = path.root_pos_w[:, None, :2] + rotations.rotate_planar(heading[:, None], points[..., :2])
    return AnimalTrack(points, animal.skeleton, title, caption)
