"""A robot, a short rollout of it, its take, and a browser."""

import shutil
from collections.abc import Iterator
from typing import Any

import pytest

from fastmimic.control.config import default_config
from fastmimic.episode.rollout import Rollout
from fastmimic.imitation.imitate import evaluate
from fastmimic.motion.motion import Motion
from fastmimic.robot import Robot
from fastmimic.runs.load import load_motion
from fastmimic.viewer.take import Take, rollout_take
from view.browsing import BROWSERS, SOFTWARE_GL

SECONDS = 1.2


@pytest.fixture(scope="session")
def trot(a1: Robot) -> Motion:
    return load_motion("trot", a1)


@pytest.fixture(scope="session")
def rollout(trot: Motion, a1: Robot) -> Rollout:
    return evaluate(trot, a1, duration_s=SECONDS, log=True).rollout


@pytest.fixture(scope="session")
def take(rollout: Rollout, trot: Motion, a1: Robot) -> Take:
    return rollout_take(rollout, trot, a1, default_config(), "trot")


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    """Headless Chromium, or a skip that says what is missing."""
    pytest.importorskip("viser", reason="the extra 'view' is not installed")
    api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed (pip install playwright)")
    executable = next((found for name in BROWSERS if (found := shutil.which(name))), None)
    if executable is None:
        pytest.skip(f"no browser: none of {', '.join(BROWSERS)} is installed")
    with api.sync_playwright() as playwright:
        launched = playwright.chromium.launch(executable_path=executable, args=list(SOFTWARE_GL))
        yield launched
        launched.close()
