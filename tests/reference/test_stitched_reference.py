"""The reference of a stitched motion: synchronised where a cycle starts, and otherwise what its cycles are."""

import numpy as np
import pytest

from control.motions import gait
from fastmimic.base.rotations import rotate_planar, yaw_from_quat
from fastmimic.motion.motion import Motion
from fastmimic.reference.table import advance_clocks, make_clocks, place_clocks, reference_table, world_root
from fastmimic.robot import Robot
from fastmimic.stitching.join import stitch_motions
from fastmimic.stitching.transition import Layout


@pytest.fixture(scope="module")
def stitched(robot: Robot) -> Motion:
    return stitch_motions(
        robot, [gait(robot, (0.4, 0.0), n_samples=200), gait(robot, (0.3, 0.1), 0.5, n_samples=240, yaw0=0.8)], [4, 4]
    )


@pytest.fixture(scope="module")
def table(stitched: Motion, robot: Robot) -> np.ndarray:
    return reference_table(stitched, robot)


class TestSynchronisation:
    def test_marks_are_the_cycles_starts(self, stitched: Motion, table: np.ndarray) -> None:
        np.testing.assert_array_equal(np.flatnonzero(table["sync"]), stitched.cycle_starts)
        assert 6 <= table["sync"].sum() <= 9

    def test_of_a_cyclic_motion_the_first_sample_is_the_mark(self, robot: Robot) -> None:
        cyclic = reference_table(gait(robot, n_samples=100), robot)
        np.testing.assert_array_equal(np.flatnonzero(cyclic["sync"]), [0])

    def test_a_robot_that_lags_is_waited_for_at_each_mark_and_the_way_is_counted(
        self, stitched: Motion, table: np.ndarray
    ) -> None:
        """It stays where it is: at every mark the reference's root comes to it, in x and y; its yaw never does."""
        clocks = make_clocks(stitched, 1)
        place_clocks(clocks, np.zeros(1, np.int64), table, np.array([[1.0, 2.0, 0.5]]))
        yaw, counted = clocks["origin"][0, 2], 0.0
        for sample in range(1, stitched.n_samples):
            position, _ = world_root(table, clocks["sample"] + 1, clocks["origin"])
            advance_clocks(clocks, table[None], np.array([[1.0, 2.0]]), np.zeros(1))
            assert clocks["sample"][0] == sample
            here, _ = world_root(table, clocks["sample"], clocks["origin"])
            if table["sync"][sample]:
                np.testing.assert_allclose(here[0, :2], [1.0, 2.0], atol=1e-12)
                counted += float(np.hypot(*(position[0, :2] - [1.0, 2.0])))
            else:
                np.testing.assert_allclose(here, position, atol=1e-12)
            assert clocks["origin"][0, 2] == yaw
            assert clocks["jump"][0] == pytest.approx(counted)
        assert counted > 0.3


class TestDynamics:
    def test_accelerations_are_the_velocities_derivatives_to_the_ends(
        self, stitched: Motion, table: np.ndarray
    ) -> None:
        for velocity, acceleration in (("lin_vel", "lin_acc"), ("ang_vel", "ang_acc"), ("joint_vel", "joint_acc")):
            integral = np.cumsum(0.5 * (table[acceleration][1:] + table[acceleration][:-1]), axis=0) * stitched.dt
            change = table[velocity][1:] - table[velocity][:1]
            scale = np.abs(table[velocity]).max()
            np.testing.assert_allclose(integral, change, atol=0.05 * scale + 1e-3, err_msg=acceleration)

    def test_outside_the_transition_the_legs_take_what_they_take_in_the_cycles(
        self, stitched: Motion, table: np.ndarray, robot: Robot
    ) -> None:
        """The forces of their momentum."""
        rebuilt = Layout.of(stitched).segments[1].rebuilt
        assert rebuilt is not None
        for segment in Layout.of(stitched).segments:
            cycle = reference_table(stitched.parts[segment.part], robot)
            t = np.arange(max(segment.first, 3), min(segment.last, stitched.n_samples - 3))
            t = t[(t < rebuilt.start - 300) | (t >= rebuilt.end + 5)]  # whose stances end before the transition
            t = t[t < stitched.n_samples - 300]
            at = (t - segment.shift) % len(cycle)
            assert len(t) > 50
            turn = yaw_from_quat(table["root_quat"])[t] - yaw_from_quat(cycle["root_quat"])[at]
            for name in ("leg_lin_acc", "leg_ang_acc", "lin_acc", "ang_acc"):
                expected = np.array(cycle[name][at])
                expected[:, :2] = rotate_planar(turn, expected[:, :2])
                np.testing.assert_allclose(table[name][t], expected, atol=0.02 * np.abs(expected).max() + 1e-6)
