"""Contacts of an animal's feet, and the clean gait that is made of them."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fastmimic.motion.contacts import (
    ContactConfig,
    Stance,
    contact_mask,
    detect,
    duty_factors,
    foot_activity,
    stances_of,
    swings_of,
    swung,
)
from fastmimic.retargeting.contact_schedule import ContactScheduleConfig, make_consistent, with_steps

RATE = 60.0
N = 36


def trotting_feet(duty: float = 0.6) -> tuple[np.ndarray, np.ndarray]:
    """Heights and speeds (N, 4) of feet that swing 8 cm high at up to 3 m/s in diagonal pairs."""
    share = np.arange(N) / N
    height, speed = np.zeros((N, 4)), np.zeros((N, 4))
    for leg, phase in enumerate((0.0, 0.5, 0.5, 0.0)):
        swing = np.clip((np.mod(share - phase, 1.0) - duty) / (1 - duty), 0, 1)
        height[:, leg] = 0.08 * np.sin(np.pi * swing) ** 2
        speed[:, leg] = 3.0 * np.sin(np.pi * swing)
    return height, speed


def found(height: np.ndarray, speed: np.ndarray) -> list[list[Stance]]:
    config = ContactConfig()
    return detect(foot_activity(height, speed, RATE, True, config), RATE, True, config)


def test_a_foot_stands_while_it_is_slower_than_a_quarter_of_its_swing() -> None:
    """A sine falls below 0.25 and rises above 0.30 of its peak within 8 % and 10 % of its ends: 7 % more duty here."""
    duty = duty_factors(found(*trotting_feet(0.6)), N)
    assert duty == pytest.approx(0.6 + 0.4 * (0.080 + 0.097), abs=1 / N)


def test_a_marker_that_sits_higher_or_an_animal_of_another_size_changes_nothing() -> None:
    height, speed = trotting_feet()
    before = found(height, speed)
    assert found(2.0 * height, 2.0 * speed) == before


def test_a_foot_that_hardly_moves_is_standing() -> None:
    quiet = np.full((N, 4), 0.002), 0.05 * np.abs(np.sin(np.arange(N)))[:, None].repeat(4, axis=1)
    assert found(*quiet) == [[Stance(0, N)]] * 4


@pytest.mark.parametrize(("rests_s", "lifted"), [(1.0, 0.025), (0.3, 0.025), (1.0, 0.10)])
def test_a_foot_that_rests_stands_though_its_toe_is_high(rests_s: float, lifted: float) -> None:
    """As a dog's does that stands before it walks; not one that is held up, or that pauses."""
    n = round(rests_s * RATE)
    height, speed = np.zeros((n + 240, 4)), np.zeros((n + 240, 4))
    height[:n] = lifted
    height[n + 100 : n + 130], speed[n + 100 : n + 130] = 0.08, 3.0
    config = ContactConfig()
    legs = detect(foot_activity(height, speed, RATE, False, config), RATE, False, config)
    stands = contact_mask(legs, n + 240)[: n - 5]
    assert stands.all() if (rests_s, lifted) == (1.0, 0.025) else not stands.any()


def test_flicker_is_removed() -> None:
    height, speed = trotting_feet()
    clean = found(height, speed)
    middle = clean[1][0].touch_down + clean[1][0].duration // 2
    speed[middle % N, 1] = 3.0  # one bad frame in mid-stance
    assert found(height, speed) == clean


def test_a_slow_step_beside_fast_ones_is_still_a_step() -> None:
    """Two takes in one: a gallop, then a slow step of a sixth of its speed."""
    speed = np.zeros((240, 4))
    speed[20:40] = 6.0
    speed[180:210] = 1.0
    config = ContactConfig()
    legs = detect(foot_activity(np.zeros((240, 4)), speed, RATE, False, config), RATE, False, config)
    assert [len(leg) for leg in legs] == [3] * 4


@given(st.lists(st.booleans(), min_size=3, max_size=40), st.booleans())
def test_stances_and_mask_are_inverse(on: list[bool], periodic: bool) -> None:
    mask = np.array(on)
    spans = stances_of(mask, periodic)
    assert np.array_equal(contact_mask([spans], len(mask))[:, 0], mask)
    swings = swings_of(spans, len(mask), periodic)
    assert sum(s.duration for s in spans) + sum(b - a for a, b in swings) == len(mask)


def consistent(stances: list[list[Stance]], n: int, straight: bool = True, longest_s: float = 10.0):  # type: ignore[no-untyped-def]
    return make_consistent(stances, n, 100.0, True, straight, longest_s, ContactScheduleConfig())


def test_diagonal_pairs_get_common_times_and_one_duty() -> None:
    """Front feet that are seen to stand shorter than the hind feet of their pair: a trot's thresholds."""
    stances = [[Stance(0, 50)], [Stance(50, 100)], [Stance(50, 112)], [Stance(0, 60)]]
    result, changes = consistent(stances, 100)
    assert changes.pairing == "diagonal"
    assert result[0] == result[3]
    assert result[1] == result[2]
    assert duty_factors(result, 100) == pytest.approx(0.555, abs=0.011)


def test_a_turn_keeps_its_uneven_duty() -> None:
    stances = [[Stance(0, 55)], [Stance(40, 110)], [Stance(25, 75)], [Stance(70, 130)]]
    result, changes = consistent(stances, 100, straight=False)
    assert result == stances
    assert changes.pairing is None


def test_a_flight_too_short_to_be_seen_is_closed_from_both_sides() -> None:
    stances = [[Stance(0, 47)], [Stance(50, 97)], [Stance(50, 97)], [Stance(0, 47)]]
    result, changes = consistent(stances, 100)
    assert changes.closed_flights == 2
    assert contact_mask(result, 100).any(axis=1).all()
    assert duty_factors(result, 100) == pytest.approx(0.5)


def test_a_stance_is_not_extended_beyond_the_reach_of_the_leg() -> None:
    stances = [[Stance(0, 47)], [Stance(50, 97)], [Stance(50, 97)], [Stance(0, 47)]]
    result, changes = consistent(stances, 100, longest_s=0.47)
    assert changes.closed_flights == 0
    assert result == stances


def test_a_real_flight_stays() -> None:
    stances = [[Stance(0, 38)], [Stance(50, 88)], [Stance(50, 88)], [Stance(0, 38)]]
    assert consistent(stances, 100)[0] == stances


def test_share_of_a_swing_that_is_over() -> None:
    contact = np.ones((10, 4), dtype=bool)
    contact[[8, 9, 0, 1], 0] = False  # over the seam
    contact[2:7, 2] = False
    cycle = swung(contact, periodic=True)
    np.testing.assert_array_equal(cycle[[7, 8, 9, 0, 1, 2], 0], [0, 0, 0.25, 0.5, 0.75, 0])
    np.testing.assert_array_equal(cycle[1:8, 2], [0, 0, 0.2, 0.4, 0.6, 0.8, 0])
    assert not cycle[:, [1, 3]].any()
    np.testing.assert_array_equal(swung(contact, periodic=False)[[8, 9, 0, 1], 0], [0, 0.5, 0, 0.5])


def test_a_swing_too_short_for_a_motor_is_widened() -> None:
    stances = [[Stance(6, 100)], [Stance(0, 100)], [Stance(0, 100)], [Stance(0, 100)]]
    result, changes = consistent(stances, 100, straight=False)
    assert changes.widened_swings == 1
    assert 100 - result[0][0].duration == 12


def test_a_leg_that_stands_through_a_cycle_that_travels_is_given_a_step() -> None:
    """Where the others stand, and of these moments where it moved most; a leg that steps already is left alone."""
    rate, n = 100.0, 120
    others = [[Stance(30, 120)], [Stance(60, 150)], [Stance(0, 120)]]
    activity = np.zeros((n, 4))
    activity[80:100, 0] = 0.2
    travel = np.array([0.1, 0.1, 0.1, 0.001])
    stances, added = with_steps([[Stance(0, n)], *others], travel, activity, rate, ContactScheduleConfig())
    assert added == 1
    assert stances[1:] == others
    lift_off, touch_down = swings_of(stances[0], n, True)[0]
    assert touch_down - lift_off == round(ContactScheduleConfig().step_s * rate)
    swing = ~contact_mask(stances, n)[:, 0]
    assert not swing[:60].any()  # the others' swings
    assert swing[80:100].all()


def test_a_leg_that_would_not_slide_keeps_standing() -> None:
    standing = [[Stance(0, 120)] for _ in range(4)]
    assert with_steps(standing, np.full(4, 0.004), np.ones((120, 4)), 100.0, ContactScheduleConfig()) == (standing, 0)
