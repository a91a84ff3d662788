"""Fixtures shared by all tests."""

import os
from pathlib import Path

import pytest

from fastmimic.robot import Robot, load_robot


@pytest.fixture(scope="session")
def data_folder() -> Path:
    """The folder with the real dog motions, named by FASTMIMIC_DATA."""
    value = os.environ.get("FASTMIMIC_DATA")
    if not value:
        pytest.skip("FASTMIMIC_DATA is not set: the real dog motions are needed")
    return Path(value)


@pytest.fixture(scope="session")
def robot() -> Robot:
    """The A1."""
    return load_robot("a1")


@pytest.fixture(scope="session")
def a1(robot: Robot) -> Robot:
    """The A1, where a test has several robots."""
    return robot
