"""The expressions of one instant, and their derivatives."""

from pathlib import Path

import casadi as ca
import mujoco
import numpy as np
import pytest

from fastmimic.base.rotations import quat_from_yaw, quat_multiply, quat_rotate_inverse
from fastmimic.robot import Robot, load_robot
from fastmimic.robot.dynamics import inverse_dynamics
from fastmimic.robot.kinematics import foot_positions
from fastmimic.trajectory.config import TrajectoryConfig
from fastmimic.trajectory.node import GIVEN, N_GIVEN, N_ROWS, N_VARIABLES, VARIABLES, casadi_functions
from fastmimic.trajectory.symbolic import NEIGHBOURS, instant
from robot.test_urdf import urdf


def _quaternion(angles: np.ndarray) -> np.ndarray:
    roll, pitch, yaw = angles
    about_x = np.array([np.cos(roll / 2), np.sin(roll / 2), 0.0, 0.0])
    about_y = np.array([np.cos(pitch / 2), 0.0, np.sin(pitch / 2), 0.0])
    return quat_multiply(quat_from_yaw(yaw), quat_multiply(about_y, about_x))


def _body_rate(angles: np.ndarray, rates: np.ndarray) -> np.ndarray:
    """Angular velocity in the body frame by numerical differentiation of the quaternion."""
    h = 1e-6
    ahead, behind = _quaternion(angles + h * rates), _quaternion(angles - h * rates)
    conjugate = _quaternion(angles) * np.array([1, -1, -1, -1])
    return 2 * quat_multiply(conjugate, (ahead - behind) / (2 * h))[1:]


@pytest.mark.parametrize("name", ["a1", "go2", "a1.urdf"])
def test_inverse_dynamics_are_mujocos(name: str, tmp_path: Path) -> None:
    """A URDF's floating link has no mass of its own, and its trunk is fixed to it."""
    if name.endswith(".urdf"):
        (tmp_path / name).write_text(urdf())
        name = str(tmp_path / name)
    robot = load_robot(name)
    rng = np.random.default_rng(0)
    q, v, a = (ca.SX.sym(x, 18) for x in "qva")
    force = ca.SX.sym("f", 12)
    now = ca.Function("now", [q, v, a, force], list(instant(robot, q, v, a, force)))
    for _ in range(5):
        x = np.concatenate(
            [rng.normal(size=3), 0.4 * rng.normal(size=3), robot.home_joint_pos + 0.3 * rng.normal(size=12)]
        )
        dx, ddx = rng.normal(size=18), 5 * rng.normal(size=18)
        wrench, torque, feet, knees, level, apart = (np.array(y).ravel() for y in now(x, dx, ddx, np.zeros(12)))
        angles, rates = x[3:6], dx[3:6]
        omega = _body_rate(angles, rates)
        h = 1e-5
        later = _body_rate(angles + h * rates + 0.5 * h * h * ddx[3:6], rates + h * ddx[3:6])
        earlier = _body_rate(angles - h * rates + 0.5 * h * h * ddx[3:6], rates - h * ddx[3:6])
        alpha = (later - earlier) / (2 * h)
        quat = _quaternion(angles)
        wanted, _ = inverse_dynamics(
            robot,
            np.concatenate([x[:3], quat, x[6:]])[None],
            np.concatenate([dx[:3], omega, dx[6:]])[None],
            np.concatenate([ddx[:3], alpha, ddx[6:]])[None],
        )
        np.testing.assert_allclose(wrench[:3], quat_rotate_inverse(quat, wanted[0, :3]), atol=1e-3)
        np.testing.assert_allclose(wrench[3:], wanted[0, 3:6], atol=1e-3)
        np.testing.assert_allclose(torque, wanted[0, 6:], atol=1e-3)
        feet_b = foot_positions(robot, x[6:])
        np.testing.assert_allclose(quat_rotate_inverse(quat, feet.reshape(4, 3) - x[:3]), feet_b, atol=1e-9)
        assert knees.shape == (4,)
        least = _least_distances(robot, x)
        assert np.all((apart > least - 0.01) & (apart < least + 1e-5)), (apart, least)
        np.testing.assert_allclose(level.reshape(4, 3)[:, 2], feet.reshape(4, 3)[:, 2] - x[2], atol=1e-9)


def test_forces_at_the_feet_carry_the_robot_and_load_the_joints() -> None:
    robot = load_robot("a1")
    q, v, a = (ca.SX.sym(x, 18) for x in "qva")
    force = ca.SX.sym("f", 12)
    now = ca.Function("now", [q, v, a, force], list(instant(robot, q, v, a, force)))
    x = np.concatenate([[0, 0, robot.home_height], np.zeros(3), robot.home_joint_pos])
    rest = np.zeros(18)
    free = now(x, rest, rest, np.zeros(12))
    push = np.array([3.0, -5.0, 40.0])
    one = now(x, rest, rest, np.concatenate([push, np.zeros(9)]))
    np.testing.assert_allclose(np.array(free[0] - one[0]).ravel()[:3], push, atol=1e-9)
    contact = foot_positions(robot, robot.home_joint_pos)[0] - [0, 0, robot.foot_radius]
    np.testing.assert_allclose(np.array(free[0] - one[0]).ravel()[3:], np.cross(contact, push), atol=1e-9)
    changed = np.array(one[1] - free[1]).ravel()
    assert np.abs(changed[:3]).max() > 1.0
    np.testing.assert_array_equal(changed[3:], 0.0)


def test_a_nodes_derivatives_are_those_of_its_rows_and_cost() -> None:
    functions = casadi_functions(load_robot("a1"), TrajectoryConfig())
    rng = np.random.default_rng(1)
    robot = load_robot("a1")
    z, p = 0.1 * rng.normal(size=N_VARIABLES), 0.1 * rng.normal(size=N_GIVEN)
    for name in ("before", "here", "after"):
        part = VARIABLES[name]
        z[part.start + 6 : part.stop] += robot.home_joint_pos
    z[VARIABLES["duration"]] = z[VARIABLES["duration_before"]] = 0.1
    p[GIVEN["share"]] = p[GIVEN["share_before"]] = 0.1
    p[GIVEN["weight"]] = 0.3
    multipliers, factor = rng.normal(size=N_ROWS), 0.7

    def slope(function: object) -> np.ndarray:
        steps = 1e-6 * np.eye(N_VARIABLES)
        return np.stack([(np.array(function(z + d)) - np.array(function(z - d))).ravel() / 2e-6 for d in steps], axis=1)

    def close(found: np.ndarray, wanted: np.ndarray) -> None:
        np.testing.assert_allclose(found, wanted, atol=2e-4 * np.abs(wanted).max())

    jacobian = np.zeros((N_ROWS, N_VARIABLES))
    jacobian[*functions.jacobian_at] = np.array(functions.jacobian(z, p)).ravel()
    close(jacobian, slope(lambda x: functions.rows(x, p)))
    gradient = np.array(functions.gradient(z, p)).ravel()
    close(gradient, slope(lambda x: functions.cost(x, p)).ravel())
    hessian = np.zeros((N_VARIABLES, N_VARIABLES))
    hessian[*functions.hessian_at] = np.array(functions.hessian(z, p, factor, multipliers)).ravel()
    assert np.array_equal(hessian, np.triu(hessian))
    hessian = hessian + np.triu(hessian, 1).T

    def lagrangian_gradient(x: np.ndarray) -> np.ndarray:
        full = np.zeros((N_ROWS, N_VARIABLES))
        full[*functions.jacobian_at] = np.array(functions.jacobian(x, p)).ravel()
        return factor * np.array(functions.gradient(x, p)).ravel() + multipliers @ full

    close(hessian, slope(lagrangian_gradient))


def _least_distances(robot: Robot, x: np.ndarray) -> np.ndarray:
    """Between points on the thighs and calves of two legs, (4,) m, by MuJoCo's kinematics."""
    model = robot.model()
    data = mujoco.MjData(model)
    data.qpos[[model.joint(name).qposadr[0] for name in robot.joint_names]] = x[6:]
    data.qpos[3] = 1.0
    mujoco.mj_kinematics(model, data)
    hips, knees = (np.array([data.xanchor[model.joint(name).id] for name in robot.joint_names[k::3]]) for k in (1, 2))
    feet = np.array([data.geom(name).xpos for name in robot.foot_geoms])
    thighs = hips[:, None] + np.array([0.5, 0.75, 1.0])[:, None] * (knees - hips)[:, None]
    calves = knees[:, None] + np.array([0.25, 0.5, 0.75, 1.0])[:, None] * (feet - knees)[:, None]
    points = np.concatenate([thighs, calves], axis=1)
    return np.array([np.linalg.norm(points[a][:, None] - points[b][None], axis=-1).min() for a, b in NEIGHBOURS])
