"""The reference as a table of one period, and the clock that walks a robot through it."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from control.motions import gait, standing, turned
from fastmimic.base.errors import MotionError
from fastmimic.base.rotations import (
    quat_from_rotvec,
    quat_from_yaw,
    quat_multiply,
    quat_rotate,
    rotate_planar,
    yaw_from_quat,
)
from fastmimic.motion.motion import Motion
from fastmimic.reference.table import (
    advance_clocks,
    ground_acceleration,
    make_clocks,
    place_clocks,
    reference_table,
    stack_tables,
    world_root,
)
from fastmimic.robot import Robot, load_robot
from robot.mjcf import a1_tree, write

YAW0 = 0.7


@pytest.fixture(scope="module")
def motion(robot: Robot) -> Motion:
    """A turning trot that starts somewhere, under some heading."""
    return turned(gait(robot, (0.5, 0.1), 0.8), YAW0, shift=(3.0, -2.0))


@pytest.fixture(scope="module")
def table(motion: Motion, robot: Robot) -> np.ndarray:
    return reference_table(motion, robot)


class TestTable:
    def test_it_begins_at_the_origin_under_heading_zero(self, table: np.ndarray, motion: Motion) -> None:
        np.testing.assert_allclose(table["root_pos"][0], [0, 0, motion.root_pos_w[0, 2]], atol=1e-12)
        assert yaw_from_quat(table["root_quat"][0]) == pytest.approx(0, abs=1e-12)

    def test_poses_and_velocities_are_the_motions_seen_from_there(self, table: np.ndarray, motion: Motion) -> None:
        back = quat_from_yaw(YAW0)
        origin = np.array([*motion.root_pos_w[0, :2], 0.0])
        np.testing.assert_allclose(quat_rotate(back, table["root_pos"]) + origin, motion.root_pos_w, atol=1e-12)
        for name, velocity in (("lin_vel", motion.root_lin_vel_w), ("ang_vel", motion.root_ang_vel_w)):
            np.testing.assert_allclose(quat_rotate(back, table[name]), velocity, atol=1e-12)
        same = np.abs(np.sum(quat_multiply(back[None], table["root_quat"]) * motion.root_quat_wxyz, axis=1))
        np.testing.assert_allclose(same, 1.0, atol=1e-12)

    def test_joints_feet_and_contacts_are_the_motions_own(self, table: np.ndarray, motion: Motion) -> None:
        np.testing.assert_array_equal(table["joint_pos"], motion.joint_pos)
        np.testing.assert_array_equal(table["joint_vel"], motion.joint_vel)
        np.testing.assert_array_equal(table["foot_pos"], motion.foot_pos_b)
        np.testing.assert_array_equal(table["contact"].astype(bool), motion.contact)

    def test_it_does_not_depend_on_where_in_the_world_the_motion_was_recorded(
        self, motion: Motion, robot: Robot, table: np.ndarray
    ) -> None:
        other = reference_table(turned(motion, -2.1, shift=(-7.0, 5.0)), robot)
        for name in table.dtype.names or ():
            np.testing.assert_allclose(other[name], table[name], atol=1e-9, err_msg=name)

    def test_neighbouring_quaternions_are_neighbours(self, motion: Motion, robot: Robot) -> None:
        """q and −q are the same attitude; a recording that changes between them must not look like a somersault."""
        sign = np.where(np.arange(motion.n_samples) % 2 == 0, 1.0, -1.0)
        flipped = dataclasses.replace(motion, root_quat_wxyz=motion.root_quat_wxyz * sign[:, None])
        quat = reference_table(flipped, robot)["root_quat"]
        assert np.all(np.sum(quat[1:] * quat[:-1], axis=1) > 0)


class TestAcceleration:
    """Central differences of the velocities, across the wrap if the motion repeats."""

    def test_of_a_body_in_a_turn_is_centripetal_also_at_the_wrap(self, table: np.ndarray) -> None:
        speed_sq, rate = 0.5**2 + 0.1**2, 0.8
        length = np.linalg.norm(table["lin_acc"], axis=1)
        np.testing.assert_allclose(length, rate * np.sqrt(speed_sq), rtol=1e-5)
        along = np.sum(table["lin_acc"] * table["lin_vel"], axis=1)
        np.testing.assert_allclose(along, 0.0, atol=1e-6)

    def test_of_joints_is_that_of_their_velocity(self, table: np.ndarray, motion: Motion) -> None:
        v = motion.joint_vel
        np.testing.assert_allclose(
            table["joint_acc"], (np.roll(v, -1, axis=0) - np.roll(v, 1, axis=0)) * 250, atol=1e-9
        )

    def test_of_a_rolling_trunk(self, robot: Robot) -> None:
        still = gait(robot, n_samples=200)
        phase = 2 * np.pi * np.arange(200) / 200
        rate = 2 * np.pi / still.period_s
        rocking = dataclasses.replace(
            still,
            root_quat_wxyz=quat_from_rotvec(np.outer(0.05 * np.sin(phase), [1.0, 0, 0])),
            root_ang_vel_w=np.outer(0.05 * rate * np.cos(phase), [1.0, 0, 0]),
        )
        expected = -0.05 * rate**2 * np.sin(phase)
        np.testing.assert_allclose(
            reference_table(rocking, robot)["ang_acc"][:, 0], expected, atol=1e-3 * rate**2 * 0.05
        )

    def test_of_a_motion_that_does_not_repeat_is_one_sided_at_its_ends(self, robot: Robot) -> None:
        once = dataclasses.replace(gait(robot, (0.5, 0.0)), cycle=None)
        ramp = np.linspace(0.0, 0.4, once.n_samples)
        once = dataclasses.replace(once, root_lin_vel_w=np.column_stack([ramp, 0 * ramp, 0 * ramp]))
        acceleration = reference_table(once, robot)["lin_acc"][:, 0]
        np.testing.assert_allclose(acceleration, 0.4 / (once.period_s - once.dt), rtol=1e-9)


class TestClock:
    def walk(self, motion: Motion, table: np.ndarray, xy: np.ndarray) -> np.ndarray:
        """A clock after walking one period, with the robot at `xy` all the time."""
        clocks = make_clocks(motion, 1)
        place_clocks(clocks, np.zeros(1, np.int64), table, np.zeros((1, 3)))
        for _ in range(motion.n_samples):
            advance_clocks(clocks, table[None], np.atleast_2d(xy), np.zeros(1))
        return clocks

    @pytest.mark.nojit
    def test_each_step_is_one_sample(self, motion: Motion, table: np.ndarray) -> None:
        clocks = make_clocks(motion, 2)
        place_clocks(clocks, np.array([0, 17]), table, np.zeros((2, 3)))
        before = clocks["origin"].copy()
        for _ in range(5):
            advance_clocks(clocks, table[None], np.full((2, 3), 99.0), np.zeros(2))
        np.testing.assert_array_equal(clocks["sample"], [5, 22])
        np.testing.assert_array_equal(clocks["cycle"], 0)
        np.testing.assert_array_equal(clocks["origin"], before, "within a period the origin stays")

    @pytest.mark.nojit
    def test_a_robot_exactly_where_it_should_be_notices_nothing_at_the_wrap(
        self, motion: Motion, table: np.ndarray
    ) -> None:
        """The period's displacement, turned into the world, is where the next period begins."""
        assert motion.cycle is not None
        clocks = self.walk(motion, table, motion.cycle[:2])
        assert clocks["sample"][0] == 0
        assert clocks["cycle"][0] == 1
        np.testing.assert_allclose(clocks["origin"][0], motion.cycle, atol=1e-12)
        assert clocks["jump"][0] == pytest.approx(0, abs=1e-12)

    def test_the_reference_continues_smoothly_over_the_wrap(self, motion: Motion, table: np.ndarray) -> None:
        """One sample of way and one of turn between the last sample and the first of the next period."""
        assert motion.cycle is not None
        last, last_quat = world_root(table, np.array(motion.n_samples - 1), np.zeros(3))
        first, first_quat = world_root(table, np.array(0), np.array(motion.cycle))
        assert np.linalg.norm(first - last) == pytest.approx(np.hypot(0.5, 0.1) * motion.dt, rel=1e-6)
        assert yaw_from_quat(first_quat) - yaw_from_quat(last_quat) == pytest.approx(0.8 * motion.dt)

    @pytest.mark.nojit
    def test_x_and_y_are_synchronised_to_the_robot_at_the_wrap_but_never_yaw(
        self, motion: Motion, table: np.ndarray
    ) -> None:
        assert motion.cycle is not None
        robot_xy = motion.cycle[:2] + np.array([0.03, -0.04])
        clocks = self.walk(motion, table, robot_xy)
        position, quat = world_root(table, clocks["sample"], clocks["origin"])
        np.testing.assert_allclose(position[0, :2], robot_xy, atol=1e-12)
        assert position[0, 2] == table["root_pos"][0, 2], "height is never synchronised"
        assert yaw_from_quat(quat[0]) == pytest.approx(motion.cycle[2])

    def test_what_the_synchronisation_hides_adds_up(self, motion: Motion, table: np.ndarray) -> None:
        """3-4-5: 5 cm at the first wrap; the robot then stays 5 cm behind at each of the next."""
        assert motion.cycle is not None
        clocks = make_clocks(motion, 1)
        place_clocks(clocks, np.zeros(1, np.int64), table, np.zeros((1, 3)))
        for cycle in range(3):
            origin = clocks["origin"][0].copy()
            expected = origin[:2] + rotate_planar(origin[2], motion.cycle[:2])
            robot_xy = expected + 0.05 * np.array([np.cos(cycle), np.sin(cycle)])
            for _ in range(motion.n_samples):
                advance_clocks(clocks, table[None], robot_xy[None], np.zeros(1))
            assert clocks["jump"][0] == pytest.approx(0.05 * (cycle + 1))
        assert clocks["origin"][0, 2] == pytest.approx(3 * motion.cycle[2]), "yaw goes on by the motion's own turn"

    def test_robots_advance_independently_each_in_its_own_table(self, motion: Motion, robot: Robot) -> None:
        tables = stack_tables([motion, motion], robot)
        clocks = make_clocks(motion, 2)
        last = motion.n_samples - 1
        place_clocks(clocks, np.array([last, 3]), tables[0], np.zeros((2, 3)))
        advance_clocks(clocks, tables, np.zeros((2, 3)), np.zeros(2))
        np.testing.assert_array_equal(clocks["sample"], [0, 4])
        np.testing.assert_array_equal(clocks["cycle"], [1, 0])

    def test_placing_puts_the_sample_into_the_wanted_pose(self, motion: Motion, table: np.ndarray) -> None:
        clocks = make_clocks(motion, 3)
        clocks["jump"], clocks["cycle"] = 1.0, 5
        sample = np.array([0, 40, 199])
        pose = np.array([[1.0, 2.0, 0.3], [0.0, 0.0, 0.0], [-3.0, 1.0, -2.0]])
        place_clocks(clocks, sample, table, pose)
        position, quat = world_root(table, sample, clocks["origin"])
        np.testing.assert_allclose(position[:, :2], pose[:, :2], atol=1e-12)
        np.testing.assert_allclose(yaw_from_quat(quat), pose[:, 2], atol=1e-12)
        np.testing.assert_array_equal(clocks["jump"], 0)
        np.testing.assert_array_equal(clocks["cycle"], 0)


def test_references_of_one_batch_have_one_period(robot: Robot) -> None:
    with pytest.raises(MotionError, match=r"same number of samples, found \[200, 250\]"):
        stack_tables([gait(robot), gait(robot, n_samples=200)], robot)


class TestGroundAcceleration:
    """What the ground gives, as acceleration of a body with the robot's mass and inertia."""

    def test_a_robot_that_stands_takes_nothing_beyond_its_weight(self, robot: Robot) -> None:
        linear, angular = ground_acceleration(standing(robot), robot)
        np.testing.assert_allclose(linear, 0.0, atol=1e-9)
        np.testing.assert_allclose(angular, 0.0, atol=1e-9)

    def test_over_a_cycle_the_impulse_is_that_of_gravity(self, motion: Motion, robot: Robot) -> None:
        """Momentum repeats with the motion, so its rate of change has no mean."""
        straight = gait(robot, (0.5, 0.1), 0.0)
        linear, angular = ground_acceleration(straight, robot)
        np.testing.assert_allclose(linear.mean(axis=0), 0.0, atol=2e-3)
        np.testing.assert_allclose(angular.mean(axis=0), 0.0, atol=2e-2)
        assert np.ptp(linear, axis=0).max() > 0.1, "there is something to see"

    def test_without_legs_it_is_the_trunks_own_acceleration(self, motion: Motion, robot: Robot, tmp_path: Path) -> None:
        tree = a1_tree()
        for body in tree.iter("body"):
            inertial = body.find("inertial")
            assert inertial is not None
            if body.get("name") == "trunk":
                inertial.set("pos", "0 0 0")
            else:
                inertial.set("mass", "1e-4")
                inertial.set("fullinertia", "1e-7 1e-7 1e-7 0 0 0")
        bodiless = load_robot(write(tree, tmp_path / "light.xml"))
        heavy, light = (reference_table(motion, r) for r in (robot, bodiless))
        for name, size in (("leg_lin_acc", 0.1), ("leg_ang_acc", 1.0)):
            assert np.abs(heavy[name]).max() > size
            assert np.abs(light[name]).max() < 0.02 * np.abs(heavy[name]).max(), name

    def test_a_modulated_reference_keeps_its_demonstrations(self, motion: Motion, robot: Robot) -> None:
        higher = dataclasses.replace(
            motion,
            foot_pos_b=motion.foot_pos_b + np.array([0, 0, 0.01]),
            joint_vel=1.1 * motion.joint_vel,
            demonstration=motion,
        )
        for name in ("leg_lin_acc", "leg_ang_acc"):
            np.testing.assert_array_equal(reference_table(higher, robot)[name], reference_table(motion, robot)[name])
