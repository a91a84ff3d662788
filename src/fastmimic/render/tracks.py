"""What videos and figures take, out of logs and motions."""

from typing import TYPE_CHECKING, Final

import numpy as np

from fastmimic.base.arrays import Array
from fastmimic.base.rotations import quat_from_yaw, quat_multiply, rotate_planar, yaw_from_quat
from fastmimic.motion.motion import Motion
from fastmimic.render.playback import Track
from fastmimic.robot import Robot
from fastmimic.robot.kinematics import foot_positions

if TYPE_CHECKING:
    from fastmimic.episode.rollout import Rollout


LOADED_N: Final = 1.0
"""Vertical force from which a foot is marked as loaded, N."""


def rollout_track(rollout: "Rollout", title: str = "", episode: int = 0, note: str = "") -> Track:
    """An episode as it happened, falls included, with the demonstration in force at each step as its ghost.

    Args:
        rollout: with its log.
        title: first line of the panel; the second tells the reward, and when the robot fell.
        episode: which one.
        note: what the second line begins with, such as the method.
    """
    log = rollout.log
    assert log is not None, "a track needs a rollout with its log"
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
        contact=robot["foot_force"][..., 2] > LOADED_N,  # False for the NaN after a fall
    )


def motion_track(
    motion: Motion, duration_s: float, title: str = "", ghost: Track | None = None, caption: str = ""
) -> Track:
    """A motion as it is written, without physics: its cycles one after another, or once if it has none.

    Args:
        motion: the motion.
        duration_s: how much of it, s.
        title: first line of the panel.
        ghost: of the same length.
        caption: second line.
    """
    n = max(1, round(duration_s * motion.rate_hz))
    if motion.cycle is None:
        n = min(n, motion.n_samples)
    cycle, sample = np.divmod(np.arange(n), motion.n_samples)
    origin = _cycle_origins(motion, int(cycle[-1]) + 1)[cycle]
    yaw0 = float(yaw_from_quat(motion.root_quat_wxyz[0]))
    first = motion.root_pos_w[0]
    position = motion.root_pos_w[sample] - np.array([first[0], first[1], 0.0])
    position[:, :2] = origin[:, :2] + rotate_planar(origin[:, 2] - yaw0, position[:, :2])
    quat = quat_multiply(quat_from_yaw(origin[:, 2] - yaw0), motion.root_quat_wxyz[sample])
    return Track(position, quat, motion.joint_pos[sample], title, caption, ghost, motion.contact[sample])


def realised_feet(rollout: "Rollout", robot: Robot, episode: int = 0) -> Array:
    """Foot centres of an episode in the body frame (t, 4, 3), m; NaN from the fall on."""
    assert rollout.log is not None, "the feet need a rollout with its log"
    feet = foot_positions(robot, rollout.log.observation["joint_pos"][episode])
    feet[rollout.steps[episode] :] = np.nan
    return feet


def _cycle_origins(motion: Motion, cycles: int) -> Array:
    """(x, y, yaw) at which each cycle starts, (cycles, 3)."""
    origin = np.zeros((cycles, 3))
    for k in range(1, cycles):
        assert motion.cycle is not None
        origin[k, :2] = origin[k - 1, :2] + rotate_planar(origin[k - 1, 2], motion.cycle[:2])
        origin[k, 2] = origin[k - 1, 2] + motion.cycle[2]
    return origin
