"""Contacts, forces, friction pyramids and paths."""

import dataclasses

import numpy as np

from fastmimic.base.arrays import stretches
from fastmimic.base.rotations import rotate_planar
from fastmimic.robot import Robot
from fastmimic.viewer.panel import gait_strip, leg_table, plot_base, plot_data, plot_series, status_line
from fastmimic.viewer.take import (
    TRAIL_POINTS,
    Take,
    contact_flags,
    contact_places,
    force_arrows,
    friction_pyramids,
    friction_use,
    trails,
)


def _busy_row(take: Take) -> int:
    return int(np.argmax((take.force[..., 2] > 0.2 * take.weight).sum(axis=1)))


def test_arrows_stand_on_the_ground_and_carry_the_weight(take: Take, a1: Robot) -> None:
    row = _busy_row(take)
    arrows = force_arrows(take, row, take.force)
    assert 2 <= len(arrows) <= 4
    assert np.all(np.abs(arrows[:, 0, 2]) < 0.01)  # a loaded foot stands on the ground
    total = (arrows[:, 1] - arrows[:, 0]).sum(axis=0) * take.weight / a1.leg_length
    strong = np.linalg.norm(take.force[row], axis=1) > 0.01 * take.weight
    np.testing.assert_allclose(total, take.force[row][strong].sum(axis=0), rtol=1e-9)


def test_the_tip_is_in_the_square_as_long_as_friction_holds(take: Take) -> None:
    row = _busy_row(take)
    foot = int(np.argmax(take.force[row, :, 2]))
    force = np.zeros_like(take.force)
    for share in (0.5, 0.99, 1.3):
        force[row, foot, 2] = 80.0
        along = np.array([share * take.friction * 80.0, 0.0])
        force[row, foot, :2] = rotate_planar(float(take.heading[row]), along)
        pushed = dataclasses.replace(take, force=force)
        edges = friction_pyramids(pushed, row)
        assert edges.shape == (8, 2, 3)
        tip = force_arrows(pushed, row, pushed.force)[0, 1]
        rim = edges[4:, 0]
        np.testing.assert_allclose(rim[:, 2], tip[2], atol=1e-12)
        local = rotate_planar(-float(take.heading[row]), rim[:, :2] - edges[0, 0, :2])
        reach = np.abs(rotate_planar(-float(take.heading[row]), tip[:2] - edges[0, 0, :2])).max()
        assert (reach <= np.abs(local).max()) == (share < 1)
        use = friction_use(pushed, row)
        np.testing.assert_allclose(use[foot], share, rtol=1e-9)
        assert np.isnan(np.delete(use, foot)).all()


def test_contact_marks_lie_under_the_feet(take: Take) -> None:
    row = _busy_row(take)
    np.testing.assert_array_equal(contact_places(take, row)[:, :2], take.feet[row, :, :2])
    flags = contact_flags(take, row)
    np.testing.assert_array_equal(flags["measured"], take.measured[row])
    blind = dataclasses.replace(take, measured=None, stance=None)
    assert not contact_flags(blind, row)["measured"].any()


def test_paths_end_at_the_feet(take: Take) -> None:
    for row in (0, 7, take.rows - 1):
        segments = trails(take.feet, row, take.rate_hz).reshape(4, TRAIL_POINTS, 2, 3)
        np.testing.assert_array_equal(segments[:, -1, 1], take.feet[row])
        np.testing.assert_array_equal(segments[:, 1:, 0], segments[:, :-1, 1])
    dashes = trails(take.feet, take.rows - 1, take.rate_hz, dashed=True).reshape(4, TRAIL_POINTS, 2, 3)
    empty = (dashes[0, :, 0] == dashes[0, :, 1]).all(axis=1)
    assert 0.4 <= empty.mean() <= 0.6


def test_the_plot_has_a_cursor_now(take: Take) -> None:
    base = plot_base(take)
    data = plot_data(base, 0.5)
    assert len(data) == len(plot_series()) == 8
    assert len({len(column) for column in data}) == 1
    assert np.all(np.diff(data[0]) >= 0)
    drawn = np.flatnonzero(np.isfinite(data[-1]))
    np.testing.assert_array_equal(data[0][drawn], [0.5, 0.5])
    np.testing.assert_array_equal(data[-1][drawn], [0.0, 1.0])
    assert all(np.isfinite(column).all() for column in data[:-1])
    for end in (0.0, (take.rows - 1) / take.rate_hz):
        assert np.isfinite(plot_data(base, end)[-1]).sum() == 2


def test_strip_and_table_tell_the_states_apart_without_colour(take: Take) -> None:
    row = _busy_row(take)
    strip = gait_strip(take, row)
    assert strip.startswith("<svg")
    assert 'fill="none"' in strip
    assert 'fill="url(#h0)"' in strip
    table = leg_table(take, row)
    assert table.count("☐ stance") == take.stance[row].sum()
    assert table.count("swing") == 4 - take.stance[row].sum()
    assert table.count("●") == take.measured[row].sum()
    assert stretches(np.array([True, True, False, True])) == [(0, 2), (3, 4)]


def test_what_a_file_is_called_cannot_become_markup(take: Take) -> None:
    named = dataclasses.replace(take, title="<img src=x>", fell_at=5)
    assert "<img" not in status_line(named, 0)
    assert "fallen" not in status_line(named, 4)
    assert "fallen" in status_line(named, 5)
