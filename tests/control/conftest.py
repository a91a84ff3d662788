"""Fixtures of the closed loop's tests."""

import pytest

from fastmimic.robot import Robot, load_robot


@pytest.fixture(scope="session")
def robot() -> Robot:
    return load_robot("a1")
