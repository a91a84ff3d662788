"""What is shown is what was logged."""

import numpy as np
import pytest

from fastmimic.base.conventions import GRAVITY
from fastmimic.base.rotations import yaw_from_quat
from fastmimic.episode.rollout import Rollout
from fastmimic.motion.motion import Motion
from fastmimic.robot import Robot
from fastmimic.viewer.take import Take, cycle_rows, demonstration_samples, held, motion_take


def test_rows_are_those_of_the_log(take: Take, rollout: Rollout, a1: Robot) -> None:
    log = rollout.log
    assert log is not None
    for row in (0, 123, take.rows - 1):
        observation = log.observation[0, row]
        np.testing.assert_array_equal(take.pose[row, :3], observation["root_pos"])
        np.testing.assert_array_equal(take.pose[row, 3:7], observation["root_quat"])
        np.testing.assert_array_equal(take.pose[row, 7:], observation["joint_pos"])
        np.testing.assert_array_equal(take.reference[row, 7:], log.demonstration["joint_pos"][0, row])
        np.testing.assert_array_equal(take.wanted[row], log.wanted[0, row])
        np.testing.assert_array_equal(take.stance[row], log.stance[0, row])
        np.testing.assert_array_equal(take.terms[row], log.terms[0, row])
    loaded = log.observation["foot_force"][0, :, :, 2] > 0.02 * a1.mass * GRAVITY
    np.testing.assert_array_equal(take.measured, loaded)
    assert 0.1 < loaded.mean() < 0.9


def test_asked_forces_are_turned_into_the_world(take: Take, rollout: Rollout) -> None:
    log = rollout.log
    assert log is not None
    row = int(np.argmax(np.abs(log.force[0, :, :, :2]).sum(axis=(1, 2))))
    yaw = float(yaw_from_quat(take.pose[row, 3:7]))
    c, s = np.cos(yaw), np.sin(yaw)
    fx, fy, fz = log.force[0, row].T
    np.testing.assert_allclose(take.asked[row], np.stack([c * fx - s * fy, s * fx + c * fy, fz], axis=-1), atol=1e-12)


def test_cycles_start_where_the_motion_wraps(take: Take, trot: Motion) -> None:
    # row 0 is the state after the first step, sample 1: sample 0 comes again n − 1 rows later
    n = trot.n_samples
    expected = [0, *range(n - 1, take.rows, n)]
    np.testing.assert_array_equal(take.cycle_starts, expected)
    assert len(expected) > 2


def test_an_episode_may_start_anywhere(trot: Motion) -> None:
    samples = demonstration_samples(trot, trot.joint_pos[np.arange(100, 130)])
    np.testing.assert_array_equal(samples, np.arange(100, 130))
    at_the_end = demonstration_samples(trot, np.roll(trot.joint_pos, 3, axis=0))
    assert at_the_end[0] == trot.n_samples - 3
    assert at_the_end[3] == 0
    np.testing.assert_array_equal(cycle_rows(trot, at_the_end), [0, 3])


def test_a_motion_without_physics(trot: Motion, a1: Robot) -> None:
    take = motion_take(trot, a1, 2 * trot.period_s, "trot")
    n = trot.n_samples
    assert take.rows == 2 * n
    assert take.force is None
    assert take.terms is None
    np.testing.assert_array_equal(take.pose[n:, 7:], trot.joint_pos)
    np.testing.assert_array_equal(take.wanted[n:], trot.contact)
    np.testing.assert_array_equal(take.cycle_starts, [0, n])


def test_what_is_not_finite_is_held() -> None:
    pose = np.arange(4.0)[:, None] * np.ones(19)
    pose[2:, 5] = np.nan
    np.testing.assert_array_equal(held(pose)[:, 0], [0, 1, 1, 1])


@pytest.mark.parametrize(("row", "shown"), [(-5, 0), (3, 3), (10**6, None)])
def test_a_shorter_take_waits_at_its_end(take: Take, row: int, shown: int | None) -> None:
    assert take.clamp(row) == (take.rows - 1 if shown is None else shown)
