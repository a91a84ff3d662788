"""`Take`: one episode, or one motion without physics, as the viewer shows it; and the marks about its robot: contacts,
forces, friction pyramids, paths of the feet; arrays only.

Shapes tell the same as colours. Under a foot, a ring means stance wanted by the contact schedule, a disc in it a loaded
foot, a square frame around it stance of the gait planner. The demonstration's paths are dashed.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Final

import numpy as np
from scipy.ndimage import gaussian_filter1d

from fastmimic.base.arrays import Array, Flags, Indices
from fastmimic.base.conventions import GRAVITY
from fastmimic.base.rotations import quat_from_yaw, quat_rotate, rotate_planar, yaw_from_quat
from fastmimic.clips.clip import KEYPOINTS
from fastmimic.control.config import ControllerConfig
from fastmimic.episode.rollout import Rollout
from fastmimic.motion.motion import Motion
from fastmimic.render.tracks import Animal, motion_track, rollout_track, world_feet
from fastmimic.robot import Robot
from fastmimic.simulation.terrain import Terrain

if TYPE_CHECKING:
    from trimesh import Trimesh

TRAIL_S: Final = 1.0
_SMOOTHED_S: Final = 0.35
TRAIL_POINTS: Final = 40
LEAST_FORCE: Final = 0.01  # share of the robot's weight below which a force has no arrow
_GROUND_Z: Final = 0.004  # above the plane, so that the marks do not flicker


@dataclass(frozen=True, eq=False)
class Take:
    """An episode or motion, row by row. Row i of an episode is the state after control step i + 1, as in the log. What
    only an episode has is None without physics."""

    robot: Robot
    title: str  # such as "before: not optimised"
    rate_hz: float  # rows a second
    pose: Array  # (t, 19) the robot's root position (world, m), quaternion and joints (rad); finite
    wanted: Flags  # (t, 4) whether the contact schedule wants the foot on the ground
    samples: Indices  # (t,) of the demonstration
    cycle_starts: Indices  # (k,) first rows of the cycles, ascending from 0
    reference: Array | None  # (t, 19) pose of the demonstration
    caption: str = ""  # such as "reward 0.84"
    measured: Flags | None = None  # (t, 4) whether the foot is loaded, above the gait planner's threshold
    stance: Flags | None = None  # (t, 4) the gait planner's leg states
    force: Array | None = None  # (t, 4, 3) the ground's on each foot, world, N
    asked: Array | None = None  # (t, 4, 3) as commanded
    terms: Array | None = None  # (t, 5) the reward's, as in `REWARD_TERMS`
    reward: Array | None = None  # (t,)
    friction: float = 0.0  # μ that the controller assumes
    fell_at: int | None = None  # row; None if the robot stays up
    terrain: Terrain | None = None  # None for flat ground

    @property
    def rows(self) -> int:
        return len(self.pose)

    @property
    def weight(self) -> float:
        """Of the robot, N."""
        return self.robot.mass * GRAVITY

    @cached_property
    def feet(self) -> Array:
        """Centres of the robot's feet (t, 4, 3), world, m."""
        return world_feet(self.robot, self.pose)

    @cached_property
    def reference_feet(self) -> Array | None:
        """Those of the demonstration (t, 4, 3); None without one."""
        return None if self.reference is None else world_feet(self.robot, self.reference)

    @cached_property
    def heading(self) -> Array:
        """Heading of the robot (t,), rad."""
        return np.asarray(yaw_from_quat(self.pose[:, 3:7]))

    def ground(self, at: Array) -> Array:
        """Heights (…) of the ground at (…, ≥2), m."""
        return np.zeros(at.shape[:-1]) if self.terrain is None else self.terrain.height(at[..., 0], at[..., 1])

    def clamp(self, row: int) -> int:
        """The nearest existing row, for takes of different length."""
        return min(max(row, 0), self.rows - 1)


def rollout_take(
    rollout: Rollout, motion: Motion, robot: Robot, config: ControllerConfig, title: str = "", episode: int = 0
) -> Take:
    """An episode with its log, falls included."""
    log = rollout.course
    track = rollout_track(rollout, config.release_force(robot), title, episode)
    assert track.ghost is not None
    pose = held(track.pose)
    yaw = np.asarray(yaw_from_quat(pose[:, 3:7]))
    samples = demonstration_samples(motion.target, log.demonstration["joint_pos"][episode])
    steps = int(rollout.steps[episode])
    return Take(
        robot,
        title,
        log.rate_hz,
        pose,
        log.wanted[episode],
        samples,
        cycle_rows(motion.target, samples),
        held(track.ghost),
        caption=track.caption,
        measured=track.contact,
        stance=log.stance[episode],
        force=np.nan_to_num(log.observation["foot_force"][episode]),
        asked=quat_rotate(quat_from_yaw(yaw)[:, None], log.force[episode]),
        terms=log.terms[episode],
        reward=log.reward[episode],
        friction=config.stance.friction,
        fell_at=steps if rollout.fell[episode] and steps < len(pose) else None,
        terrain=log.terrain,
    )


def motion_take(motion: Motion, robot: Robot, duration_s: float, title: str = "") -> Take:
    """`duration_s` of a motion, or all of one that is not cyclic; the reference is its demonstration, if any."""
    pose = motion_track(motion, duration_s).pose
    samples = np.arange(len(pose), dtype=np.int64) % motion.n_samples
    starts = cycle_rows(motion.target, samples)
    demonstration = motion.demonstration
    reference = None if demonstration is None else motion_track(demonstration, duration_s).pose
    wanted = motion.contact[samples]
    return Take(robot, title, motion.rate_hz, pose, wanted, samples, starts, reference, caption="no physics")


def demonstration_samples(demonstration: Motion, joint_pos: Array) -> Indices:
    """Samples (t,) of the demonstration in an episode, from the joints (t, 12) of row 0; the first of equal cycles."""
    found = np.flatnonzero((demonstration.joint_pos == joint_pos[0]).all(axis=1))
    samples = (int(found[0]) if len(found) else 0) + np.arange(len(joint_pos), dtype=np.int64)
    n = demonstration.n_samples
    return samples % n if demonstration.cycle is not None else np.minimum(samples, n - 1)


def cycle_rows(demonstration: Motion, samples: Indices) -> Indices:
    """Rows (k,) at which a cycle starts, the first one 0, from the sample (t,) of each row."""
    begins = np.isin(samples, demonstration.cycle_starts) & (np.diff(samples, prepend=-1) != 0)
    return np.unique(np.concatenate([[0], np.flatnonzero(begins)])).astype(np.int64)


def held(pose: Array) -> Array:
    """Poses (t, 19) in which a row that is not finite, as after a fall, repeats the last finite one."""
    finite = np.isfinite(pose).all(axis=1)
    return pose[np.maximum.accumulate(np.where(finite, np.arange(len(pose)), 0))]


def contact_meshes(size: float) -> "dict[str, Trimesh]":
    """Flat meshes: "wanted" a ring of radius `size`, m, "measured" a disc, "stance" a frame."""
    from trimesh.creation import revolve

    def flat(outer: float, inner: float, corners: int = 20) -> "Trimesh":
        return revolve([[size * outer, 0.0], [size * inner, 0.0]], sections=corners)  # in this order it faces up

    frame = flat(1.95, 1.62, 4)
    frame.vertices[:, :2] = rotate_planar(np.pi / 4, frame.vertices[:, :2])
    return {"wanted": flat(1.0, 0.74), "measured": flat(0.56, 0.0), "stance": frame}


def contact_places(take: Take, row: int) -> Array:
    """Places of the marks (4, 3): on the ground under the feet, world, m."""
    feet = take.feet[row]
    return np.column_stack([feet[:, :2], take.ground(feet) + _GROUND_Z])


def contact_flags(take: Take, row: int) -> dict[str, Flags]:
    """Visible marks (4,) by name; none if unknown."""
    known = {"wanted": take.wanted, "measured": take.measured, "stance": take.stance}
    return {kind: np.zeros(4, np.bool_) if flags is None else flags[row] for kind, flags in known.items()}


def force_arrows(take: Take, row: int, forces: Array | None) -> Array:
    """Measured or commanded ground reaction forces (t, 4, 3) of a take as arrows (k, 2, 3) from the contact points,
    world, m; only of feet with a force. An arrow of the robot's weight is as long as a leg."""
    if forces is None:
        return np.zeros((0, 2, 3))
    force = forces[row]
    shown = np.linalg.norm(force, axis=-1) > LEAST_FORCE * take.weight
    start = _contact_points(take, row)[shown]
    return np.stack([start, start + force[shown] * take.robot.leg_length / take.weight], axis=1)


def friction_pyramids(take: Take, row: int) -> Array:
    """Edges (8 k, 2, 3) of each loaded foot's friction pyramid, |f_x|, |f_y| ≤ μ f_z (heading frame), cut at its
    vertical force. The tip of the force's arrow is in the square while the force is in the pyramid."""
    if take.force is None:
        return np.zeros((0, 2, 3))
    height = take.force[row, :, 2] * take.robot.leg_length / take.weight
    shown = take.force[row, :, 2] > LEAST_FORCE * take.weight
    apex = _contact_points(take, row)[shown]
    corners = np.array([[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]]) * take.friction
    square = np.ones((4, 3))
    square[:, :2] = rotate_planar(float(take.heading[row]), corners)
    base = apex[:, None] + height[shown, None, None] * square  # (k, 4, 3)
    edges = np.stack([np.broadcast_to(apex[:, None], base.shape), base], axis=2)
    rims = np.stack([base, np.roll(base, -1, axis=1)], axis=2)
    return np.concatenate([edges, rims], axis=1).reshape(-1, 2, 3)


def friction_use(take: Take, row: int) -> Array:
    """Share of its friction pyramid that each foot's force uses (4,): 1 on its side; NaN without a load."""
    out = np.full(4, np.nan)
    if take.force is None:
        return out
    fz = take.force[row, :, 2]
    across = np.abs(rotate_planar(-float(take.heading[row]), take.force[row, :, :2])).max(axis=-1)
    loaded = fz > LEAST_FORCE * take.weight
    out[loaded] = across[loaded] / (take.friction * fz[loaded])
    return out


def trails(feet: Array, row: int, rate_hz: float, *, dashed: bool = False) -> Array:
    """The last `TRAIL_S` of each foot's path (t, 4, 3), world, m, up to a row, as segments (4 · `TRAIL_POINTS`, 2, 3),
    leg by leg. Segments before the first row have no length; if `dashed`, every other one is left out."""
    stride = max(1, round(TRAIL_S * rate_hz / TRAIL_POINTS))
    first = row // stride - TRAIL_POINTS + 1
    number = np.arange(first, first + TRAIL_POINTS + 1)
    rows = np.clip(number * stride, 0, row)
    points = feet[rows].swapaxes(0, 1)  # (4, k + 1, 3)
    segments = np.stack([points[:, :-1], points[:, 1:]], axis=2)
    if dashed:
        gap = number[:-1] // 2 % 2 == 1  # by number, so that the dashes lie still in the world
        segments[:, gap, 1] = segments[:, gap, 0]
    return segments.reshape(-1, 2, 3)


def animal_beside(animal: Animal, take: Take, row: int, aside: float) -> Array:
    """Keypoints (10, 3) of the animal beside the reference at the same moment, in its heading, world, m. `aside` is the
    offset, m, to the left of the reference's initial heading, so that turns keep the animal's side in the picture."""
    poses = take.reference if take.reference is not None else take.pose
    points = animal.at(animal.points, int(take.samples[row]))
    beside = rotate_planar(float(yaw_from_quat(poses[0, 3:7])), np.array([0.0, aside]))
    points[:, :2] = rotate_planar(float(yaw_from_quat(poses[row, 3:7])), points[:, :2]) + poses[row, :2] + beside
    return points


def bone_segments(points: Array) -> Array:
    """The lines (k, 2, 3) between keypoints (10, 3): trunk, girdles, and a straight line for each leg."""
    return np.asarray(points[np.array(KEYPOINTS.bones)])


def smoothed_path(take: Take) -> Array:
    """The robot's path (t, 2) on the ground without sway, for the view, m."""
    return np.asarray(gaussian_filter1d(take.pose[:, :2], _SMOOTHED_S * take.rate_hz, axis=0, mode="nearest"))


def _contact_points(take: Take, row: int) -> Array:
    return np.asarray(take.feet[row] - np.array([0.0, 0.0, take.robot.foot_radius]))
