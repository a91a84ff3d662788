"""Stitching: whole cycles as they are, and in between a motion that a robot with feet on the ground can make."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from control.motions import standing
from fastmimic.base.errors import ConfigError, MotionError
from fastmimic.base.rotations import quat_rotate_inverse, rotate_planar, yaw_from_quat
from fastmimic.episode.feasibility import demands
from fastmimic.motion.contacts import stances_of
from fastmimic.motion.motion import Motion
from fastmimic.robot import Robot, load_robot
from fastmimic.runs.loading import load_motion
from fastmimic.stitching.join import default_cycles, stitch_motions
from fastmimic.stitching.switch import MAX_ACCELERATION
from fastmimic.stitching.transition import Layout


def named(motion: Motion, name: str) -> Motion:
    return dataclasses.replace(motion, provenance=dataclasses.replace(motion.provenance, name=name))


@pytest.fixture(scope="module")
def trot(robot: Robot) -> Motion:
    return load_motion("trot", robot)


@pytest.fixture(scope="module")
def turn(robot: Robot) -> Motion:
    return load_motion("turn", robot)


@pytest.fixture(scope="module")
def pace(robot: Robot) -> Motion:
    return load_motion("pace", robot)


@pytest.fixture(scope="module")
def three(robot: Robot, trot: Motion, turn: Motion) -> Motion:
    """Trot, turn, trot, as in the paper."""
    return stitch_motions(robot, [trot, turn, trot], [4, 3, 4])


@pytest.fixture(scope="module")
def paced(robot: Robot, trot: Motion, pace: Motion) -> Motion:
    """Pace, trot: two legs have to change partners."""
    return stitch_motions(robot, [pace, trot], [4, 4])


@pytest.fixture(params=["three", "paced"])
def stitched(request: pytest.FixtureRequest) -> Motion:
    return request.getfixturevalue(request.param)


def pure(motion: Motion) -> np.ndarray:
    """(n,) whether a sample lies outside all transitions."""
    keep = np.ones(motion.n_samples, dtype=bool)
    for segment in Layout.of(motion).segments[1:]:
        assert segment.rebuilt is not None
        keep[segment.rebuilt.start : segment.rebuilt.end] = False
    return keep


class TestWhatIsKept:
    def test_outside_the_transitions_every_sample_is_the_cycles(self, stitched: Motion) -> None:
        keep = pure(stitched)
        assert keep.mean() > 0.3
        for segment in Layout.of(stitched).segments:
            part = stitched.parts[segment.part]
            t = np.flatnonzero(keep)
            t = t[(t >= segment.first) & (t < segment.last)]
            at = (t - segment.shift) % part.n_samples
            for name in ("joint_pos", "joint_vel", "foot_pos_b", "contact"):
                np.testing.assert_array_equal(getattr(stitched, name)[t], getattr(part, name)[at], err_msg=name)
            np.testing.assert_allclose(stitched.root_pos_w[t, 2], part.root_pos_w[at, 2], atol=1e-12)
            # as seen from the body it moves as it did
            for name in ("root_lin_vel_w", "root_ang_vel_w"):
                body = quat_rotate_inverse(stitched.root_quat_wxyz[t], getattr(stitched, name)[t])
                own = quat_rotate_inverse(part.root_quat_wxyz[at], getattr(part, name)[at])
                np.testing.assert_allclose(body, own, atol=1e-9, err_msg=name)

    def test_the_same_motion_twice_is_the_motion_itself(self, robot: Robot, trot: Motion) -> None:
        twice = stitch_motions(robot, [trot, trot], [3, 3])
        assert twice.n_samples == 6 * trot.n_samples
        assert len(twice.parts) == 1
        at = np.arange(twice.n_samples) % trot.n_samples
        np.testing.assert_array_equal(twice.contact, trot.contact[at])
        cycles = np.arange(twice.n_samples) // trot.n_samples
        assert trot.cycle is not None
        x = trot.root_pos_w[at, 0] + cycles * trot.cycle[0]
        np.testing.assert_allclose(twice.root_pos_w[:, 0], x, atol=0.02)  # but for the transition
        assert np.abs(twice.joint_pos - trot.joint_pos[at]).max() < 0.25

    def test_segments_have_their_cycles(self, three: Motion) -> None:
        layout = Layout.of(three)
        assert [s.name for s in layout.segments] == ["trot", "turn", "trot"]
        assert [s.cycles for s in layout.segments] == [4, 3, 4]
        assert [s.part for s in layout.segments] == [0, 1, 0]
        for segment in layout.segments:
            length = segment.cycles * three.parts[segment.part].n_samples
            # each of its ends within half a cycle
            assert abs(segment.last - segment.first - length) <= three.parts[segment.part].n_samples + 2

    def test_the_last_cycle_is_whole(self, three: Motion) -> None:
        segment = Layout.of(three).segments[-1]
        assert (three.n_samples - segment.shift) % three.parts[segment.part].n_samples == 0


class TestTransitions:
    def test_nothing_jumps(self, stitched: Motion) -> None:
        """Velocities are the derivatives of the positions, everywhere."""
        dt = stitched.dt
        steps = {
            "root_pos_w": stitched.root_lin_vel_w,
            "joint_pos": stitched.joint_vel,
        }
        for name, velocity in steps.items():
            moved = np.diff(getattr(stitched, name), axis=0) / dt
            mean = 0.5 * (velocity[1:] + velocity[:-1])
            # the test's gaits start and end their swings with a kink in the acceleration
            assert np.abs(moved - mean).max() < 0.02 * np.abs(velocity).max() + 0.02, name

    def test_joints_go_smoothly_into_a_transition_and_out_of_it(self, stitched: Motion) -> None:
        """It was put in as it was solved, some mrad off between the nodes: a joint's speed jumped by 3 rad/s."""
        jerk = np.abs(np.diff(stitched.joint_pos, 3, axis=0)).max(axis=1) / stitched.dt**3
        for segment in Layout.of(stitched).segments[1:]:
            assert segment.rebuilt is not None
            for seam in (segment.rebuilt.start, segment.rebuilt.end):
                assert jerk[seam - 3 : seam + 1].max() < np.quantile(jerk, 0.99)

    def test_standing_feet_stand_still(self, stitched: Motion, robot: Robot) -> None:
        assert demands(robot, stitched).slide_m < 3e-3  # but for what they roll, in a turn about a fixed heading
        height = stitched.foot_pos_w[..., 2][stitched.contact]
        np.testing.assert_allclose(height, robot.foot_radius, atol=1e-3)

    def test_no_foot_goes_below_the_ground(self, stitched: Motion, robot: Robot) -> None:
        assert stitched.foot_pos_w[..., 2].min() > robot.foot_radius - 1e-3

    def test_joints_keep_their_limits(self, stitched: Motion, robot: Robot) -> None:
        assert np.all(stitched.joint_pos >= robot.joint_lower)
        assert np.all(stitched.joint_pos <= robot.joint_upper)
        assert np.all(np.abs(stitched.joint_vel) <= robot.joint_speed_limit)

    def test_feet_and_joints_agree(self, stitched: Motion, robot: Robot) -> None:
        from fastmimic.robot.kinematics import foot_positions

        np.testing.assert_allclose(foot_positions(robot, stitched.joint_pos), stitched.foot_pos_b, atol=1e-9)

    def test_legs_stand_as_they_do_in_the_motions(self, three: Motion) -> None:
        """Between two trots there is no moment on one diagonal's foot alone."""
        assert three.contact.sum(axis=1).min() >= 2
        swings = [
            (b - a)
            for leg in range(4)
            for a, b in stances_of(~three.contact[:, leg], periodic=False)
            if a > 0 and b < three.n_samples
        ]
        assert min(swings) * three.dt > 0.15

    def test_speed_and_heading_change_gradually(self, three: Motion, trot: Motion) -> None:
        """Averaged over a stride, the trunk accelerates no more than it may."""
        v = rotate_planar(-yaw_from_quat(three.root_quat_wxyz), three.root_lin_vel_w[:, :2])
        stride = trot.n_samples
        mean = np.stack([np.convolve(c, np.ones(stride) / stride, mode="valid") for c in v.T], axis=1)
        acceleration = np.linalg.norm(np.gradient(mean, three.dt, axis=0), axis=1)
        assert acceleration.max() < 1.5 * MAX_ACCELERATION
        yaw = np.unwrap(yaw_from_quat(three.root_quat_wxyz))
        assert np.abs(np.diff(yaw)).max() / three.dt < 2.0

    def test_what_they_ask_of_the_robot_is_said(self, three: Motion) -> None:
        transitions = three.provenance.stitched.transitions
        assert len(transitions) == 2
        for found in transitions:
            assert 0 < found["joint_speed_share"] <= 1
            assert 0 < found["torque_share"] <= 1
            assert 0 < found["friction"] <= 0.6
            assert found["least_feet"] == 2


class TestLayout:
    def test_weights_pass_from_one_segment_to_the_next(self, three: Motion) -> None:
        layout = Layout.of(three)
        for weights in (layout.trunk_weights(), layout.foot_weights()[..., 2]):
            assert weights.shape == (3, three.n_samples)
            np.testing.assert_allclose(weights.sum(axis=0), 1.0)
            assert weights.min() >= 0
            keep = pure(three)
            for segment, own in zip(layout.segments, weights, strict=True):
                inside = np.flatnonzero(keep)
                inside = inside[(inside >= segment.first) & (inside < segment.last)]
                np.testing.assert_array_equal(own[inside], 1.0)

    def test_it_goes_through_a_file(self, three: Motion, tmp_path: Path) -> None:
        three.save(tmp_path / "motion.npz")
        loaded = Motion.load(tmp_path / "motion.npz")
        assert Layout.of(loaded) == Layout.of(three)
        np.testing.assert_array_equal(loaded.cycle_starts, three.cycle_starts)
        assert [p.name for p in loaded.parts] == ["trot", "turn"]
        for found, part in zip(loaded.parts, three.parts, strict=True):
            np.testing.assert_array_equal(found.joint_pos, part.joint_pos)
            np.testing.assert_array_equal(found.cycle, part.cycle)

    def test_cycles_start_where_the_parts_do(self, three: Motion) -> None:
        starts = three.cycle_starts
        assert starts[0] == 0
        layout = Layout.of(three)
        assert 9 <= len(starts) <= 12
        for t in starts[1:]:
            segment = next(s for s in layout.segments if s.first <= t < s.last)
            assert (t - segment.shift) % three.parts[segment.part].n_samples == 0

    def test_of_a_motion_that_is_not_stitched_there_is_none(self, trot: Motion) -> None:
        with pytest.raises(MotionError, match="is not a stitched one"):
            Layout.of(trot)
        np.testing.assert_array_equal(trot.cycle_starts, [0])
        assert trot.segment_starts == ()

    def test_damaged(self, three: Motion) -> None:
        stitch = three.provenance.stitched
        for segments in (
            (*stitch.segments[:-1], dataclasses.replace(stitch.segments[-1], last=5)),
            stitch.segments[:-1],
        ):
            provenance = dataclasses.replace(three.provenance, stitch=dataclasses.replace(stitch, segments=segments))
            damaged = dataclasses.replace(three, provenance=provenance)
            with pytest.raises(MotionError, match=r"trot\+turn\+trot"):
                Layout.of(damaged)


class TestStanding:
    """One rule for all: a motion that stands can be joined to one that moves."""

    def test_a_stand_into_a_gait_and_back(self, robot: Robot, trot: Motion) -> None:
        stand = named(standing(robot, n_samples=200), "stand")
        motion = stitch_motions(robot, [stand, trot, stand], [4, 6, 4])
        assert demands(robot, motion).slide_m < 1e-3
        assert motion.contact[0].all()
        assert motion.contact[-1].all()
        assert motion.root_pos_w[-1, 0] > 0.5
        np.testing.assert_allclose(motion.root_lin_vel_w[[0, -1]], 0.0, atol=1e-6)

    def test_feet_that_never_lift_cannot_be_joined(self, robot: Robot) -> None:
        stand = standing(robot, n_samples=200)
        with pytest.raises(MotionError, match="the FR foot never lifts off in either"):
            stitch_motions(robot, [stand, named(standing(robot, n_samples=150), "other")], [4, 4])


class TestBadInput:
    def test_one_motion(self, robot: Robot, trot: Motion) -> None:
        with pytest.raises(ConfigError, match="at least two motions, found 1"):
            stitch_motions(robot, [trot])

    def test_a_motion_that_does_not_repeat(self, robot: Robot, trot: Motion, three: Motion) -> None:
        with pytest.raises(MotionError, match="does not repeat; only cyclic motions can be stitched"):
            stitch_motions(robot, [trot, three])

    def test_another_robot(self, trot: Motion) -> None:
        with pytest.raises(MotionError, match="is for robot 'a1', not for 'go1'"):
            stitch_motions(load_robot("go1"), [trot, trot])

    def test_another_rate(self, robot: Robot, trot: Motion) -> None:
        with pytest.raises(MotionError, match="400 samples a second; expected 500"):
            stitch_motions(robot, [trot, dataclasses.replace(trot, rate_hz=400.0)])

    def test_cycles(self, robot: Robot, trot: Motion) -> None:
        with pytest.raises(ConfigError, match="2 motions need as many numbers of cycles, found 3"):
            stitch_motions(robot, [trot, trot], [1, 2, 3])
        with pytest.raises(ConfigError, match="at least one cycle, found 0 for 'trot'"):
            stitch_motions(robot, [trot, trot], [3, 0])

    def test_a_segment_without_room_for_its_transitions(self, robot: Robot, trot: Motion, turn: Motion) -> None:
        with pytest.raises(MotionError, match=r"segment 'turn' with 1 cycles is too short for its transitions; give"):
            stitch_motions(robot, [trot, turn, trot], [4, 1, 4])


def test_about_three_seconds_each_by_default(trot: Motion, robot: Robot) -> None:
    assert default_cycles(trot) == round(3.0 / trot.period_s)
    assert default_cycles(standing(robot, n_samples=4000)) == 1


def test_recorded_motions(data_folder: Path, robot: Robot) -> None:
    """A trot with flight phases and a walking turn that is not symmetric. What is owed to their author is kept."""
    parts = [load_motion(name, robot) for name in ("dog:trot", "dog:right-turn")]
    motion = stitch_motions(robot, parts)
    owed = motion.provenance
    assert (owed.licence, owed.credit) == (parts[0].provenance.licence, parts[0].provenance.credit)
    assert "AI4Animation" in str(owed.credit)
    needs = demands(robot, motion)
    assert needs.slide_m < 4e-3
    assert needs.joint_speed <= 1.0
    assert needs.torque <= 1.0
    assert needs.lacking < 0.05
