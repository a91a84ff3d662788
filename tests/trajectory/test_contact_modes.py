"""Contact modes: which feet stand, where, and when."""

from dataclasses import replace

import numpy as np
import pytest

from fastmimic.clips.synthesis import generate
from fastmimic.motion.motion import Motion
from fastmimic.retargeting.retarget import retarget
from fastmimic.robot import Robot
from fastmimic.trajectory.contact_modes import ContactModes


@pytest.fixture(scope="module")
def walk(a1: Robot) -> Motion:
    return retarget(generate("walk"), a1)[0]


def test_nodes_are_evenly_spaced_in_each_mode_and_cover_the_cycle(walk: Motion) -> None:
    modes = ContactModes.of(walk, 0.008)
    assert modes.first[0] == 0
    assert modes.end[-1] == walk.n_samples
    assert (modes.first[1:] == modes.end[:-1]).all()
    assert modes.n_nodes == modes.steps.sum()
    spacing = np.diff(np.append(modes.sample, walk.n_samples)) * walk.dt
    assert spacing.min() >= 0.004
    assert spacing.max() <= 0.012
    for first, end, contact in zip(modes.first, modes.end, modes.contact, strict=True):
        assert (walk.contact[first:end] == contact).all()


def test_every_stance_has_one_foothold_across_the_cycles_end_as_well(walk: Motion) -> None:
    rolled = 137  # so that a stance crosses the end
    contact = np.roll(walk.contact, rolled, axis=0)
    modes = ContactModes.of(replace(walk, contact=contact), 0.008)
    touch_downs = (contact & ~np.roll(contact, 1, axis=0)).sum(axis=0)
    for leg in range(4):
        assert sum(hold.leg == leg for hold in modes.footholds) == touch_downs[leg]
    assert (modes.laps == 1).any()
    assert ((modes.foothold >= 0) == (modes.stands | modes.landing | modes.leaving)).all()
    # a foot pushes only where it stands before and after
    assert (modes.loaded <= modes.stands).all()
    assert (modes.stands[modes.loaded[modes.before]] | True).all()
    edges = modes.stands & ~modes.loaded
    assert edges.sum() == 2 * touch_downs.sum()
    landing = np.argwhere(modes.landing)
    assert len(landing) == touch_downs.sum()
    for node, leg in landing:
        assert modes.stands[modes.after[node], leg]
    leaving = np.argwhere(modes.leaving)
    assert len(leaving) == touch_downs.sum()
    for node, leg in leaving:
        assert modes.stands[modes.before[node], leg]
        assert modes.foothold[node, leg] == modes.foothold[modes.before[node], leg]


def test_swings_are_runs_of_nodes_in_order(walk: Motion) -> None:
    modes = ContactModes.of(walk, 0.008)
    for leg in range(4):
        swings = modes.swings(leg)
        assert sorted(np.concatenate(swings).tolist()) == np.flatnonzero(~modes.stands[:, leg]).tolist()
        for nodes in swings:
            assert (modes.after[nodes[:-1]] == nodes[1:]).all()


def test_without_a_period_the_ends_have_no_neighbours(walk: Motion) -> None:
    modes = ContactModes.of(replace(walk, cycle=None), 0.008)
    assert modes.sample[-1] == walk.n_samples - 1
    assert not modes.moves[0]
    assert not modes.moves[-1]
    assert modes.moves[1:-1].all()
    assert (modes.laps == 0).all()


def test_values_at_nodes_are_interpolated(walk: Motion) -> None:
    modes = ContactModes.of(walk, 0.007)
    line = np.arange(walk.n_samples, dtype=float)[:, None]
    np.testing.assert_allclose(modes.at_nodes(line, np.array([float(walk.n_samples)]))[:, 0], modes.sample)
