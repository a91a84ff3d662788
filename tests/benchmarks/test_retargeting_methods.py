"""The measures of the retargeting benchmark, on motions of which they are known."""

import sys
from dataclasses import replace
from importlib.util import module_from_spec, spec_from_file_location
from types import ModuleType

import numpy as np
import pytest

import fastmimic as fm
from benchmarks.conftest import FOLDER
from fastmimic.base.rotations import quat_from_rotvec, quat_rotate
from fastmimic.motion.motion import Motion
from fastmimic.robot import Robot
from fastmimic.robot.kinematics import foot_positions

FRAMES = 40


@pytest.fixture(scope="module")
def bench() -> ModuleType:
    """`benchmarks/retargeting.py`, whose name a folder of tests has, too."""
    spec = spec_from_file_location("retargeting_benchmark", FOLDER / "retargeting.py")
    assert spec is not None
    assert spec.loader is not None
    module = module_from_spec(spec)
    sys.modules[spec.name] = module  # where its dataclasses look
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def trot(robot: Robot) -> Motion:
    return fm.retarget(fm.open_clip("trot"), robot)[0]


@pytest.fixture(scope="module")
def animal(bench: ModuleType, trot: Motion) -> np.ndarray:
    return np.asarray(bench.at_phases(trot.contact, FRAMES))


def test_an_executable_motion_stands_where_it_says(
    bench: ModuleType, robot: Robot, trot: Motion, animal: np.ndarray
) -> None:
    found = bench.measures(bench.Course.of_motion(robot, trot, FRAMES), animal)
    assert found["penetration_share"] == 0.0
    assert found["contact_share"] == 1.0
    assert found["skating_mm"] < 3.0
    assert found["hover_mm"] < 1.0
    assert (found["beyond_range_share"], found["too_fast_share"]) == (0.0, 0.0)


def test_a_sunken_and_drifting_motion_sinks_and_skates(
    bench: ModuleType, robot: Robot, trot: Motion, animal: np.ndarray
) -> None:
    course = bench.Course.of_motion(robot, trot, FRAMES)
    drift = np.arange(FRAMES)[:, None] / course.rate_hz * np.array([0.0, 0.2, 0.0]) - np.array([0.0, 0.0, 0.005])
    moved = replace(course, root_pos=course.root_pos + drift, feet=course.feet + drift[:, None])
    found, before = bench.measures(moved, animal), bench.measures(course, animal)
    assert found["penetration_mm"] == pytest.approx(5.0, abs=0.5)
    assert found["penetration_share"] == pytest.approx(animal.mean(), abs=0.1)
    kept = animal[:-1] & animal[1:] & np.roll(animal, 1, axis=0)[:-1]
    stances = (animal & ~np.roll(animal, 1, axis=0)).sum()
    assert found["skating_mm"] - before["skating_mm"] == pytest.approx(
        1e3 * 0.2 / course.rate_hz * kept.sum() / stances, abs=3.0
    )


def test_a_rolling_foot_does_not_skate(bench: ModuleType, robot: Robot) -> None:
    """Stiff legs that turn about the contact of a foot: its centre moves, its contact point does not."""
    steps, turn = 11, 0.02
    quat = quat_from_rotvec(np.arange(steps)[:, None] * np.array([0.0, turn, 0.0]))
    joints = np.tile(robot.home_joint_pos, (steps, 1))
    foot = foot_positions(robot, robot.home_joint_pos)[0]
    centre = np.arange(steps)[:, None] * np.array([robot.foot_radius * turn, 0.0, 0.0]) + [0, 0, robot.foot_radius]
    root = centre - quat_rotate(quat, np.tile(foot, (steps, 1)))
    course = bench.Course.of_robot(robot, 60.0, root, quat, joints)
    assert np.linalg.norm(np.diff(course.feet[:, 0], axis=0), axis=-1) == pytest.approx(robot.foot_radius * turn)
    assert course.slides[:, 0] == pytest.approx(0.0, abs=1e-9)
    knee = joints.copy()
    knee[:, 2] += np.arange(steps) * turn
    assert bench.Course.of_robot(robot, 60.0, root, quat, knee).slides[:, 0].max() > 1e-4


def test_limits_and_jerk(bench: ModuleType, robot: Robot, animal: np.ndarray, trot: Motion) -> None:
    course = bench.Course.of_motion(robot, trot, FRAMES)
    joints = course.joints.copy()
    joints[3, 2] = robot.joint_upper[2] + 0.1
    found = bench.measures(replace(course, joints=joints), animal)
    assert found["beyond_range_share"] == pytest.approx(1 / FRAMES)
    assert found["too_fast_share"] > 0
    t = np.arange(FRAMES)[:, None] / course.rate_hz
    cubic = bench.measures(replace(course, joints=np.tile(2.0 * t**3, (1, 12))), animal)
    assert cubic["jerk_rad_s3"] == pytest.approx(12.0)


def test_contacts_are_compared_from_the_phase_at_which_a_file_begins(
    bench: ModuleType, robot: Robot, trot: Motion, animal: np.ndarray
) -> None:
    course = bench.Course.of_motion(robot, trot, FRAMES)
    later = replace(course, feet=np.roll(course.feet, -7, axis=0))
    found = bench.aligned(animal, later)
    assert (found == np.roll(animal, -7, axis=0)).mean() > 0.9


def test_per_frame_inverse_kinematics_reaches_its_targets(bench: ModuleType, robot: Robot) -> None:
    pytest.importorskip("mink", reason="mink is not installed: pip install 'fastmimic[bench]'")
    course = bench.per_frame_ik(fm.open_clip("trot").cut(0, 10), robot)
    assert course.joints.shape == (10, 12)
    height = course.feet[..., 2] - course.radius
    assert height.min() > -0.003
    assert np.abs(np.diff(course.joints, axis=0)).max() < 0.6
    assert np.all(course.joints >= robot.joint_lower - 1e-6)
    assert np.all(course.joints <= robot.joint_upper + 1e-6)


def test_the_table_has_a_line_for_each_row(bench: ModuleType, robot: Robot, trot: Motion, animal: np.ndarray) -> None:
    row = {"motion": "trot", "method": "published", "fell": 0.25, "reward_mean": 0.5, "reward_animal": 0.25}
    row |= bench.measures(bench.Course.of_motion(robot, trot, FRAMES), animal) | {"too_fast_share": None}
    lines = bench.table([row, {"motion": "x", "method": "executable", "error": "no motion near it"}]).splitlines()
    assert len(lines) == 4
    assert len({line.count(" |") for line in lines[:3]}) == 1
    assert "0%; –" in lines[2]
    assert "0.500 (0.250) |" in lines[2]
    assert "refused: no motion near it" in lines[3]
