"""`Take`: one episode, or one motion without physics, as the viewer shows it."""

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from fastmimic.base.arrays import Array
from fastmimic.base.conventions import GRAVITY
from fastmimic.base.rotations import quat_from_yaw, quat_rotate, yaw_from_quat
from fastmimic.episode.reward import REWARD_TERMS
from fastmimic.motion.motion import Motion
from fastmimic.render.tracks import motion_track, rollout_track
from fastmimic.robot import Robot
from fastmimic.robot.kinematics import foot_positions

if TYPE_CHECKING:
    from fastmimic.control.config import ControllerConfig
    from fastmimic.episode.rollout import Rollout
    from fastmimic.render.tracks import Track

Flags = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Take:
    """An episode or motion, row by row. Row i of an episode is the state after control step i + 1, as in the log.

    Attributes:
        title: such as "before: as retargeted".
        caption: such as "reward 0.84".
        rate_hz: rows a second.
        pose: (t, 19) the robot's root position (world, m), quaternion and joints (rad); finite.
        reference: (t, 19) that of the demonstration; None without one.
        feet: (t, 4, 3) centres of the robot's feet, world, m.
        reference_feet: (t, 4, 3) those of the demonstration; None without one.
        wanted: (t, 4) whether the contact schedule wants the foot on the ground.
        measured: (t, 4) whether the foot is loaded, above the gait planner's threshold; None without physics.
        stance: (t, 4) the gait planner's leg states; None without physics.
        force, asked: (t, 4, 3) each foot's ground reaction force and its command, world, N; None without physics.
        terms, reward: (t, 5) the reward's terms as in `REWARD_TERMS`, and (t,) the reward; None without physics.
        samples: (t,) the demonstration's sample.
        cycle_starts: (k,) first rows of the cycles, ascending from 0.
        friction: μ that the controller assumes.
        weight: of the robot, N.
        fell_at: row of the fall; None if the robot stays up.
    """

    title: str
    caption: str
    rate_hz: float
    pose: Array
    reference: Array | None
    feet: Array
    reference_feet: Array | None
    wanted: Flags
    measured: Flags | None
    stance: Flags | None
    force: Array | None
    asked: Array | None
    terms: Array | None
    reward: Array | None
    samples: NDArray[np.int64]
    cycle_starts: NDArray[np.int64]
    friction: float
    weight: float
    fell_at: int | None = None

    @property
    def rows(self) -> int:
        return len(self.pose)

    @property
    def duration_s(self) -> float:
        """Time of the last row, s."""
        return self.time_at(self.rows - 1)

    @cached_property
    def heading(self) -> Array:
        """Heading of the robot (t,), rad."""
        return np.asarray(yaw_from_quat(self.pose[:, 3:7]))

    def time_at(self, row: int) -> float:
        """Time of a row, s."""
        return row / self.rate_hz

    def clamp(self, row: int) -> int:
        """The nearest existing row, for takes of different length."""
        return min(max(row, 0), self.rows - 1)


def rollout_take(
    rollout: "Rollout",
    motion: Motion,
    robot: Robot,
    config: "ControllerConfig",
    title: str = "",
    episode: int = 0,
) -> Take:
    """An episode with its log, falls included."""
    log = rollout.log
    assert log is not None, "a take needs a rollout with its log"
    track = rollout_track(rollout, config.release_force(robot), title, episode)
    assert track.ghost is not None
    pose, reference = held(_stacked(track)), held(_stacked(track.ghost))
    observation = log.observation[episode]
    force = np.nan_to_num(observation["foot_force"])
    yaw = np.asarray(yaw_from_quat(pose[:, 3:7]))
    asked = quat_rotate(quat_from_yaw(yaw)[:, None], log.force[episode])
    samples = demonstration_samples(motion.target, log.demonstration["joint_pos"][episode])
    steps = int(rollout.steps[episode])
    weight = robot.mass * GRAVITY
    return Take(
        title=title,
        caption=track.caption,
        rate_hz=log.rate_hz,
        pose=pose,
        reference=reference,
        feet=world_feet(robot, pose),
        reference_feet=world_feet(robot, reference),
        wanted=log.wanted[episode],
        measured=force[..., 2] > config.release_force(robot),
        stance=log.stance[episode],
        force=force,
        asked=asked,
        terms=log.terms[episode],
        reward=log.reward[episode],
        samples=samples,
        cycle_starts=cycle_rows(motion.target, samples),
        friction=config.stance.friction,
        weight=weight,
        fell_at=steps if rollout.fell[episode] and steps < len(pose) else None,
    )


def motion_take(motion: Motion, robot: Robot, duration_s: float, title: str = "") -> Take:
    """The first `duration_s` of a motion, or all of one that is not cyclic, without physics. Its demonstration, if any,
    is the reference."""
    track = motion_track(motion, duration_s, title)
    pose = held(_stacked(track))
    samples = np.arange(len(pose), dtype=np.int64) % motion.n_samples
    reference = None
    if motion.demonstration is not None:
        reference = held(_stacked(motion_track(motion.demonstration, duration_s)))
    return Take(
        title=title,
        caption="no physics",
        rate_hz=motion.rate_hz,
        pose=pose,
        reference=reference,
        feet=world_feet(robot, pose),
        reference_feet=None if reference is None else world_feet(robot, reference),
        wanted=motion.contact[samples],
        measured=None,
        stance=None,
        force=None,
        asked=None,
        terms=None,
        reward=None,
        samples=samples,
        cycle_starts=cycle_rows(motion.target, samples),
        friction=0.0,
        weight=robot.mass * GRAVITY,
    )


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


def world_feet(robot: Robot, pose: Array) -> Array:
    """Centres of the feet (t, 4, 3) at poses (t, 19), world, m."""
    feet = foot_positions(robot, np.ascontiguousarray(pose[:, 7:]))
    return np.asarray(pose[:, None, :3] + quat_rotate(pose[:, None, 3:7], feet))


def term_names() -> tuple[str, ...]:
    """The reward's terms, in words."""
    return tuple(term.label for term in REWARD_TERMS.values())


def _stacked(track: "Track") -> Array:
    parts: list[Any] = [track.root_pos_w, track.root_quat_wxyz, track.joint_pos]
    return np.hstack([np.asarray(part, dtype=np.float64) for part in parts])
