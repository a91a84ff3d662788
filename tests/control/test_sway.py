"""The body's sway over its footholds, against independent solutions of the linear inverted pendulum."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from control.motions import gait, standing, turned
from fastmimic.control.reference import reference_table
from fastmimic.control.sway import LOADING_TIME
from fastmimic.conventions import GRAVITY
from fastmimic.motion.motion import Motion
from fastmimic.robot import Robot, load_robot
from fastmimic.robot.kinematics import inverse_kinematics
from robot.mjcf import Simulated, a1_tree, write

PACE = (0.0, 0.5, 0.0, 0.5)
"""Right legs, then left legs."""
DUTY = 0.6


@pytest.fixture(scope="module")
def light_legged(tmp_path_factory: pytest.TempPathFactory) -> Robot:
    """An A1 whose legs weigh a gram: all of it is the pendulum's bob, whatever the legs do."""
    tree = a1_tree()
    for body in tree.iter("body"):
        if body.get("name") != "trunk":
            body.find("inertial").set("mass", "1e-4")
            body.find("inertial").set("fullinertia", "1e-7 1e-7 1e-7 0 0 0")
    return load_robot(write(tree, tmp_path_factory.mktemp("robot") / "light.xml"))


@pytest.fixture(scope="module")
def pace(light_legged: Robot) -> Motion:
    """On the spot."""
    return gait(light_legged, touchdown=PACE, duty=DUTY)


def sway(motion: Motion, robot: Robot) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Shift, velocity and acceleration, (t, 2) each, heading frame, as the controller gets them."""
    table = reference_table(motion, robot)
    return table["sway_pos"], table["sway_vel"], table["sway_acc"]


def load(motion: Motion, touchdown: tuple[float, ...], duty: float) -> np.ndarray:
    """(t, 4) from the schedule: up within the loading time of touch-down, down again before take-off, 1 in between."""
    out = np.zeros((motion.n_samples, 4))
    for leg in range(4):
        since = ((np.arange(motion.n_samples) * motion.dt / motion.period_s - touchdown[leg]) % 1.0) * motion.period_s
        until = duty * motion.period_s - since
        out[:, leg] = np.clip(np.minimum(since, until) / LOADING_TIME, 0.0, 1.0)
    return out


def periodic_bounded_solution(target: np.ndarray, omega: float, dt: float) -> np.ndarray:
    """δ(t) = ω/2 ∫ e^(−ω|t − s|) p(s) ds, the one solution of δ̈ = ω² (δ − p) that stays bounded, by quadrature."""
    repeats = int(np.ceil(3.0 / (len(target) * dt)))
    wide = np.tile(target, (2 * repeats + 1, 1))
    lag = dt * (np.arange(len(wide))[None] - (repeats * len(target) + np.arange(len(target)))[:, None])
    return dt * omega / 2 * np.exp(-omega * np.abs(lag)) @ wide


class TestStandingStill:
    def test_over_the_middle_of_the_feet_needs_none(self, robot: Robot) -> None:
        motion = standing(robot)
        simulated = Simulated(robot)
        feet, joints = motion.foot_pos_b[0].copy(), motion.joint_pos[0]
        for _ in range(20):  # moving the feet moves the centre of mass a little
            simulated.pose(joints, np.zeros(3), np.array([1.0, 0, 0, 0]))
            com = simulated.data.subtree_com[simulated.trunk]
            feet[:, :2] += com[:2] - feet[:, :2].mean(axis=0)
            joints, _ = inverse_kinematics(robot, feet)
        n = motion.n_samples
        centred = dataclasses.replace(motion, joint_pos=np.tile(joints, (n, 1)), foot_pos_b=np.tile(feet, (n, 1, 1)))
        for part in sway(centred, robot):
            np.testing.assert_allclose(part, 0.0, atol=1e-9)

    def test_elsewhere_shifts_the_body_over_the_middle_of_the_feet(self, robot: Robot) -> None:
        """Constantly, by the distance from the centre of mass to the mean of the feet."""
        motion = standing(robot)
        simulated = Simulated(robot)
        simulated.pose(motion.joint_pos[0], np.zeros(3), np.array([1.0, 0, 0, 0]))
        com = simulated.data.subtree_com[simulated.trunk]
        position, velocity, acceleration = sway(motion, robot)
        expected = motion.foot_pos_b[0, :, :2].mean(axis=0) - com[:2]
        np.testing.assert_allclose(position, np.tile(expected, (motion.n_samples, 1)), atol=1e-9)
        np.testing.assert_allclose(velocity, 0.0, atol=1e-9)
        np.testing.assert_allclose(acceleration, 0.0, atol=1e-7)


class TestAlternatingSupport:
    """A pace on the spot: left and right legs take turns, the body sways from side to side."""

    def test_agrees_with_the_linear_inverted_pendulum(self, pace: Motion, light_legged: Robot) -> None:
        share = load(pace, PACE, DUTY)
        support = np.einsum("tl,tlk->tk", share, pace.foot_pos_b[..., :2]) / share.sum(axis=1, keepdims=True)
        height = pace.root_pos_w[0, 2] + light_legged.com_b[2]
        expected = periodic_bounded_solution(support - light_legged.com_b[:2], np.sqrt(GRAVITY / height), pace.dt)
        position, _, _ = sway(pace, light_legged)
        assert np.ptp(position[:, 1]) > 0.02, "there is something to sway for"
        # 2 ms samples of a support that moves by 0.26 m within 50 ms
        np.testing.assert_allclose(position[:, 1], expected[:, 1], atol=0.02 * np.ptp(expected[:, 1]))
        np.testing.assert_allclose(position[:, 0], expected[:, 0], atol=1e-3)

    def test_is_to_the_side_that_carries(self, pace: Motion, light_legged: Robot) -> None:
        position, _, _ = sway(pace, light_legged)
        right = pace.contact[:, 0] & ~pace.contact[:, 1]
        left = pace.contact[:, 1] & ~pace.contact[:, 0]
        assert np.all(position[right, 1] < 0)
        assert np.all(position[left, 1] > 0)

    def test_velocity_and_acceleration_are_the_shifts_own(self, pace: Motion, light_legged: Robot) -> None:
        position, velocity, acceleration = sway(pace, light_legged)
        before, now, after = position[:-2], position[1:-1], position[2:]
        np.testing.assert_allclose(velocity[1:-1], (after - before) / (2 * pace.dt), atol=1e-9)
        np.testing.assert_allclose(acceleration[1:-1], (after - 2 * now + before) / pace.dt**2, atol=1e-6)

    def test_does_not_depend_on_the_sample_that_the_period_begins_with(self, pace: Motion, light_legged: Robot) -> None:
        position, _, _ = sway(pace, light_legged)
        later = gait(light_legged, touchdown=tuple((t - 0.3) % 1.0 for t in PACE), duty=DUTY)
        moved, _, _ = sway(later, light_legged)
        # the motion is continued for some time constants only: e^(−1.5 s · ω) ≈ 1e-4 of the sway is left
        np.testing.assert_allclose(moved, np.roll(position, -75, axis=0), atol=2e-4 * np.ptp(position))

    def test_a_narrower_stance_sways_less(self, pace: Motion, light_legged: Robot) -> None:
        feet = pace.foot_pos_b * np.array([1.0, 0.5, 1.0])
        joints, _ = inverse_kinematics(light_legged, feet)
        narrow = dataclasses.replace(pace, foot_pos_b=feet, joint_pos=joints)
        wide_sway, narrow_sway = sway(pace, light_legged)[0], sway(narrow, light_legged)[0]
        assert np.ptp(narrow_sway[:, 1]) == pytest.approx(0.5 * np.ptp(wide_sway[:, 1]), rel=0.01)

    def test_a_body_that_bounces_sways_by_the_force_that_carries_it(self, pace: Motion, light_legged: Robot) -> None:
        """δ̈ = f_z / (m h) (δ − (p − z)): the harder the ground pushes, the faster the pendulum falls."""
        rate = 2 * 2 * np.pi / pace.period_s  # twice a period
        angle = 2 * 2 * np.pi * np.arange(pace.n_samples) / pace.n_samples
        bounce = 0.006 * np.cos(angle)
        feet = pace.foot_pos_b - np.stack([0 * bounce, 0 * bounce, bounce], axis=1)[:, None]
        joints, _ = inverse_kinematics(light_legged, feet)
        velocity = np.column_stack([0 * angle, 0 * angle, -0.006 * rate * np.sin(angle)])
        position = pace.root_pos_w + np.column_stack([0 * angle, 0 * angle, bounce])
        bouncing = dataclasses.replace(
            pace, root_pos_w=position, root_lin_vel_w=velocity, foot_pos_b=feet, joint_pos=joints
        )
        share = load(bouncing, PACE, DUTY)
        support = np.einsum("tl,tlk->tk", share, feet[..., :2]) / share.sum(axis=1, keepdims=True)
        force = GRAVITY - rate**2 * bounce  # per kilogram: between 6 and 13 m/s²
        stiffness = force / (position[:, 2] + light_legged.com_b[2])
        shift, _, acceleration = sway(bouncing, light_legged)
        expected = stiffness[:, None] * (shift - (support - light_legged.com_b[:2]))
        scale = np.abs(expected[:, 1]).max()
        np.testing.assert_allclose(acceleration[:, 1], expected[:, 1], atol=0.05 * scale)
        constant = (
            GRAVITY / (position[:, 2].mean() + light_legged.com_b[2]) * (shift - support + light_legged.com_b[:2])[:, 1]
        )
        assert np.abs(acceleration[:, 1] - constant).max() > 0.15 * scale, "the bounce is large enough to matter"

    def test_in_flight_nothing_can_push_the_body(self, light_legged: Robot) -> None:
        flying = gait(light_legged, touchdown=PACE, duty=0.3)
        _, _, acceleration = sway(flying, light_legged)
        flight = ~flying.contact.any(axis=1)
        assert flight.mean() == pytest.approx(0.4, abs=0.02)
        np.testing.assert_allclose(acceleration[flight], 0.0, atol=1e-6)

    def test_a_motion_without_any_stance_has_nothing_to_sway_over(self, robot: Robot) -> None:
        motion = gait(robot)
        for part in sway(dataclasses.replace(motion, contact=np.zeros_like(motion.contact)), robot):
            np.testing.assert_array_equal(part, 0.0)


class TestHeadings:
    def test_the_world_turned_by_any_angle_changes_nothing(self, robot: Robot) -> None:
        """The shift is given in the reference's own heading frame, its velocity and acceleration as well."""
        motion = gait(robot, (0.5, 0.1), 0.9, touchdown=PACE)
        here, there = sway(motion, robot), sway(turned(motion, 2.5, shift=(4.0, -1.0)), robot)
        for a, b in zip(here, there, strict=True):
            np.testing.assert_allclose(b, a, atol=1e-7)

    def test_in_a_turn_it_repeats_with_the_body(self, robot: Robot) -> None:
        """Every period of a turning gait looks the same seen from the body, so no jump at the wrap."""
        position, _, _ = sway(gait(robot, (0.5, 0.0), 1.2, touchdown=PACE), robot)
        steps = np.linalg.norm(np.diff(position, axis=0, append=position[:1]), axis=1)
        assert steps[-1] < 1.2 * steps.max()
        assert steps.max() < 2e-3

    def test_a_turn_may_be_given_with_or_without_its_whole_turns(self, robot: Robot) -> None:
        """Ten steps of a turn on the spot, 6 rad in all, are the same as 6 − 2π."""
        step = gait(robot, yaw_rate=1.2, touchdown=PACE)
        parts = [turned(step, 0.6 * k) for k in range(10)]
        names = ("root_pos_w", "root_quat_wxyz", "joint_pos", "joint_vel", "foot_pos_b", "contact")
        names += ("root_lin_vel_w", "root_ang_vel_w")
        arrays = {name: np.concatenate([getattr(part, name) for part in parts]) for name in names}
        expected = np.tile(sway(step, robot)[0], (10, 1))
        for yaw in (6.0, 6.0 - 2 * np.pi):
            whole = dataclasses.replace(step, **arrays, cycle=np.array([0.0, 0.0, yaw]))
            np.testing.assert_allclose(sway(whole, robot)[0], expected, atol=2e-4 * np.ptp(expected))


class TestOnce:
    """Motions that do not repeat."""

    def repeated(self, motion: Motion, times: int) -> Motion:
        """Several periods of a gait on the spot as one motion that does not repeat."""
        names = ("joint_pos", "joint_vel", "root_pos_w", "root_quat_wxyz", "root_lin_vel_w", "root_ang_vel_w")
        arrays = {name: np.tile(getattr(motion, name), (times, 1)) for name in names}
        return dataclasses.replace(
            motion,
            **arrays,
            foot_pos_b=np.tile(motion.foot_pos_b, (times, 1, 1)),
            contact=np.tile(motion.contact, (times, 1)),
            cycle=None,
        )

    def test_their_middle_sways_like_the_gait_that_repeats(self, robot: Robot) -> None:
        pace = gait(robot, touchdown=PACE)
        position, velocity, _ = sway(self.repeated(pace, 9), robot)
        assert np.isfinite(position).all()
        middle = slice(4 * pace.n_samples, 5 * pace.n_samples)
        expected_position, expected_velocity, _ = sway(pace, robot)
        # what happens 2 s away counts e^(−2 ω) ≈ 1e-5 of its 0.1 m
        np.testing.assert_allclose(position[middle], expected_position, atol=1e-5)
        np.testing.assert_allclose(velocity[middle], expected_velocity, atol=1e-4)

    def test_they_begin_and_end_within_reach_of_their_feet(self, robot: Robot) -> None:
        pace = gait(robot, touchdown=PACE)
        position, _, _ = sway(self.repeated(pace, 2), robot)
        assert np.all(np.abs(position[:, 1]) < np.abs(pace.foot_pos_b[..., 1]).max())


def test_heavy_legs_count(robot: Robot, light_legged: Robot) -> None:
    """The whole robot's zero-moment point is brought under the feet, not that of a lone bob."""
    heavy, light = (sway(gait(r, touchdown=PACE), r)[0][:, 1] for r in (robot, light_legged))
    assert np.abs(heavy - light).max() > 1e-3


def test_the_robots_file_may_have_the_base_anywhere(tmp_path: Path) -> None:
    """A gravity of its own or contacts in the user's file do not enter: the ground's force follows from the motion."""
    tree = a1_tree()
    option = tree.makeelement("option", {"gravity": "0 0 -1.6", "timestep": "0.01"})
    tree.insert(0, option)
    moon, earth = load_robot(write(tree, tmp_path / "moon.xml")), load_robot("a1")
    a, b = (sway(gait(r, touchdown=PACE), r)[0] for r in (moon, earth))
    np.testing.assert_allclose(a, b, atol=1e-9)
