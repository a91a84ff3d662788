"""Closed-form leg kinematics against MuJoCo."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fastmimic.robot import ROBOT_NAMES, Robot, load_robot
from fastmimic.robot.kinematics import foot_jacobians, foot_positions, inverse_kinematics
from robot.mjcf import Simulated, random_joints, random_quat

EXACT = 1e-9  # m and m/rad: the closed forms are exact, only rounding remains


@pytest.fixture(scope="module", params=ROBOT_NAMES)
def robot(request: pytest.FixtureRequest) -> Robot:
    return load_robot(request.param)


@pytest.mark.nojit
def test_feet_and_jacobians_agree_with_mujoco_on_random_poses(robot: Robot) -> None:
    generator = np.random.default_rng(1)
    simulated = Simulated(robot)
    for _ in range(200):
        q = random_joints(robot, generator)
        simulated.pose(q, generator.normal(size=3), random_quat(generator))
        np.testing.assert_allclose(foot_positions(robot, q), simulated.feet_b(), rtol=0, atol=EXACT)
        np.testing.assert_allclose(foot_jacobians(robot, q), simulated.jacobians_b(), rtol=0, atol=EXACT)


def test_the_home_pose_stands_on_the_ground(robot: Robot) -> None:
    feet = foot_positions(robot, robot.home_joint_pos)
    clearance = robot.home_height + feet[:, 2] - robot.foot_radius
    assert np.all(clearance >= 0), "feet start inside the ground"
    assert np.all(clearance < 1e-3), "feet start in the air"


def test_inverse_returns_the_joints_of_any_foot_that_hangs_below_its_hip(robot: Robot) -> None:
    generator = np.random.default_rng(2)
    q = generator.uniform(robot.joint_lower, robot.joint_upper, size=(2000, 12))
    feet = foot_positions(robot, q)
    found, reachable = inverse_kinematics(robot, feet)
    assert np.all(reachable)
    np.testing.assert_allclose(foot_positions(robot, found), feet, rtol=0, atol=EXACT)
    hangs = _below_hip(robot, q)
    assert hangs.mean() > 0.3, "too few poses left to compare"
    difference = (found - q).reshape(-1, 4, 3)[hangs]
    difference -= 2 * np.pi * np.round(difference / (2 * np.pi))
    # arccos loses half the digits where the leg is straight, which no joint range here contains
    np.testing.assert_allclose(difference, 0, atol=1e-7)


def _below_hip(robot: Robot, q: np.ndarray) -> np.ndarray:
    """Whether each foot lies below its hip joint in the frame of the abduction link, (n, 4)."""
    level = q.reshape(-1, 4, 3).copy()
    level[..., 0] = 0
    return foot_positions(robot, level.reshape(-1, 12))[..., 2] < robot.hip_pos_b[:, 2] - 1e-3


@given(
    leg=st.integers(0, 3),
    x=st.floats(-1.0, 1.0),
    y=st.floats(-1.0, 1.0),
    z=st.floats(-1.0, 1.0),
)
def test_any_point_gives_finite_joints_and_the_nearest_foot_in_the_legs_plane(
    leg: int, x: float, y: float, z: float
) -> None:
    robot = load_a1()
    target = foot_positions(robot, robot.home_joint_pos)
    target[leg] = robot.hip_pos_b[leg] + (x, y, z)
    q, reachable = inverse_kinematics(robot, target)
    assert np.all(np.isfinite(q))
    foot = foot_positions(robot, q)[leg]
    miss = np.linalg.norm(foot - target[leg])
    assert bool(reachable[leg]) == (miss < EXACT)
    others = np.tile(q, (60, 1))  # the same abduction, any hip and knee
    generator = np.random.default_rng(3)
    others[:, 3 * leg + 1 : 3 * leg + 3] = generator.uniform(-np.pi, np.pi, (60, 2))
    misses = np.linalg.norm(foot_positions(robot, others)[:, leg] - target[leg], axis=1)
    inside_hip = np.hypot(y, z) < abs(robot.lateral_offset[leg])  # no abduction puts the plane through it
    assert inside_hip or np.all(misses >= miss - EXACT)


@pytest.mark.nojit
def test_shapes_follow_the_input() -> None:
    robot = load_a1()
    q = np.broadcast_to(robot.home_joint_pos, (2, 5, 12))
    feet = foot_positions(robot, q)
    assert feet.shape == (2, 5, 4, 3)
    assert foot_jacobians(robot, q).shape == (2, 5, 4, 3, 3)
    joints, reachable = inverse_kinematics(robot, feet)
    assert joints.shape == (2, 5, 12)
    assert reachable.shape == (2, 5, 4)


_A1: list[Robot] = []


def load_a1() -> Robot:
    if not _A1:
        _A1.append(load_robot("a1"))
    return _A1[0]
