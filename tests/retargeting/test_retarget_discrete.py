"""Retargeting of what does not repeat: it begins and ends as the animal does, and the robot can take its postures."""

from pathlib import Path

import numpy as np
import pytest

from fastmimic.base.rotations import matrix_from_quat
from fastmimic.clips.catalogue import open_clip
from fastmimic.clips.clip import POINT_NAMES, Clip
from fastmimic.clips.synthesis import GaitSpec, keypoints
from fastmimic.episode.feasibility import demands
from fastmimic.motion.motion import Motion
from fastmimic.retargeting.retarget import RetargetReport, retarget
from fastmimic.robot import Robot

RATE_HZ, FRAMES = 60.0, 90
STANDING = GaitSpec(about="stand", lift=0.0, bob=0.0, pitch=0.0, yaw=0.0)
RUMP = [POINT_NAMES.index(name) for name in ("pelvis", "RR_hip", "RL_hip")]


def sitting_down() -> Clip:
    """A standing animal that puts its rump on the ground within half a second, and stays."""
    points = np.repeat(keypoints(STANDING).points_w[:1], FRAMES, axis=0)
    s = np.clip((np.arange(FRAMES) / RATE_HZ - 0.4) / 0.5, 0.0, 1.0)
    down = s**3 * (10 - 15 * s + 6 * s**2)
    points[:, RUMP, 2] -= down[:, None] * (points[0, RUMP[1], 2] - 0.05)
    return Clip(points_w=points, rate_hz=RATE_HZ, is_cycle=False).named("sit")


@pytest.fixture(scope="module")
def sit(a1: Robot) -> tuple[Motion, RetargetReport]:
    return retarget(sitting_down(), a1)


@pytest.fixture(scope="module")
def once(a1: Robot) -> tuple[Motion, RetargetReport]:
    """A cycle of a trot, once."""
    return retarget(open_clip("trot", robot=a1, cycle=False), a1)


Retargeted = tuple[Motion, RetargetReport]


def pitch(motion: Motion) -> np.ndarray:
    return -np.arcsin(matrix_from_quat(motion.root_quat_wxyz)[:, 2, 0])


class TestSitting:
    def test_standing_is_level_and_sitting_is_not(self, sit: Retargeted) -> None:
        angles = np.degrees(pitch(sit[0]))
        assert abs(angles[0]) < 3
        assert angles[-1] < -5

    def test_it_goes_no_lower_than_folded_legs_do(self, sit: Retargeted, a1: Robot) -> None:
        motion, report = sit
        assert motion.root_pos_w[-1, 2] < motion.root_pos_w[0, 2] - 0.03
        assert demands(a1, motion).body_clearance_m > 0
        assert max(report.after.slip_m) < 1e-3
        assert sum(report.unreachable) + sum(report.joint_limited) == 0

    def test_who_ends_standing_is_held_there_at_rest(self, sit: Retargeted) -> None:
        motion, report = sit
        assert motion.provenance.held_s == pytest.approx(0.5)
        assert "ends standing, and is held for 0.5 s" in report.cycle_reason
        assert motion.period_s == pytest.approx((FRAMES - 1) / RATE_HZ + 0.5, abs=0.003)
        last = slice(-50, None)
        assert np.all(motion.contact[last])
        assert np.abs(motion.root_lin_vel_w[last]).max() < 0.02
        assert np.abs(motion.joint_vel[last]).max() < 0.2
        np.testing.assert_allclose(motion.root_lin_vel_w[-1], 0, atol=2e-3)


class TestOnce:
    def test_a_piece_that_ends_in_mid_stride_is_not_held(self, once: Retargeted) -> None:
        motion, report = once
        assert motion.cycle is None
        assert motion.provenance.held_s is None
        assert report.cycle_reason == "not a cycle, as the clip says"

    def test_it_is_consistent(self, once: Retargeted) -> None:
        motion, report = once
        assert max(report.after.slip_m) < 1e-3
        assert report.closure_m == 0
        steps = np.diff(motion.root_pos_w, axis=0) * motion.rate_hz
        np.testing.assert_allclose(motion.root_lin_vel_w[1:-1], (steps[1:] + steps[:-1]) / 2, atol=0.02)

    def test_how_it_begins_and_ends_is_the_animals_own(self, once: Retargeted, a1: Robot) -> None:
        """Speeds at the ends are those beside them: a trunk that is free to move there falls."""
        velocity = once[0].root_lin_vel_w
        assert np.abs(velocity[0] - velocity[15]).max() < 0.1
        assert np.abs(velocity[-1] - velocity[-16]).max() < 0.1

    def test_a_cycle_is_one_unless_it_is_asked_for_once(self, a1: Robot) -> None:
        assert retarget(open_clip("trot", robot=a1), a1)[0].cycle is not None
        assert open_clip("trot", frames=(0, 20), cycle=False).is_cycle is False


@pytest.mark.parametrize(("take", "first", "end"), [("dog_walk09", 2404, 2450), ("dog_walk00", 35, 94)])
def test_pieces_of_a_real_take(data_folder: Path, a1: Robot, take: str, first: int, end: int) -> None:
    """A turn on the spot; getting up from sitting."""
    file = data_folder / "dog_keypoints" / f"{take}_joint_pos.txt"
    motion, report = retarget(open_clip(file, robot=a1, frames=(first, end), cycle=False), a1)
    assert max(report.after.slip_m) < 1e-3
    assert demands(a1, motion).body_clearance_m > 0
    assert motion.period_s == pytest.approx((end - first - 1) / 60, abs=0.003)
