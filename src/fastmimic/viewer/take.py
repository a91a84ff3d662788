"""`Take`: one episode, or one motion without physics, as the viewer shows it."""

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from fastmimic.base.arrays import Array
from fastmimic.base.conventions import GRAVITY
from fastmimic.base.rotations import quat_from_yaw, quat_rotate, yaw_from_quat
from fastmimic.motion.motion import Motion
from fastmimic.render.tracks import motion_track, rollout_track, world_feet
from fastmimic.robot import Robot

if TYPE_CHECKING:
    from fastmimic.control.config import ControllerConfig
    from fastmimic.episode.rollout import Rollout

Flags = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Take:
    """An episode or motion, row by row. Row i of an episode is the state after control step i + 1, as in the log. What
    only an episode has is None without physics."""

    robot: Robot
    title: str  # such as "before: as retargeted"
    rate_hz: float  # rows a second
    pose: Array  # (t, 19) the robot's root position (world, m), quaternion and joints (rad); finite
    wanted: Flags  # (t, 4) whether the contact schedule wants the foot on the ground
    samples: NDArray[np.int64]  # (t,) of the demonstration
    cycle_starts: NDArray[np.int64]  # (k,) first rows of the cycles, ascending from 0
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

    def clamp(self, row: int) -> int:
        """The nearest existing row, for takes of different length."""
        return min(max(row, 0), self.rows - 1)


def rollout_take(
    rollout: "Rollout", motion: Motion, robot: Robot, config: "ControllerConfig", title: str = "", episode: int = 0
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
        held(track.ghost.pose),
        caption=track.caption,
        measured=track.contact,
        stance=log.stance[episode],
        force=np.nan_to_num(log.observation["foot_force"][episode]),
        asked=quat_rotate(quat_from_yaw(yaw)[:, None], log.force[episode]),
        terms=log.terms[episode],
        reward=log.reward[episode],
        friction=config.stance.friction,
        fell_at=steps if rollout.fell[episode] and steps < len(pose) else None,
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


def demonstration_samples(demonstration: Motion, joint_pos: Array) -> NDArray[np.int64]:
    """Samples (t,) of the demonstration in an episode, from the joints (t, 12) of row 0; the first of equal cycles."""
    found = np.flatnonzero((demonstration.joint_pos == joint_pos[0]).all(axis=1))
    samples = (int(found[0]) if len(found) else 0) + np.arange(len(joint_pos), dtype=np.int64)
    n = demonstration.n_samples
    return samples % n if demonstration.cycle is not None else np.minimum(samples, n - 1)


def cycle_rows(demonstration: Motion, samples: NDArray[np.int64]) -> NDArray[np.int64]:
    """Rows (k,) at which a cycle starts, the first one 0, from the sample (t,) of each row."""
    begins = np.isin(samples, demonstration.cycle_starts) & (np.diff(samples, prepend=-1) != 0)
    return np.unique(np.concatenate([[0], np.flatnonzero(begins)])).astype(np.int64)


def held(pose: Array) -> Array:
    """Poses (t, 19) in which a row that is not finite, as after a fall, repeats the last finite one."""
    finite = np.isfinite(pose).all(axis=1)
    last = np.maximum.accumulate(np.where(finite, np.arange(len(pose)), 0))
    return pose[last]
