"""The constant-twist motion of a cycle, against matrix exponentials."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import expm

from fastmimic.primitive.motion_dmp import PlanarTwist
from primitive.motions import planar_matrix, planar_twist_matrix

lengths = st.floats(-2, 2)


@settings(deadline=None)
@given(x=lengths, y=lengths, yaw=st.floats(-4.5, 4.5), phase=st.floats(-7, 14))
def test_the_pose_is_the_matrix_exponential(x: float, y: float, yaw: float, phase: float) -> None:
    cycle, origin = np.array([x, y, yaw]), np.array([0.3, -0.8, 2.0])
    position, heading = PlanarTwist.from_cycle(origin, cycle).pose(np.array(phase))
    expected = planar_matrix(*origin) @ expm(planar_twist_matrix(cycle) * phase / (2 * np.pi))
    np.testing.assert_allclose(position, expected[:2, 2], atol=1e-9)
    np.testing.assert_allclose([np.cos(heading), np.sin(heading)], expected[:2, 0], atol=1e-9)


@pytest.mark.parametrize("yaw", [0.5, -1.7, 3.1, 4.6, 2 * np.pi, -2 * np.pi + 0.3, 4 * np.pi])
def test_one_cycle_later_the_pose_is_moved_by_the_cycle(yaw: float) -> None:
    cycle, origin = np.array([0.4, 0.1, yaw]), np.array([1.0, 2.0, -0.5])
    twist = PlanarTwist.from_cycle(origin, cycle)
    phase = np.linspace(0, 2 * np.pi, 9)
    before, heading = twist.pose(phase)
    after, later = twist.pose(phase + 2 * np.pi)
    step = planar_matrix(*origin) @ planar_matrix(*cycle) @ np.linalg.inv(planar_matrix(*origin))
    np.testing.assert_allclose(after, before @ step[:2, :2].T + step[:2, 2], atol=1e-12)
    np.testing.assert_allclose(later - heading + twist.whole_turns, yaw, atol=1e-12)


def test_a_whole_turn_stays_near_the_path_instead_of_circling_a_remote_centre() -> None:
    twist = PlanarTwist.from_cycle(np.zeros(3), np.array([0.1, 0.0, 2 * np.pi - 1e-3]))
    position, _ = twist.pose(np.linspace(0, 2 * np.pi, 100))
    assert np.abs(position).max() < 0.11
