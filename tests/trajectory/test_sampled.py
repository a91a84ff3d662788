"""A solution between its nodes: the nodes' own accelerations, however uneven the steps."""

import numpy as np
import pytest

from fastmimic.trajectory.sampled import _smooth


def test_it_has_the_accelerations_of_the_nodes_where_steps_differ() -> None:
    steps = np.repeat([0.007, 0.0085, 0.010, 0.0075], 10)
    time = np.concatenate([[0.0], np.cumsum(steps)])
    values = np.column_stack([np.sin(25 * time), 0.3 * np.cos(40 * time), 0.2 * time])
    path = _smooth(time, values)
    speed = np.diff(values, axis=0) / steps[:, None]
    acceleration = np.diff(speed, axis=0) / (0.5 * (steps[1:] + steps[:-1]))[:, None]
    greatest = np.abs(acceleration).max()
    for share in (-0.4, 0.0, 0.4):  # of a step from each node
        at = time[1:-1] + share * np.minimum(steps[1:], steps[:-1])
        assert path(at, 2) == pytest.approx(acceleration, abs=0.02 * greatest)
    half = 0.5 * (time[1:] + time[:-1])
    assert path(half, 1) == pytest.approx(speed, abs=2e-3 * np.abs(speed).max())
    assert path(time) == pytest.approx(values, abs=greatest * steps.max() ** 2 / 6)


def test_it_begins_and_ends_at_the_first_and_last_node_in_any_shape() -> None:
    time = np.cumsum(np.random.default_rng(0).uniform(0.007, 0.012, 30))
    values = np.sin(9 * time)[:, None, None] * np.ones((4, 3))
    path = _smooth(time, values)
    assert path(time[[0, -1]]) == pytest.approx(values[[0, -1]], abs=1e-12)
    assert path(time, 1).shape == (30, 4, 3)
