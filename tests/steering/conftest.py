"""A field of few gaits, made once and then kept in the cache."""

import pytest

from fastmimic.steering.gait_field import GaitField, Grid, gait_field


@pytest.fixture(scope="session")
def gaits() -> GaitField:
    return gait_field("a1", grid=Grid((0.0, 0.7), (-0.2, 0.2), (1.0, 1.0)))
