"""The exponential and logarithm of planar motions."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fastmimic.base.rotations import planar_exp, planar_log


@given(st.floats(-2, 2), st.floats(-2, 2), st.floats(-6, 6))
def test_logarithm_and_exponential_are_inverse(x: float, y: float, angle: float) -> None:
    moved, turned = planar_exp(planar_log(np.array([x, y, angle])), np.ones(()))
    assert moved == pytest.approx([x, y], abs=1e-9)
    assert turned == pytest.approx(angle)


@pytest.mark.parametrize("yaw", [0.0, 1e-300, 1e-12, -1e-8, 1e-5])
def test_straight_is_the_limit_of_turning(yaw: float) -> None:
    twist = planar_log(np.array([0.7, -0.2, yaw]))
    np.testing.assert_allclose(twist[:2], [0.7, -0.2], atol=1e-5)
    np.testing.assert_allclose(planar_exp(twist, np.ones(()))[0], [0.7, -0.2], atol=1e-15)
