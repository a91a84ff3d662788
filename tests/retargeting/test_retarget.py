"""Retargeting: the robot's motion is consistent, within its limits, and still the animal's."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fastmimic.base.errors import ClipError, ConfigError
from fastmimic.base.rotations import (
    quat_conjugate,
    quat_from_rotvec,
    quat_from_yaw,
    quat_multiply,
    rotate_planar,
    rotvec_from_quat,
    yaw_from_quat,
)
from fastmimic.base.text import plain
from fastmimic.clips.clip import POINT_NAMES, Clip
from fastmimic.clips.formats import ReadOptions, read_clip
from fastmimic.clips.formats.points import robot_points
from fastmimic.clips.synthesis import generate
from fastmimic.motion.motion import Motion
from fastmimic.retargeting.retarget import RetargetReport, choose_scale, retarget
from fastmimic.retargeting.track import resample_open, resample_periodic
from fastmimic.robot import Robot, load_robot
from fastmimic.robot.kinematics import foot_positions

CUTS = {
    "pace": ("dog_walk00", 162, 201),
    "trot": ("dog_walk03", 448, 481),
    "canter": ("dog_run00", 430, 459),
    "right-turn": ("dog_walk09", 1085, 1124),
    "left-turn": ("dog_walk09", 2404, 2450),
}
FILES = ("dog_pace", "dog_spin", "dog_trot", "inplace_steps", "sidesteps", "turn")
FAST = ("canter",)
"""Whose legs move faster and further than the A1's can; the report says so."""


@pytest.fixture(scope="module")
def trot(a1: Robot) -> tuple[Motion, RetargetReport]:
    return retarget(generate("trot"), a1, executable=False)


def recorded(folder: Path, name: str) -> Clip:
    if name in FILES:
        return read_clip(folder / "deepmimic_motions" / f"{name}.txt")
    file, start, end = CUTS[name]
    return read_clip(folder / "dog_keypoints" / f"{file}_joint_pos.txt", ReadOptions(frames=(start, end)))


def assert_closed(motion: Motion, most_m: float = 1e-3) -> None:
    """Root and feet of sample 0, a cycle later, are where the last sample's go on to, and the trunk turns on."""
    assert motion.cycle is not None
    points = np.concatenate([motion.root_pos_w[:, None], motion.foot_pos_w], axis=1)
    (x, y, turn), yaw = motion.cycle, yaw_from_quat(motion.root_quat_wxyz[0])
    away = points[0] - motion.root_pos_w[0] * [1.0, 1.0, 0.0]
    away[:, :2] = rotate_planar(turn, away[:, :2]) + rotate_planar(yaw, np.array([x, y])) + motion.root_pos_w[0, :2]
    continued = points[-3] - 3 * points[-2] + 3 * points[-1]
    assert np.linalg.norm(continued - away, axis=-1).max() < most_m
    rotated = quat_from_rotvec((1.5 * motion.root_ang_vel_w[-1] - 0.5 * motion.root_ang_vel_w[-2]) * motion.dt)
    ahead = quat_multiply(rotated, motion.root_quat_wxyz[-1])
    repeated = quat_multiply(quat_from_yaw(turn), motion.root_quat_wxyz[0])
    apart = rotvec_from_quat(quat_multiply(ahead, quat_conjugate(repeated)))
    assert np.degrees(np.linalg.norm(apart)) < 0.1


@pytest.mark.parametrize("name", [*CUTS, *FILES])
def test_real_clips_are_consistent_and_still_the_animal(data_folder: Path, a1: Robot, name: str) -> None:
    """The bounds of consistency and fidelity, on every listed cut with one rule."""
    motion, report = retarget(recorded(data_folder, name), a1, executable=False)
    assert report.is_cycle
    most = 5e-3 if name in FAST else 1e-3
    assert max(report.after.slip_m) < most
    assert_closed(motion, most)
    assert np.all(motion.joint_pos >= a1.joint_lower)
    assert np.all(motion.joint_pos <= a1.joint_upper)
    for bound in report.bounds:
        excused = bound.reason and (bound.name == "duty change" or "joint speed" in bound.name or name in FAST)
        assert bound.met or excused, f"{bound.name}: {bound.value} of {bound.limit}"


def test_known_figures_of_the_real_turns(data_folder: Path, a1: Robot) -> None:
    """Yaw a cycle as measured on the recordings: −38.5° and 98.8° from the first frame to the last, one frame short."""
    for name, yaw in (("right-turn", -38.5), ("left-turn", 98.8)):
        motion, _ = retarget(recorded(data_folder, name), a1, executable=False)
        assert motion.cycle is not None
        assert np.degrees(motion.cycle[2]) == pytest.approx(yaw, abs=2.0)


def test_a_whole_take_is_not_a_cycle_and_its_cut_is_one(data_folder: Path, a1: Robot) -> None:
    take = read_clip(data_folder / "dog_keypoints" / "dog_walk00_joint_pos.txt", ReadOptions(frames=(100, 260)))
    motion, report = retarget(take, a1, executable=False)
    assert motion.cycle is None
    assert "a passage that is run once (2.7 s" in report.cycle_reason
    assert motion.period_s == pytest.approx(159 / 60, abs=0.002)
    assert min(report.stances) >= 3
    assert retarget(take.cut(62, 101), a1, executable=False)[0].cycle is not None
    open_ended = retarget(take.cut(0, 90), a1, executable=False)
    assert open_ended[0].cycle is None
    assert "not a cycle (its ends differ by" in open_ended[1].cycle_reason


def test_standing_feet_rest_on_the_ground_and_no_foot_is_below_it(a1: Robot, trot) -> None:  # type: ignore[no-untyped-def]
    motion, _ = trot
    height = motion.foot_pos_w[..., 2]
    assert height[motion.contact] == pytest.approx(a1.foot_radius, abs=1e-9)
    assert height.min() > a1.foot_radius - 1e-9


def test_feet_land_and_leave_at_rest(trot) -> None:  # type: ignore[no-untyped-def]
    """Speed over the ground just before touch-down and just after lift-off is a hundredth of that in mid-swing."""
    motion, _ = trot
    speed = np.linalg.norm(np.diff(motion.foot_pos_w, axis=0), axis=-1) * motion.rate_hz
    lands = ~motion.contact[:-1] & motion.contact[1:]
    leaves = motion.contact[:-1] & ~motion.contact[1:]
    assert speed[lands | leaves].max() < 0.02 * speed.max()


def test_joints_feet_and_velocities_agree(a1: Robot, trot) -> None:  # type: ignore[no-untyped-def]
    motion, _ = trot
    assert foot_positions(a1, motion.joint_pos) == pytest.approx(motion.foot_pos_b, abs=1e-12)
    dt = motion.dt

    def central(values: np.ndarray) -> np.ndarray:
        return (values[2:] - values[:-2]) / (2 * dt)

    assert central(motion.joint_pos) == pytest.approx(motion.joint_vel[1:-1], abs=0.1)
    assert central(motion.root_pos_w) == pytest.approx(motion.root_lin_vel_w[1:-1], abs=1e-3)
    q = motion.root_quat_wxyz
    turn = rotvec_from_quat(quat_multiply(q[1:], q[:-1] * np.array([1.0, -1.0, -1.0, -1.0])))
    assert turn / dt == pytest.approx((motion.root_ang_vel_w[1:] + motion.root_ang_vel_w[:-1]) / 2, abs=2e-3)


@pytest.mark.parametrize("name", ["turn", "spin", "trot"])
def test_the_cycle_repeats_moved_by_its_displacement(a1: Robot, name: str) -> None:
    """Root and heading one sample beyond the end, from the last two samples, against sample 0 moved by `cycle`."""
    motion, _ = retarget(generate(name), a1)
    assert motion.cycle is not None
    p, q = motion.root_pos_w, motion.root_quat_wxyz
    yaw0 = np.arctan2(2 * (q[0, 0] * q[0, 3] + q[0, 1] * q[0, 2]), 1 - 2 * (q[0, 2] ** 2 + q[0, 3] ** 2))
    end = p[0, :2] + rotate_planar(yaw0, motion.cycle[:2])
    ahead = 3 * p[-1] - 3 * p[-2] + p[-3]
    assert ahead[:2] == pytest.approx(end, abs=1e-4)
    assert ahead[2] == pytest.approx(p[0, 2], abs=1e-4)
    repeated = quat_multiply(quat_from_yaw(motion.cycle[2]), q[0])
    angle = np.linalg.norm(rotvec_from_quat(quat_multiply(repeated, q[-1] * np.array([1.0, -1.0, -1.0, -1.0]))))
    assert angle == pytest.approx(np.linalg.norm(motion.root_ang_vel_w[-1]) * motion.dt, abs=1e-4)


def test_a_straight_gait_is_turned_into_its_direction_of_travel(a1: Robot) -> None:
    clip = generate("trot")
    skewed = clip.points_w.copy()
    travel = np.linspace(0, 1, clip.n_frames)[:, None] * 0.1 * (clip.points_w[-1, 0, 0] - clip.points_w[0, 0, 0])
    skewed[..., 1] += travel  # drifts to the left by a tenth of the way
    _, report = retarget(replace(clip, points_w=skewed), a1, executable=False)
    assert report.heading_aligned_deg == pytest.approx(np.degrees(np.arctan(0.1)), abs=0.5)
    assert retarget(generate("side-step"), a1, executable=False)[1].heading_aligned_deg == 0.0


def test_going_backwards_is_not_mended(a1: Robot) -> None:
    motion, _ = retarget(generate("backward-trot"), a1)
    assert motion.cycle is not None
    assert motion.cycle[0] < -0.2
    assert np.all(motion.root_quat_wxyz[:, 0] > 0.99)


def test_a_cut_that_does_not_close_is_closed(a1: Robot) -> None:
    """One foot 8 cm further at the end than at the beginning."""
    clip = generate("walk")
    bent = clip.points_w.copy()
    bent[:, 6, 0] += 0.1 * np.linspace(0, 1, clip.n_frames) ** 3
    motion, report = retarget(replace(clip, points_w=bent), a1, executable=False)
    assert report.closure_m > 0.05
    assert_closed(motion)
    assert max(report.after.slip_m) < 1e-3


def test_a_robots_own_motion_comes_back_nearly_unchanged(a1: Robot, trot) -> None:  # type: ignore[no-untyped-def]
    motion, _ = trot
    points = robot_points(motion.root_pos_w, motion.root_quat_wxyz, a1.hip_pos_b, motion.foot_pos_b)
    clip = Clip(points, motion.rate_hz, root_quat_wxyz=motion.root_quat_wxyz, is_cycle=True, scale=1.0)
    again, report = retarget(clip, a1)
    assert np.sqrt(np.mean((again.foot_pos_b - motion.foot_pos_b) ** 2)) < 0.01
    assert report.base_height_m == pytest.approx(motion.root_pos_w[:, 2].mean(), abs=0.005)
    assert np.abs(np.array(report.foot_offset_m)).max() == 0.0


def test_other_robots_scale_by_their_legs(a1: Robot) -> None:
    go2 = load_robot("go2")
    small, large = (retarget(generate("walk"), robot, executable=False)[1] for robot in (a1, go2))
    assert small.scale == pytest.approx(0.825)
    assert large.scale / small.scale == pytest.approx(go2.leg_length / a1.leg_length)
    assert retarget(generate("walk"), a1, scale=0.7, executable=False)[1].scale == 0.7


@pytest.mark.parametrize("size", [0.3, 0.5, 2.0, 3.5])
def test_an_animal_of_another_size_has_its_own_scale(a1: Robot, size: float) -> None:
    walk = generate("walk")
    _, report = retarget(replace(walk, points_w=size * walk.points_w), a1, executable=False)
    assert report.scale * size == pytest.approx(0.825, rel=0.1)
    assert min(report.after.clearance_m) > 0.04


def test_legs_that_are_folded_do_not_make_the_animal_small(a1: Robot) -> None:
    walk = generate("walk")
    low = walk.points_w - np.where(np.char.find(POINT_NAMES, "toe") < 0, 0.25, 0.0)[:, None] * [0.0, 0.0, 1.0]
    assert choose_scale(replace(walk, points_w=low), a1) == pytest.approx(0.825)


def test_other_rates_give_the_same_motion(a1: Robot, trot) -> None:  # type: ignore[no-untyped-def]
    motion, _ = trot
    fast, _ = retarget(generate("trot"), a1, rate_hz=1000.0, executable=False)
    assert fast.n_samples == 2 * motion.n_samples
    assert np.sqrt(np.mean((fast.joint_pos[::2] - motion.joint_pos) ** 2)) < 0.02


def test_report_is_json_and_readable(trot) -> None:  # type: ignore[no-untyped-def]
    motion, report = trot
    assert motion.provenance.retarget == json.loads(json.dumps(plain(report)))
    assert {"name", "robot", "source", "licence", "retarget"} <= motion.provenance.as_dict().keys()
    text = "\n".join(report.lines())
    assert "slip in stance" in text
    assert "NOT MET" not in text
    assert all(bound.met for bound in report.bounds)


def test_the_same_clip_gives_the_same_bits(a1: Robot, trot) -> None:  # type: ignore[no-untyped-def]
    again, _ = retarget(generate("trot"), a1, executable=False)
    assert np.array_equal(again.joint_pos, trot[0].joint_pos)


def test_errors_say_what_is_wrong(a1: Robot) -> None:
    clip = generate("trot")
    with pytest.raises(ConfigError, match="rate of a motion must be positive, found 0"):
        retarget(clip, a1, rate_hz=0.0)
    with pytest.raises(ConfigError, match="scale must be positive, found -1"):
        retarget(clip, a1, scale=-1.0)
    with pytest.raises(ConfigError, match=r"is 0.01 to 100, found 1e-06"):
        retarget(clip, a1, scale=1e-6)
    with pytest.raises(ClipError, match="every paw is at its hip"):
        retarget(replace(clip, points_w=np.zeros_like(clip.points_w)), a1)
    with pytest.raises(ClipError, match="opened by its name or file, found None"):
        retarget(None, a1)  # type: ignore[arg-type]
    with pytest.raises(ClipError, match="at least 8 frames, found 5"):
        retarget(clip.cut(0, 5), a1)


def still(clip: Clip, height: float, drift: float) -> Clip:
    """An animal that stands with its hips at `height`, m, and drifts, m over the clip, as markers do."""
    points = np.repeat(clip.points_w[:1], clip.n_frames, axis=0)
    points[:, 6:10, 2] = 0.015
    points[:, :6, 2] += height - points[:, 2:6, 2].mean()
    points[..., 0] += drift * np.linspace(0, 1, clip.n_frames)[:, None]
    return replace(clip, points_w=points, root_quat_wxyz=None)


def test_an_animal_that_sits_makes_the_robot_crouch_as_low_as_it_can(a1: Robot) -> None:
    motion, report = retarget(still(generate("walk"), 0.15, 0.0), a1, cycle=True, executable=False)
    assert motion.contact.all()
    assert report.lowered_m < -0.01
    assert "raised" in "\n".join(report.lines())
    assert sum(report.joint_limited) == 0
    assert max(report.after.slip_m) < 1e-3
    assert motion.root_pos_w[:, 2].max() < 0.22
    high, _ = retarget(still(generate("walk"), 0.36, 0.0), a1, cycle=True, executable=False)
    assert high.provenance.as_dict()["retarget"]["lowered_m"] >= 0.0


def test_who_lifts_no_foot_does_not_travel(a1: Robot) -> None:
    motion, report = retarget(still(generate("walk"), 0.36, 0.02), a1, cycle=True, executable=False)
    assert motion.contact.all()
    assert motion.cycle == pytest.approx(np.zeros(3), abs=1e-6)
    assert_closed(motion)
    assert max(report.after.slip_m) < 1e-3


def test_a_foot_that_stands_while_the_others_walk_is_given_a_step(a1: Robot) -> None:
    clip = generate("walk")
    points = clip.points_w.copy()
    points[:, 6, 2] = 0.015
    points[:, 6, :2] = points[:1, 6, :2]
    motion, report = retarget(replace(clip, points_w=points), a1, cycle=True, executable=False)
    assert report.changes.steps == 1
    assert_closed(motion)
    assert max(report.after.slip_m) < 1e-3
    assert not motion.contact[:, 0].all()
    duty = next(bound for bound in report.bounds if bound.name == "duty change")
    assert "given a step" in duty.reason


@settings(deadline=None)
@given(st.integers(12, 60), st.integers(40, 400), st.floats(-np.pi, np.pi))
def test_resampling_keeps_what_is_slow_and_drops_what_is_fast(n: int, n_out: int, phase: float) -> None:
    """One cycle a period passes a filter at four times that; five times the filter's frequency does not."""
    grid, out = np.arange(n) / n, np.arange(n_out) / n_out
    slow = np.sin(2 * np.pi * grid + phase)
    passed = resample_periodic(slow, n, n_out, 4.0)
    assert passed == pytest.approx(np.sin(2 * np.pi * out + phase), abs=1e-4)
    fast = np.sin(2 * np.pi * (n // 2 - 1) * grid)
    assert np.abs(resample_periodic(fast, n, n_out, (n // 2 - 1) / 5)).max() < 1e-4


def test_an_open_recording_keeps_its_ends() -> None:
    line = np.linspace(1.0, 3.0, 50)
    out = resample_open(line, 50.0, 490, 6.0)
    assert out == pytest.approx(1.0 + 2.0 * np.arange(490) / 490, abs=1e-9)
