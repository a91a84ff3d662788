"""Tracks: poses of robots and animals over time for videos, made from logs, motions and clips; what a panel shows."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import mujoco
import numpy as np

from fastmimic.base import rotations
from fastmimic.base.arrays import Array, Flags, Indices, Records
from fastmimic.base.errors import ConfigError
from fastmimic.clips.clip import Clip
from fastmimic.motion.export import at_samples
from fastmimic.motion.motion import Motion
from fastmimic.render.video_scene import CameraView, flatten, start_shadow
from fastmimic.retargeting.config import RetargetConfig
from fastmimic.retargeting.retarget import choose_scale
from fastmimic.retargeting.track import extract
from fastmimic.robot import Robot
from fastmimic.robot.kinematics import foot_positions
from fastmimic.simulation.terrain import Terrain

if TYPE_CHECKING:
    from fastmimic.episode.rollout import Rollout

_TRAIL_S: Final = 0.45
_TRAIL_PIECES: Final = 14
_TRAIL_STEP: Final = 0.002  # m; shorter pieces are not drawn, as the foot stands
_BONE_RGBA: Final = (0.66, 0.47, 0.30, 1.0)


@dataclass(frozen=True, eq=False)
class Shown:
    """What a panel of a video shows in each of n frames."""

    root: Array  # (n, 3) what the camera follows, world, m
    yaw: float  # heading in the first frame, rad
    robot: Array | None = None  # (n, 19) poses; None for no robot
    ghost: Array | None = None  # the same of its demonstration
    feet: Array | None = None  # (n, p, 4, 3) now and at the p - 1 moments before that a trail joins; None: no marks
    contact: Flags | None = None  # (n, 4) loaded feet
    terrain: Terrain | None = None

    def mark(self, view: CameraView, frame: int, width: float) -> None:
        """Draws the trails of the feet, `width` pixels wide, and discs under loaded feet."""
        if self.feet is None:
            return
        for leg in range(4):
            if self.contact is not None and self.contact[frame, leg]:
                view.disc(self.feet[frame, 0, leg], leg)
            path = self.feet[frame, :, leg]  # (p, 3), present first: a fading trail, without where it stood
            for i in np.flatnonzero(np.linalg.norm(np.diff(path, axis=0), axis=1) > _TRAIL_STEP):
                view.line(path[i], path[i + 1], leg, 0.9 * (1 - i / _TRAIL_PIECES), width)


@dataclass(frozen=True, eq=False)
class Track:
    """What one robot does, for a panel of a video. A NaN, as after a fall, holds the last pose before it."""

    pose: Array  # (t, 19) base position (world, m), orientation (wxyz, body → world) and joints (rad)
    title: str = ""  # first line of the panel, such as "before"
    caption: str = ""  # second line, such as "reward 0.84"
    ghost: Array | None = None  # (t, 19) the demonstration, drawn as a translucent robot; None for no ghost
    contact: Flags | None = None  # (t, 4) bool, feet marked as loaded; None for no marks
    terrain: Terrain | None = None  # None for flat ground

    def __post_init__(self) -> None:
        n = len(self.pose)
        if n < 1 or np.shape(self.pose) != (n, 19):
            raise ConfigError(f"a track needs poses (t, 19) with t ≥ 1, found {np.shape(self.pose)}")
        if not np.isfinite(self.pose[0]).all():
            raise ConfigError("a track's first pose is not finite")
        if self.ghost is not None and len(self.ghost) != n:
            raise ConfigError(f"a ghost has {len(self.ghost)} samples; its track has {n}")
        if self.contact is not None and np.shape(self.contact) != (n, 4):
            raise ConfigError(f"a track of {n} samples needs contacts ({n}, 4), found {np.shape(self.contact)}")

    def shown(self, robot: Robot, rate_hz: float, times: Array, *, marks: bool) -> Shown:
        """What it shows in frames at `times` (n,) s; `marks` are those of the feet."""
        pose = resample(self.pose, rate_hz, times)
        ghost = resample(self.ghost, rate_hz, times) if self.ghost is not None else None
        yaw = float(rotations.yaw_from_quat(pose[0, 3:7]))
        if not marks:
            return Shown(pose[:, :3], yaw, pose, ghost, terrain=self.terrain)
        moments = times[:, None] - np.linspace(0.0, _TRAIL_S, _TRAIL_PIECES + 1)
        before = resample(self.pose, rate_hz, np.maximum(moments, 0.0).ravel())
        feet = world_feet(robot, before).reshape(*moments.shape, 4, 3)
        nearest = np.clip(np.round(times * rate_hz).astype(np.int64), 0, len(self.pose) - 1)
        contact = None if self.contact is None else np.asarray(self.contact, dtype=np.bool_)[nearest]
        return Shown(pose[:, :3], yaw, pose, ghost, feet, contact, self.terrain)


def resample(poses: Array, rate_hz: float, times: Array) -> Array:
    """Poses at `times` (n,) s: (n, 19), all finite, from those of a track, (t, 19)."""
    poses = np.array(poses, np.float64)
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


def rollout_track(rollout: "Rollout", loaded_n: float, title: str = "", episode: int = 0, note: str = "") -> Track:
    """An episode of a logged rollout, falls included, with the demonstration as its ghost. The panel's second line
    tells the reward, against the animal where that is known, and the time of a fall after `note`, such as the method;
    `loaded_n` loads a foot, N."""
    log = rollout.course
    robot, ghost = log.observation[episode], log.demonstration[episode]
    caption = f"{note} · " if note else ""
    animal = rollout.reward_animal[episode]
    caption += f"reward {rollout.reward[episode] if np.isnan(animal) else animal:.2f}"
    if rollout.fell[episode]:
        caption += f", fell after {rollout.steps[episode] / log.rate_hz:.1f} s"
    contact = robot["foot_force"][..., 2] > loaded_n  # False for the NaN after a fall
    return Track(poses_of(robot), title, caption, poses_of(ghost), contact, log.terrain)


def poses_of(states: Records) -> Array:
    """(t, 19) root position, quaternion and joints of states (t,)."""
    return np.hstack([states["root_pos"], states["root_quat"], states["joint_pos"]])


def motion_track(
    motion: Motion, duration_s: float, title: str = "", ghost: Array | None = None, caption: str = ""
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
    contact = motion.contact[sample % motion.n_samples]
    return Track(np.hstack([position, quat, joint_pos]), title, caption, ghost, contact)


def world_feet(robot: Robot, pose: Array) -> Array:
    """Centres of the feet (t, 4, 3) at poses (t, 19), world, m."""
    feet = foot_positions(robot, np.ascontiguousarray(pose[:, 7:]))
    return np.asarray(pose[:, None, :3] + rotations.quat_rotate(pose[:, None, 3:7], feet))


class Animal:
    """A clip's points on the ground in its own heading frame, scaled as in retargeting: `points` (t, 10, 3) keypoints,
    m, from the ground under the middle of neck and pelvis. `motion`, made of the clip, may have another length; it is
    then run through to its end."""

    def __init__(self, clip: Clip, robot: Robot, motion: Motion) -> None:
        self.scale = choose_scale(clip, robot)
        self._source = extract(clip, self.scale, RetargetConfig().roll_share)
        self._ground = np.percentile(self.scale * clip.toes_w[..., 2], 10, axis=0).mean()
        self.points = self.local(clip.points_w)
        self._periodic = motion.target.cycle is not None
        self._samples = motion.target.n_samples

    def local(self, points_w: Array) -> Array:
        """Points (t, k, 3) of the clip, world, m, in that frame."""
        points, heading = self.scale * points_w, self._source.heading[:, None]
        points[..., :2] = rotations.rotate_planar(-heading, points[..., :2] - self._source.root_xy[:, None])
        points[..., 2] -= self._ground
        return points

    def at(self, points: Array, sample: Indices | int) -> Array:
        """Such points (t, k, 3) at samples (n,) of the demonstration, or at one: (n, k, 3) or (k, 3)."""
        course = np.concatenate([points, points[:1]]) if self._periodic else points
        last = self._samples if self._periodic else max(self._samples - 1, 1)
        return interpolated(course, np.asarray(sample) / last * (len(course) - 1))


@dataclass(frozen=True, eq=False, kw_only=True)
class ShownAnimal(Shown):
    """What the panel of an animal shows: its bones."""

    bones: Array  # (n, b, 2, 3) their ends, world, m
    radii: tuple[float, ...]  # (b,) m

    def mark(self, view: CameraView, frame: int, width: float) -> None:
        """Draws the bones as capsules, with their shadows."""
        kind, zero = mujoco.mjtGeom.mjGEOM_CAPSULE, np.zeros(3)
        for (start, end), radius in zip(self.bones[frame], self.radii, strict=True):
            geom = view.add(kind, zero, zero, _BONE_RGBA)
            mujoco.mjv_connector(geom, kind, radius, start, end)
            geom.category = mujoco.mjtCatBit.mjCAT_DYNAMIC  # decoration has no shadow in the depth map
            if not view.video_scene.quality.shadow_map:
                shadow = view.add(kind, zero, zero, _BONE_RGBA)
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
        heading = rotations.yaw_from_quat(path[:, 3:7])[:, None]
        points[..., :2] = path[:, None, :2] + rotations.rotate_planar(heading, points[..., :2])
        radii = tuple(animal.scale * radius for radius in clip.skeleton.radii)
        return cls(path, title, caption, points=points, bones=clip.skeleton.bones, radii=radii)

    def shown(self, robot: Robot, rate_hz: float, times: Array, *, marks: bool) -> Shown:
        """What it shows in frames at `times` (n,) s."""
        points = interpolated(self.points, rate_hz * times)
        middle = (points.min(axis=1) + points.max(axis=1)) / 2
        heading = float(np.arctan2(*(middle[-1] - middle[0])[1::-1]))  # of its travel
        return ShownAnimal(middle, heading, bones=points[:, np.array(self.bones)], radii=self.radii)
