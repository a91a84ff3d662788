"""Gaits at many velocities out of one."""

import numpy as np
import pytest

from clips.test_segment import cycles
from fastmimic.base.arrays import Flags
from fastmimic.base.errors import ClipError, MotionError
from fastmimic.base.rotations import rotate_planar, yaw_from_quat
from fastmimic.clips.catalogue import open_clip
from fastmimic.clips.clip import Clip, ClipOrigin
from fastmimic.clips.synthesis import gait, keypoints
from fastmimic.reference.course import COURSE, course_of
from fastmimic.reference.regulator import motion_gains
from fastmimic.reference.regulator_config import RegulatorConfig
from fastmimic.reference.standing import standing
from fastmimic.reference.table import GAIN_SAMPLES, SAMPLE
from fastmimic.retargeting.retarget import retarget
from fastmimic.robot import Robot, load_robot
from fastmimic.steering.change import rows_to_change
from fastmimic.steering.gait_field import RATE_HZ, GaitField, Grid, gait_field, gaits_of
from fastmimic.steering.steered import Steered


@pytest.mark.parametrize("name", ["trot", "walk", "turn", "pace"])
@pytest.mark.parametrize("velocity", [(0.0, 0.0, 0.0), (-0.4, 0.1, 0.0), (0.7, -0.2, 0.0), (0.5, 0.1, 1.5)])
def test_a_cycle_at_another_velocity_keeps_its_contacts(name: str, velocity: tuple[float, float, float]) -> None:
    robot = load_robot("a1")
    clip = open_clip(name, robot=robot)
    own, _ = retarget(clip, robot, executable=False)
    motion, _ = retarget(clip, robot, velocity=np.array(velocity), executable=False)
    np.testing.assert_array_equal(motion.contact, own.contact)
    assert motion.cycle is not None
    assert motion.cycle[2] / motion.period_s == pytest.approx(velocity[2], abs=1e-9)
    heading = np.unwrap(yaw_from_quat(motion.root_quat_wxyz))
    way = rotate_planar(-heading[:-1], np.diff(motion.root_pos_w[:, :2], axis=0)) * motion.rate_hz
    np.testing.assert_allclose(way.mean(axis=0), velocity[:2], atol=0.03)
    stands = motion.contact[1:] & motion.contact[:-1]
    slid = np.linalg.norm(np.diff(motion.foot_pos_w[..., :2], axis=0), axis=-1)
    assert slid[stands].max() < 1e-6


def test_a_gait_in_which_all_feet_never_stand_comes_to_stand() -> None:
    robot, axes = load_robot("a1"), ((0.0, 0.7), (-0.2, 0.2), (1.0, 1.0))
    clip = keypoints(gait("trot", speed=0.7, duty=0.4), ClipOrigin("a trot with flight"))
    found = [retarget(clip, robot, velocity=np.array(v), executable=False)[0] for v in Grid(*axes).velocities()]
    assert found[0].contact.sum(axis=1).max() < 4
    config, n = RegulatorConfig(), found[0].n_samples
    stand, gains = standing(robot), [motion_gains(motion, robot, config) for motion in found]
    rows = [*(course_of(motion, robot) for motion in found), np.repeat(course_of(stand, robot)[:1], n)]
    gains.append(np.repeat(motion_gains(stand, robot, config)[:1], len(gains[0])))
    steered = Steered(GaitField("trot", robot, *map(np.array, axes), np.stack(rows), np.stack(gains)))

    def advance(seconds: float) -> float:
        fastest, table, before = 0.0, np.zeros(1, SAMPLE), None
        for _ in range(round(seconds * 500)):
            steered.fill(table)
            now = table["joint_pos"][0].copy()
            fastest = fastest if before is None else max(fastest, float(np.abs(now - before).max()) * 500)
            before = now
            steered.advance(steered.place["pose"][0, :2].copy())
        return fastest

    assert steered.state == "standing"
    steered.steer(np.array([0.7, 0.0, 0.0]))
    advance(2.0)
    assert steered.place["velocity"][0, 0] == pytest.approx(0.7, abs=0.01)
    steered.steer(np.zeros(3))
    assert advance(2.0) < robot.joint_speed_limit.max()
    assert steered.state == "standing"
    assert advance(0.2) < 0.05


def test_a_clip_that_does_not_repeat_is_no_gait() -> None:
    with pytest.raises(ClipError, match=r"jump is not one period of a gait; 'fastmimic segment' finds"):
        gait_field("a1", [open_clip("jump")])


def test_takes_give_a_period_of_each_gait_that_repeats_well() -> None:
    bound, noted = open_clip("bound"), list[str]()
    found = gaits_of([bound, cycles("trot", 6), cycles("walk", 6)], noted.append)
    assert found[0] is bound
    assert [clip.origin.name for clip in found[1:]] == ["walk", "trot"]
    lengths = {clip.origin.name: clip.n_frames for clip in found[1:]}
    assert lengths == {name: open_clip(name).n_frames for name in ("walk", "trot")}
    assert len(noted) == 2
    assert " is a period of a trot, " in "".join(noted)
    still = Clip(np.repeat(bound.points_w[-1:], 120, axis=0), bound.rate_hz)
    assert gaits_of([still]) == [still]


def test_a_fast_gait_that_the_robot_cannot_do_is_left_out(
    robot: Robot, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    too_much = "walk"

    def field(source: str, clip: Clip, robot: Robot, grid: Grid, slower: GaitField | None, *_: object) -> GaitField:
        if clip.origin.name == too_much:
            raise MotionError(f"{robot.name} cannot be steered by {too_much}")
        axes = [np.array(axis) for axis in (grid.forwards, grid.sideways, grid.turning)]
        return GaitField(clip.origin.name, robot, *axes, np.zeros((4, 1), COURSE), np.zeros((4, 1)), slower)

    monkeypatch.setattr("fastmimic.steering.gait_field._field", field)
    with pytest.raises(MotionError, match="by walk"):
        gait_field("a1")
    too_much = "canter"
    assert [gait.name for gait in gait_field("a1").chain()] == ["trot", "walk"]
    assert caplog.messages == ["left out: a1 cannot be steered by canter"]


def test_a_gait_that_cannot_be_slow_has_passages_at_the_nearest_speeds(gaits: GaitField) -> None:
    assert gaits.passages is not None
    assert gaits.slower is not None
    assert gaits.slower.passages is None
    up, down = gaits.passages
    slow, fast = gaits.slower.forwards[-1], gaits.forwards[0]
    assert (up.before, up.after, down.before, down.after) == (slow, fast, fast, slow)
    for passage, one, other in ((up, gaits.slower, gaits), (down, gaits, gaits.slower)):
        rows, before = passage.field.rows[0], one.rows[one.straight(passage.before)]
        after = other.rows[other.straight(passage.after)]
        assert (rows["contact"][0] == before["contact"][passage.leave % len(before)]).all()
        np.testing.assert_allclose(rows["root_z"][0], before["root_z"][passage.leave % len(before)], atol=2e-3)
        np.testing.assert_allclose(rows["root_z"][passage.n - 1], after["root_z"][passage.arrive - 1], atol=2e-3)
        np.testing.assert_array_equal(rows[passage.n :], np.roll(after, -passage.arrive))
        assert passage.field.gains.shape[1] == -(-len(rows) // GAIN_SAMPLES)


def stands(*contacts: tuple[int, int, int, int]) -> Flags:
    """Which feet stand, for a tenth of a second each."""
    return np.repeat(np.array(contacts, bool), round(0.1 * RATE_HZ), axis=0)


def test_a_pace_is_not_entered_from_a_trot_on_feet_that_are_in_the_air() -> None:
    trot = stands((1, 0, 0, 1), (0, 1, 1, 0))
    pace = stands((1, 0, 1, 0), (0, 1, 0, 1))
    walking_trot = stands((1, 1, 1, 1), (1, 0, 0, 1), (1, 1, 1, 1), (0, 1, 1, 0))
    assert (rows_to_change(trot, pace, RATE_HZ) < 0).all()
    assert (rows_to_change(pace, trot, RATE_HZ) < 0).all()
    assert (rows_to_change(trot, trot, RATE_HZ) >= 0).any()
    assert (rows_to_change(trot, walking_trot, RATE_HZ) >= 0).any()
