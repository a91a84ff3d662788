"""Retargeted CSV: columns by name or by position, and what is wrong with a bad file."""

from pathlib import Path

import numpy as np
import pytest
from sample_files import STANDING, csv_text, csv_values, table_text

from fastmimic.base.conventions import JOINT_NAMES, LEGS
from fastmimic.base.errors import ClipError
from fastmimic.clips.formats import ReadOptions, csv_motion, read_clip
from fastmimic.robot import load_robot
from fastmimic.robot.kinematics import foot_positions

ROOT = ["root_x", "root_y", "root_z", "root_qx", "root_qy", "root_qz", "root_qw"]


@pytest.fixture(scope="module")
def a1():
    return load_robot("a1")


def named(names: list[str], values: np.ndarray) -> str:
    return ",".join(names) + "\n" + table_text(values, ",")


def test_points_are_those_of_the_robot(a1):
    clip = csv_motion.parse(csv_text(), robot=a1)
    base = csv_values()[:, None, :3]
    np.testing.assert_allclose(clip.hips_w, base + a1.hip_pos_b, atol=1e-12)
    np.testing.assert_allclose(clip.toes_w, base + foot_positions(a1, np.array(STANDING)), atol=1e-12)
    assert clip.scale == 1.0
    assert clip.leg_length_m == pytest.approx(a1.leg_length)


def test_the_trunk_turns_the_points(a1):
    values = csv_values()
    values[:, 3:7] = [0, 0, np.sqrt(0.5), np.sqrt(0.5)]  # 90° to the left
    clip = csv_motion.parse(table_text(values, ","), robot=a1)
    neck = clip.point("neck")[0] - values[0, :3]
    np.testing.assert_allclose(neck, [0, a1.hip_pos_b[:2, 0].mean(), a1.hip_pos_b[:2, 2].mean()], atol=1e-5)


def test_without_header_the_order_and_the_rate_are_assumed_and_said(a1):
    said = " / ".join(csv_motion.parse(csv_text(), robot=a1).origin.assumed)
    assert "quaternion x y z w" in said
    assert "FR_abduction, FR_hip, FR_knee" in said
    assert "30 frames a second" in said
    assert "a1" in said


def test_given_rate_is_used(a1):
    clip = csv_motion.parse(csv_text(), robot=a1, fps=50)
    assert clip.rate_hz == 50
    assert not any("frames a second" in s for s in clip.origin.assumed)


@pytest.mark.parametrize(
    "joints",
    [
        list(JOINT_NAMES),
        [f"{leg}_{joint}_joint" for leg in LEGS for joint in ("hip", "thigh", "calf")],
        [f"{leg}_{joint}_joint" for leg in LEGS for joint in ("hip", "upper", "lower")],
        [f"{leg}_{joint} (rad)" for leg in ("RF", "LF", "RH", "LH") for joint in ("HAA", "HFE", "KFE")],
    ],
)
def test_named_columns_are_found_in_any_order_and_spelling(a1, joints: list[str]):
    rng = np.random.default_rng(1)
    values = csv_values()
    values[:, 7:] += rng.uniform(-0.2, 0.2, values[:, 7:].shape)
    order = rng.permutation(19)
    names = [(ROOT + joints)[i] for i in order]
    clip = csv_motion.parse(named(names, values[:, order]), robot=a1)
    np.testing.assert_array_equal(clip.points_w, csv_motion.parse(table_text(values, ","), robot=a1).points_w)
    assert not any("columns are" in s for s in clip.origin.assumed)


def test_a_comment_with_names_is_a_header(a1):
    """As numpy.savetxt writes it."""
    text = "# " + csv_text(header=True)
    assert not any("columns are" in s for s in csv_motion.parse(text, robot=a1).origin.assumed)


def test_a_time_column_gives_the_rate(a1):
    time = np.arange(8)[:, None] / 100
    text = named(["time", *ROOT, *JOINT_NAMES], np.hstack([time, csv_values()]))
    assert csv_motion.parse(text, robot=a1).rate_hz == pytest.approx(100)
    assert csv_motion.parse(text, robot=a1, fps=20).rate_hz == 20


def test_time_may_count_from_1970(a1):
    time = 1.7e9 + np.arange(8)[:, None] / 100
    text = named(["timestamp", *ROOT, *JOINT_NAMES], np.hstack([time, csv_values()]))
    assert csv_motion.parse(text, robot=a1).rate_hz == pytest.approx(100)


def test_a_column_in_degrees_is_not_taken_for_radians(a1):
    names = [*ROOT, *JOINT_NAMES[:-1], f"{JOINT_NAMES[-1]} [deg]"]
    with pytest.raises(ClipError, match="no column for RL_knee"):
        csv_motion.parse(named(names, csv_values()), robot=a1)


def test_time_that_runs_unevenly_is_refused(a1):
    time = np.arange(8)[:, None] / 100
    time[5] += 0.02
    text = named(["time", *ROOT, *JOINT_NAMES], np.hstack([time, csv_values()]))
    with pytest.raises(ClipError, match=r"line 7, column 1 \(time\): time goes from 0.04 to 0.07"):
        csv_motion.parse(text, robot=a1)


def test_columns_without_use_are_named(a1):
    text = named([*ROOT, *JOINT_NAMES, "FR_contact", "gait"], np.hstack([csv_values(), np.ones((8, 2))]))
    text = text.replace("1.00000\n", "trots\n")
    assert text.count("trots") == 8
    assert any("not used: fr_contact, gait" in s for s in csv_motion.parse(text, robot=a1).origin.assumed)


def test_a_missing_joint_is_named_and_the_closest_column_offered(a1):
    names = [*ROOT, *JOINT_NAMES]
    names[9] = "FR_kne"
    with pytest.raises(ClipError, match=r"no column for FR_knee.*did you mean 'fr_kne'"):
        csv_motion.parse(named(names, csv_values()), robot=a1)


def test_a_joint_named_twice_is_refused(a1):
    names = [*ROOT, *JOINT_NAMES, "FR_knee"]
    with pytest.raises(ClipError, match=r"2 columns .* for FR_knee"):
        csv_motion.parse(named(names, np.hstack([csv_values(), np.zeros((8, 1))])), robot=a1)


def test_w_first_is_recognised_as_the_wrong_order(a1):
    values = csv_values()
    values[:, 3:7] = [1, 0, 0, 0]
    with pytest.raises(ClipError, match="order x, y, z, w"):
        csv_motion.parse(table_text(values, ","), robot=a1)


def test_degrees_are_refused(a1):
    values = csv_values()
    values[:, 7:] = np.degrees(values[:, 7:])
    with pytest.raises(ClipError, match=r"line 1, FR_hip: 45.8366 is more than a turn; joints are in radians"):
        csv_motion.parse(table_text(values, ","), robot=a1)


def test_a_quaternion_that_is_not_unit_names_line_and_frame(a1):
    values = csv_values()
    values[3, 6] = 1.01
    with pytest.raises(ClipError, match=r"line 5 \(frame 3\): the root quaternion .* norm 1\.01; expected 1"):
        csv_motion.parse(named([*ROOT, *JOINT_NAMES], values), robot=a1)


def test_a_bad_value_names_line_column_and_joint(a1):
    text = csv_text().replace("-1.60000", "nan", 1)
    with pytest.raises(ClipError, match=r"line 1, column 10 \(FR_knee\): nan is not finite"):
        csv_motion.parse(text, robot=a1)


def test_wrong_number_of_columns_names_the_line(a1):
    lines = csv_text().splitlines()
    lines[3] += ",0"
    with pytest.raises(ClipError, match=r"line 4 has 20 columns; expected 19 \(retargeted motion\)$"):
        csv_motion.parse("\n".join(lines), robot=a1)


@pytest.mark.parametrize("n_frames", [0, 1])
def test_too_few_frames_are_no_clip(a1, n_frames: int):
    with pytest.raises(ClipError, match=f"at least 2 frames, found {n_frames}"):
        csv_motion.parse(csv_text(n_frames, header=True), robot=a1)


class _Harm:
    """An object that says so if it is unpickled."""

    def __reduce__(self):
        return pytest.fail, ("an object in the file was unpickled",)


def arrays_file(path: Path, q: np.ndarray, dt: np.ndarray) -> Path:
    """A trajectory as Pinocchio has it, with the joints' names as an object."""
    if q.shape[1] == 19:
        q = np.hstack([q[:, :7], q[:, 7:].reshape(-1, 4, 3)[:, [1, 0, 3, 2]].reshape(-1, 12)])
    np.savez(path, q=q, v=np.zeros((len(q), 18)), dt=dt, joint_names=np.array([_Harm()]), actuated_q_start=7)
    return path


def test_a_trajectory_in_arrays_is_that_of_the_table(tmp_path: Path, a1):
    path = arrays_file(tmp_path / "trajectory.npz", csv_values(), np.full(len(csv_values()), 0.02))
    clip, wanted = read_clip(path, ReadOptions(robot=a1)), csv_motion.parse(csv_text(), robot=a1, fps=50)
    assert clip.origin.format == "trajectory"
    assert clip.rate_hz == pytest.approx(50.0)
    np.testing.assert_allclose(clip.points_w, wanted.points_w, atol=1e-12)
    np.testing.assert_allclose(clip.root_quat_wxyz, wanted.root_quat_wxyz, atol=1e-12)


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        (lambda q, dt: (q[:, :18], dt), r"q of shape \(\d+, 18\) .* expected \(frames, 19\)"),
        (lambda q, dt: (q, dt[:-1]), "dt of shape"),
        (lambda q, dt: (np.where(q == q[3, 0], np.nan, q), dt), "not finite"),
        (lambda q, dt: (q, dt * np.linspace(1, 2, len(dt))), "even steps, or give the frame rate"),
        (lambda q, dt: (q, -dt), "rate"),
        (lambda q, dt: (q, 0 * dt), "rate"),
        (
            lambda q, dt: (np.hstack([q[:, :7], np.degrees(q[:, 7:])]), dt),
            r"q, row 0, FR_hip: .* joints are in radians",
        ),
    ],
)
def test_damaged_trajectories_are_refused(tmp_path: Path, a1, change, problem):
    q, dt = change(csv_values(), np.full(len(csv_values()), 0.02))
    with pytest.raises(ClipError, match=problem):
        read_clip(arrays_file(tmp_path / "bad.npz", q, dt), ReadOptions(robot=a1))
