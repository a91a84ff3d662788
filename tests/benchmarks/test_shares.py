"""Shares with their intervals, and the way of a robot on a terrain."""

from types import SimpleNamespace

import numpy as np
import pytest
from shares import interval, shown
from terrain import length, way


def test_wilsons_interval() -> None:
    """Newcombe (1998), table I: 81 of 263, and none of 20."""
    assert interval(np.arange(263) < 81) == pytest.approx((0.2553, 0.3662), abs=1e-4)
    assert interval(np.zeros(20)) == pytest.approx((0.0, 0.1611), abs=1e-4)
    assert shown(1.0, interval(np.ones(16))) == "100% (81% to 100%)"


def test_way_goes_from_cycle_to_cycle() -> None:
    """Sway within a cycle is no way, and what follows a fall does not count."""
    t = np.arange(101)
    path = np.stack([0.01 * t, 0.2 * np.sin(2 * np.pi * t / 10), np.zeros(101)], axis=1)
    done = SimpleNamespace(course=SimpleNamespace(observation={"root_pos": path[None]}), steps=[81])
    assert way(done, SimpleNamespace(n_samples=10), 0) == pytest.approx(0.8)  # type: ignore[arg-type]


def test_slow_motions_have_the_time_they_need() -> None:
    fast, slow = (SimpleNamespace(cycle=(step, 0.0, 0.0), period_s=0.5) for step in (0.5, 0.1))
    assert (length(fast), length(slow)) == (10.0, 30.0)  # type: ignore[arg-type]
