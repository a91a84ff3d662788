"""Frames of 49 and 61 numbers, as AMP_for_hardware and its descendants write them, and go2_flip_TO's tables."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fastmimic.base.conventions import LEGS
from fastmimic.base.errors import ClipError
from fastmimic.base.rotations import quat_from_rotvec, quat_from_yaw, quat_multiply, quat_rotate
from fastmimic.clips.clip import Clip
from fastmimic.clips.formats import ReadOptions, detect_format, read_clip
from fastmimic.retargeting.retarget import choose_scale
from fastmimic.robot import Robot, load_robot
from fastmimic.robot.kinematics import foot_positions

N = 24
ISAAC = (1, 0, 3, 2)  # FL, FR, RL, RR


def poses(n: int = N) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Root (n, 3), orientation (n, 4) w first, and joints (n, 4, 3) in the common order: a trunk that turns, unlike
    legs."""
    t = np.linspace(0.0, 1.0, n)
    root = np.stack([0.5 * t, 0.1 * t, 0.3 + 0.01 * np.sin(6 * t)], axis=-1)
    tilt = quat_from_rotvec(np.stack([0.1 * np.sin(6 * t), 0.05 * t, 0.0 * t], axis=-1))
    quat = quat_multiply(quat_from_yaw(0.4 + t), tilt)
    phase = 6 * t[:, None] + np.arange(4)
    joints = np.stack([0.1 * np.sin(phase) - 0.05, 0.9 + 0.2 * np.sin(phase), -1.8 + 0.1 * np.cos(phase)], axis=-1)
    return root, quat, joints


def frames(robot: Robot, columns: int, order: tuple[int, ...], *, isaac: bool = False) -> np.ndarray:
    root, quat, joints = poses()
    feet = foot_positions(robot, joints.reshape(-1, 12))
    feet = quat_rotate(quat[:, None], feet) if isaac else feet
    q, p = (values[:, list(order)].reshape(N, 12) for values in (joints, feet))
    head = [root, quat[:, [1, 2, 3, 0]]]
    speeds = [np.full((N, width), 0.25) for width in (3, 3, 12, 12)]
    if isaac:
        return np.hstack([*head, *speeds[:2], q, speeds[2], p])
    return np.hstack([*head, q, p, *speeds])[:, :columns]


def write(path: Path, rows: np.ndarray, **changed: object) -> Path:
    head = {"LoopMode": "Wrap", "FrameDuration": 0.02, "EnableCycleOffsetPosition": True, "MotionWeight": 0.5}
    path.write_text(json.dumps(head | changed | {"Frames": np.round(rows, 5).tolist()}))
    return path


def check(clip: Clip, robot: Robot) -> None:
    root, quat, joints = poses()
    feet_w = root[:, None] + quat_rotate(quat[:, None], foot_positions(robot, joints.reshape(-1, 12)))
    np.testing.assert_allclose(clip.toes_w, feet_w, atol=1e-4)
    np.testing.assert_allclose(np.abs(np.sum(clip.root_quat_wxyz * quat, axis=1)), 1.0, atol=1e-6)
    assert clip.leg_length_m == robot.leg_length
    assert choose_scale(clip, robot) == pytest.approx(1.0)


@pytest.mark.parametrize(("columns", "isaac"), [(61, False), (49, False), (49, True)])
@pytest.mark.parametrize("order", [(0, 1, 2, 3), ISAAC])
@pytest.mark.parametrize("name", ["a1", "go2"])
def test_robot_layout_and_order_are_those_that_give_the_feet(
    name: str, order: tuple[int, ...], columns: int, isaac: bool, tmp_path: Path
) -> None:
    robot = load_robot(name)
    path = write(tmp_path / "trot0.txt", frames(robot, columns, order, isaac=isaac))
    assert detect_format(path) == "deepmimic"
    clip = read_clip(path, ReadOptions(robot=load_robot("a1")))
    check(clip, robot)
    assert clip.rate_hz == pytest.approx(50.0)
    assert clip.is_cycle is None  # 'Wrap' is in all such files
    legs = ", ".join(LEGS[i] for i in order)
    assert any(f"joints are the {name}'s, legs {legs}" in said for said in clip.origin.assumed)


def test_a_closed_loop_loses_its_repeated_frame(tmp_path: Path) -> None:
    rows = frames(load_robot("go2"), 61, ISAAC)
    rows[-1, 7:] = rows[0, 7:]
    clip = read_clip(write(tmp_path / "loop.txt", rows))
    assert clip.is_cycle is True
    assert clip.n_frames == N - 1


@pytest.mark.parametrize("isaac", [False, True])
def test_the_root_may_be_the_centre_of_mass(isaac: bool, tmp_path: Path) -> None:
    robot, offset_b = load_robot("a1"), np.array([0.0127, 0.0022, 0.0005])  # AMP_for_hardware's of the A1
    rows = frames(robot, 49 if isaac else 61, ISAAC, isaac=isaac)
    _, quat, _ = poses()
    rows[:, :3] += quat_rotate(quat, offset_b)
    first = 37 if isaac else 19
    rows[:, first : first + 12] -= np.tile(quat_rotate(quat, offset_b) if isaac else offset_b, 4)
    clip = read_clip(write(tmp_path / "trot0.txt", rows))
    check(clip, robot)
    assert any("its root is 12.9 mm from the robot's" in said for said in clip.origin.assumed)


def test_legs_that_are_a_little_shorter_are_not_taken_for_another_root(tmp_path: Path) -> None:
    rows = frames(load_robot("a1"), 61, ISAAC)
    rows[:, 21:31:3] *= 0.95  # by 12 mm
    with pytest.raises(ClipError, match="joints belong to none of"):
        read_clip(write(tmp_path / "shorter.txt", rows))


def test_joints_may_turn_about_the_axes_of_the_robots_own_file(tmp_path: Path) -> None:
    robot = replace(load_robot("a1"), name="lite", joint_sign=np.tile([-1.0, -1.0, 1.0], 4))
    rows = frames(robot, 61, ISAAC)
    rows[:, 7:19] *= robot.joint_sign
    check(read_clip(write(tmp_path / "lite.txt", rows), ReadOptions(robot=robot)), robot)


def test_feet_of_another_robot_are_refused(tmp_path: Path) -> None:
    rows = frames(load_robot("a1"), 61, ISAAC)
    rows[:, 19:31] *= 1.3
    path = write(tmp_path / "aliengo.txt", rows)
    with pytest.raises(ClipError, match=r"joints belong to none of a1, go1, go2: .* m off or more; .*--robot FILE"):
        read_clip(path)


@pytest.mark.parametrize(
    ("row", "words"),
    [([0.0] * 60, r"frame 1\) has 60 numbers; expected 61"), ([0.0] * 60 + ["a"], r"number 61 \(joints, feet or")],
)
def test_a_wrong_frame_is_named(row: list[object], words: str, tmp_path: Path) -> None:
    rows = frames(load_robot("a1"), 61, ISAAC).tolist()
    rows[1] = row
    path = tmp_path / "bad.txt"
    path.write_text(json.dumps({"FrameDuration": 0.02, "Frames": rows}))
    with pytest.raises(ClipError, match=words):
        read_clip(path)


def test_a_table_of_a_trajectory_optimisation_is_read_by_its_header(tmp_path: Path) -> None:
    """`trajectory_full.csv` of go2_flip_TO: Pinocchio's configuration, the URDF's joints, full precision."""
    robot = load_robot("go2")
    root, quat, joints = poses()
    names = [f"{LEGS[leg]}_{joint}_joint" for leg in ISAAC for joint in ("hip", "thigh", "calf")]
    header = ",".join(["t", *(f"base_t{a}" for a in "xyz"), *(f"quat_{a}" for a in "xyzw"), *names])
    rows = np.hstack([0.02 * np.arange(N)[:, None], root, quat[:, [1, 2, 3, 0]], joints[:, list(ISAAC)].reshape(N, 12)])
    path = tmp_path / "trajectory_full.csv"
    np.savetxt(path, rows, delimiter=",", header=header, comments="", fmt="%.18e")
    clip = read_clip(path, ReadOptions(robot=robot))
    check(clip, robot)
    assert clip.rate_hz == pytest.approx(50.0)
