"""From motions and logs to what videos and figures take."""

import numpy as np
import pytest

from fastmimic.base.rotations import quat_rotate, yaw_from_quat
from fastmimic.clips.catalogue import open_clip
from fastmimic.experiments.measurement import foot_courses
from fastmimic.imitation.evaluate import evaluate
from fastmimic.motion.motion import Motion
from fastmimic.render.tracks import motion_track, rollout_track
from fastmimic.retargeting.retarget import retarget
from fastmimic.robot import Robot


@pytest.fixture(scope="module")
def turn(robot: Robot) -> Motion:
    """A cyclic motion that goes ahead and turns."""
    return retarget(open_clip("turn"), robot)[0]


def test_cycles_follow_one_another_without_a_step(turn: Motion) -> None:
    """A standing foot stays where it is, also where one cycle ends and the next begins."""
    track = motion_track(turn, 3 * turn.period_s)
    n = turn.n_samples
    assert len(track.pose) == 3 * n
    contact = np.tile(turn.contact, (3, 1))
    feet = np.tile(turn.foot_pos_b, (3, 1, 1))
    feet_w = track.pose[:, None, :3] + quat_rotate(track.pose[:, None, 3:7], feet)
    moved = np.linalg.norm(np.diff(feet_w[..., :2], axis=0), axis=-1)
    stands = contact[1:] & contact[:-1]
    assert moved[stands].max() < 3e-4  # it rolls, and a cycle closes within 1 mm; in swing it moves 5 mm a sample
    assert moved[n - 1][stands[n - 1]].size > 0  # some foot stands across the wrap


def test_a_track_starts_at_the_origin_and_turns_with_every_cycle(turn: Motion) -> None:
    assert turn.cycle is not None
    track = motion_track(turn, 2 * turn.period_s)
    np.testing.assert_allclose(track.pose[0, :2], 0, atol=1e-12)
    yaw = yaw_from_quat(track.pose[:, 3:7])
    turned = np.angle(np.exp(1j * (yaw[turn.n_samples] - yaw[0])))
    assert turned == pytest.approx(turn.cycle[2], abs=1e-9)


def test_a_motion_without_a_cycle_is_shown_once(turn: Motion) -> None:
    once = Motion(**{**vars(turn), "cycle": None})
    assert len(motion_track(once, 10.0).pose) == turn.n_samples


def test_a_rollout_keeps_the_demonstration_as_its_ghost(robot: Robot, turn: Motion) -> None:
    found = evaluate(turn, robot, duration_s=0.5, log=True)
    rollout, least = found.rollout, found.config.release_force(robot)
    track = rollout_track(rollout, least, "title")
    assert rollout.log is not None
    np.testing.assert_array_equal(track.contact, rollout.log.observation[0]["foot_force"][..., 2] > least)
    assert rollout.reward_animal[0] < rollout.reward[0] - 0.001
    assert (track.title, track.caption) == ("title", f"reward {rollout.reward_animal[0]:.2f}"), "against the animal"
    assert track.ghost is not None
    assert len(track.pose) == len(track.ghost) == 250
    np.testing.assert_allclose(track.pose[:, :3], track.ghost[:, :3], atol=0.05)  # it imitates


def test_feet_are_known_until_the_fall(robot: Robot, turn: Motion) -> None:
    rollout = evaluate(turn, robot, duration_s=0.5, log=True).rollout
    assert np.isfinite(foot_courses(rollout, robot)[1]).all()
    rollout.steps[0] = 100
    feet = foot_courses(rollout, robot)[1]
    assert np.isfinite(feet[:100]).all()
    assert np.isnan(feet[100:]).all()
