"""Fixtures shared by all tests."""

import os
from pathlib import Path

import pytest


@pytest.fixture(scope="session")
def data_folder() -> Path:
    """The folder with the real dog motions, named by FASTMIMIC_DATA."""
    value = os.environ.get("FASTMIMIC_DATA")
    if not value:
        pytest.skip("FASTMIMIC_DATA is not set: the real dog motions are needed")
    return Path(value)
