"""The DMPs of a motion: what they reproduce, and what modulating them does."""

import json
import math
from pathlib import Path

import numpy as np
import pytest

from fastmimic.base.errors import MotionError
from fastmimic.base.rotations import quat_conjugate, quat_multiply, rotvec_from_quat
from fastmimic.clips.catalogue import RECORDED, open_clip
from fastmimic.motion.motion import Motion
from fastmimic.primitive import FOOT_Z, NAMES, MotionDmp
from fastmimic.retargeting.retarget import retarget
from fastmimic.robot import Robot
from fastmimic.robot.kinematics import foot_jacobians, foot_positions
from primitive.motions import SWING_HEIGHT, cyclic_motion

MILLIMETRE, TENTH_DEGREE = 1e-3, np.radians(0.1)


@pytest.fixture(scope="module")
def motion(robot: Robot) -> Motion:
    return cyclic_motion(robot)


@pytest.fixture(scope="module")
def dmp(motion: Motion, robot: Robot) -> MotionDmp:
    return MotionDmp.fit(motion, robot)


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def assert_fits(dmp: MotionDmp) -> None:
    """The bounds promised for every retargeted cycle, on the reported figures and on the motion itself."""
    assert dmp.fit_rms["root_position_m"] < MILLIMETRE
    assert dmp.fit_rms["foot_position_m"] < MILLIMETRE
    assert dmp.fit_rms["root_orientation_rad"] < TENTH_DEGREE
    original, made = dmp.fitted, dmp.motion()
    assert rms(made.root_pos_w - original.root_pos_w) < MILLIMETRE
    turn = quat_multiply(quat_conjugate(original.root_quat_wxyz), made.root_quat_wxyz)
    assert rms(rotvec_from_quat(turn)) < TENTH_DEGREE


def test_there_are_24_named_dimensions(dmp: MotionDmp) -> None:
    assert len(NAMES) == len(dmp.goal) == 24
    assert NAMES[0] == "root_x"
    assert NAMES[5] == "root_yaw"
    assert [NAMES[i] for i in FOOT_Z] == ["FR_foot_z", "FL_foot_z", "RR_foot_z", "RL_foot_z"]
    assert dmp.index("FR_foot_z") == FOOT_Z[0]
    assert dmp.goal.shape == (24,)
    np.testing.assert_array_equal(dmp.amplitude, 1.0)
    with pytest.raises(MotionError, match="no DMP is called 'FR_fot_z'; did you mean 'FR_foot_z'"):
        dmp.index("FR_fot_z")


def test_the_unmodulated_motion_is_the_original(dmp: MotionDmp, motion: Motion) -> None:
    assert_fits(dmp)
    made = dmp.motion()
    assert rms(made.foot_pos_b - motion.foot_pos_b) < MILLIMETRE
    assert rms(made.root_lin_vel_w - motion.root_lin_vel_w) < 1e-3
    assert rms(made.root_ang_vel_w - motion.root_ang_vel_w) < 1e-3
    np.testing.assert_array_equal(made.contact, motion.contact)
    assert made.cycle is not None
    np.testing.assert_array_equal(made.cycle, motion.cycle)
    assert made.rate_hz == motion.rate_hz


@pytest.mark.parametrize("cycle", [(0.0, 0.0, 0.0), (0.2, 0.1, 1.72), (0.1, 0.1, 2 * np.pi)])
def test_turns_are_fitted_as_well_as_straight_gaits(robot: Robot, cycle: tuple[float, float, float]) -> None:
    assert_fits(MotionDmp.fit(cyclic_motion(robot, cycle), robot))


@pytest.mark.parametrize("name", ["trot", "turn", "side-step", "walk", "bound"])
def test_built_in_gaits_are_fitted(name: str, robot: Robot) -> None:
    motion, _ = retarget(open_clip(name, robot=robot), robot)
    assert_fits(MotionDmp.fit(motion, robot))


@pytest.mark.slow
@pytest.mark.parametrize("name", list(RECORDED))
def test_real_clips_are_fitted(name: str, robot: Robot, data_folder: Path) -> None:
    """Among them loops of 6 s with pauses, and a turn of 100° a cycle."""
    clip = open_clip(name, robot=robot, folder=data_folder)
    motion, _ = retarget(clip, robot, executable=False)  # optimal control of the longest takes a minute
    if motion.cycle is None:
        pytest.fail(f"{name} is a cycle")
    dmp = MotionDmp.fit(motion, robot)
    assert dmp.primitive.n_basis == max(100, math.ceil(motion.period_s / 0.02))  # of a long cycle one each 20 ms
    assert_fits(dmp)


def test_the_goal_of_a_foot_shifts_that_foot_and_nothing_else(dmp: MotionDmp) -> None:
    goal = dmp.goal
    goal[dmp.index("FL_foot_z")] += 0.01
    shifted, original = dmp.motion(goal=goal), dmp.motion()
    change = shifted.foot_pos_b - original.foot_pos_b
    expected = np.zeros((4, 3))
    expected[1, 2] = 0.01
    np.testing.assert_allclose(change, np.broadcast_to(expected, change.shape), atol=1e-9)
    np.testing.assert_array_equal(shifted.root_pos_w, original.root_pos_w)
    assert np.all(shifted.joint_pos[:, :3] == original.joint_pos[:, :3])


def test_the_amplitude_scales_the_swing_about_its_mean(dmp: MotionDmp) -> None:
    amplitude = dmp.amplitude
    amplitude[list(FOOT_Z)] = 1.25
    higher = dmp.motion(amplitude=amplitude).foot_pos_b[..., 2]
    original = dmp.motion().foot_pos_b[..., 2]
    np.testing.assert_allclose(np.ptp(higher, axis=0), 1.25 * np.ptp(original, axis=0), rtol=1e-9)
    np.testing.assert_allclose(np.ptp(original, axis=0), SWING_HEIGHT, rtol=0.05)
    np.testing.assert_allclose(higher.mean(axis=0), original.mean(axis=0), atol=1e-9)


def test_root_goals_move_the_root_in_its_own_moving_frame(dmp: MotionDmp, motion: Motion) -> None:
    goal = dmp.goal
    goal[dmp.index("root_x")] += 0.1
    goal[dmp.index("root_z")] += 0.02
    offset = dmp.motion(goal=goal).root_pos_w - dmp.motion().root_pos_w
    np.testing.assert_allclose(np.linalg.norm(offset[:, :2], axis=1), 0.1, atol=1e-12)
    np.testing.assert_allclose(offset[:, 2], 0.02, atol=1e-12)
    heading = np.arctan2(offset[:, 1], offset[:, 0])
    assert heading[-1] - heading[0] == pytest.approx(motion.cycle[2] * (1 - 1 / motion.n_samples), abs=1e-9)


def test_joints_feet_and_joint_velocities_are_consistent_and_periodic(dmp: MotionDmp, robot: Robot) -> None:
    amplitude = dmp.amplitude
    amplitude[list(FOOT_Z)] = 1.2
    made = dmp.motion(amplitude=amplitude)
    np.testing.assert_allclose(foot_positions(robot, made.joint_pos), made.foot_pos_b, atol=1e-9)
    foot_vel = np.einsum("tlij,tlj->tli", foot_jacobians(robot, made.joint_pos), made.joint_vel.reshape(-1, 4, 3))
    differences = np.roll(made.foot_pos_b, -1, axis=0) - np.roll(made.foot_pos_b, 1, axis=0)
    # both are second-order in the 2 ms step, with feet that turn within a few samples at touch-down
    assert rms(foot_vel - differences * made.rate_hz / 2) < 0.02 * rms(foot_vel)
    np.testing.assert_allclose(made.joint_vel.mean(axis=0), 0, atol=1e-9)


@pytest.mark.nojit
def test_the_foot_table_is_what_the_motions_contain(dmp: MotionDmp) -> None:
    generator = np.random.default_rng(0)
    goals = dmp.goal + generator.uniform(-0.02, 0.02, (5, 24))
    amplitudes = generator.uniform(0.7, 1.3, (5, 24))
    table = dmp.foot_table(goals, amplitudes)
    assert table.foot_pos_b.shape == (5, dmp.fitted.n_samples, 4, 3)
    for i in range(5):
        made = dmp.motion(goals[i], amplitudes[i])
        np.testing.assert_array_equal(table.foot_pos_b[i], made.foot_pos_b)
        np.testing.assert_array_equal(table.joint_pos[i], made.joint_pos)
        np.testing.assert_array_equal(table.joint_vel[i], made.joint_vel)
        root = (made.root_pos_w, made.root_quat_wxyz, made.root_lin_vel_w, made.root_ang_vel_w)
        for own, of_motion in zip(dmp.root(goals[i], amplitudes[i]), root, strict=True):
            np.testing.assert_array_equal(own, of_motion)


@pytest.mark.nojit
@pytest.mark.parametrize("shift", [-0.3, 0.25])
def test_feet_out_of_reach_are_brought_back_and_counted(dmp: MotionDmp, robot: Robot, shift: float) -> None:
    goal = dmp.goal
    goal[dmp.index("RR_foot_z")] += shift
    made = dmp.motion(goal=goal)
    record = made.provenance.as_dict()["dmp"]
    assert record["foot_samples_out_of_reach"][2] == made.n_samples
    assert record["foot_samples_out_of_reach"][0] == 0
    assert 0.01 < record["foot_shift_to_reach_m"][2] < 0.35
    np.testing.assert_allclose(foot_positions(robot, made.joint_pos), made.foot_pos_b, atol=1e-12)
    assert np.all(made.joint_pos >= robot.joint_lower)
    assert np.all(made.joint_pos <= robot.joint_upper)


def test_a_modulated_motion_carries_what_it_is_scored_against(dmp: MotionDmp, motion: Motion) -> None:
    made = dmp.motion()
    assert made.demonstration is motion
    again = MotionDmp.fit(made, dmp.robot).motion()
    assert again.demonstration is motion, "not the modulated one"


def test_the_record_of_the_parameters_survives_the_file(dmp: MotionDmp, tmp_path: Path) -> None:
    goal, amplitude = dmp.goal, dmp.amplitude
    goal[14] += 0.01
    amplitude[14] = 1.3
    dmp.motion(goal, amplitude).save(tmp_path / "motion.npz")
    record = Motion.load(tmp_path / "motion.npz").provenance.as_dict()["dmp"]
    assert record == json.loads(json.dumps(record))
    assert record["n_basis"] == 100
    assert record["goal"] == goal.tolist()
    assert record["amplitude"] == amplitude.tolist()
    assert record["fit_rms"] == dmp.fit_rms
    assert tuple(record["names"]) == NAMES


@pytest.mark.parametrize(
    ("goal", "message"),
    [
        (np.zeros(23), r"goal has shape \(23,\); expected \(24,\)"),
        (np.full(24, np.inf), "goal holds a value that is not finite"),
    ],
)
def test_parameters_of_another_shape_are_refused(dmp: MotionDmp, goal: np.ndarray, message: str) -> None:
    with pytest.raises(MotionError, match=message):
        dmp.motion(goal=goal)


def test_a_table_of_another_shape_is_refused(dmp: MotionDmp) -> None:
    with pytest.raises(MotionError, match=r"amplitude has shape \(3, 24\); expected \(2, 24\)"):
        dmp.foot_table(np.zeros((2, 24)), np.zeros((3, 24)))


@pytest.fixture(scope="module")
def once(robot: Robot) -> Motion:
    """Half a cycle, once: it begins in one double stance and ends in the other, elsewhere."""
    return retarget(open_clip("walk", robot=robot, frames=(0, 20), cycle=False), robot)[0]


@pytest.fixture(scope="module")
def fitted(once: Motion, robot: Robot) -> MotionDmp:
    return MotionDmp.fit(once, robot)


class TestDiscrete:
    """A motion that does not repeat."""

    def test_it_is_fitted_by_discrete_primitives(self, fitted: MotionDmp, once: Motion) -> None:
        assert_fits(fitted)
        made = fitted.motion()
        assert made.cycle is None
        assert made.demonstration is once
        assert made.provenance.as_dict()["dmp"]["primitive"] == "discrete"
        inner = slice(1, -1)  # differences of the joints are one-sided at the ends
        assert rms((made.joint_vel - once.joint_vel)[inner]) < 0.05

    def test_the_goal_is_where_a_foot_ends_and_leaves_where_it_begins(self, fitted: MotionDmp) -> None:
        goal = fitted.goal
        goal[fitted.index("FL_foot_z")] -= 0.01
        change = fitted.motion(goal=goal).foot_pos_b - fitted.motion().foot_pos_b
        np.testing.assert_allclose(change[0], 0, atol=1e-12)
        np.testing.assert_allclose(change[-1, 1, 2], -0.01, rtol=2e-3)
        np.testing.assert_allclose(np.delete(change.reshape(-1, 12), 5, axis=1), 0, atol=1e-12)

    def test_candidates_are_the_motions(self, fitted: MotionDmp) -> None:
        goal, amplitude = np.tile(fitted.goal, (2, 1)), np.ones((2, 24))
        amplitude[1, list(FOOT_Z)] = 1.2
        goal[1, list(FOOT_Z)] += 0.005
        table = fitted.foot_table(goal, amplitude)
        for i in range(2):
            motion = fitted.motion(goal[i], amplitude[i])
            np.testing.assert_array_equal(table.foot_pos_b[i], motion.foot_pos_b)
            np.testing.assert_array_equal(table.joint_vel[i], motion.joint_vel)
        rates = np.gradient(table.joint_pos[1], fitted.fitted.dt, axis=0)
        np.testing.assert_allclose(table.joint_vel[1], rates, atol=1e-12)
