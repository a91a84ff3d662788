"""Where basis functions go: evenly in a stride, to the swings in a long loop."""

import numpy as np
import pytest

from fastmimic.primitive import RhythmicDmp
from fastmimic.primitive.rhythmic import basis_widths, normalised_basis, place_basis
from primitive.integrator import DmpIntegrator

LONG = 3000  # samples: 6 s at 500 Hz


def steps_and_pauses(n: int, swings: tuple[float, ...] = (0.5, 1.5, 2.3, 4.0), swing_s: float = 0.2) -> np.ndarray:
    """A foot (t, 1) that stands through a loop of 6 s except for a few swings of 6 cm."""
    t = np.arange(n) * 6.0 / n
    y = np.zeros(n)
    for start in swings:
        u = np.clip((t - start) / swing_s, 0, 1)
        y += 0.06 * 16 * u**2 * (1 - u) ** 2
    return y[:, None]


def test_one_stride_gets_evenly_spaced_functions() -> None:
    centres = place_basis(steps_and_pauses(325), 100)
    np.testing.assert_allclose(centres[0], 2 * np.pi * np.arange(100) / 100, atol=1e-15)


def test_in_a_long_loop_swings_get_more_functions_than_their_share_of_time() -> None:
    centres = place_basis(steps_and_pauses(LONG), 100)[0]
    assert np.all(np.diff(centres) > 0)
    assert centres[0] == 0
    time = centres * 6 / (2 * np.pi)
    in_swing = sum(np.count_nonzero((time > s - 0.05) & (time < s + 0.25)) for s in (0.5, 1.5, 2.3, 4.0))
    assert in_swing > 40, "evenly spaced ones would be 20"


def test_functions_are_never_closer_than_four_samples() -> None:
    centres = place_basis(steps_and_pauses(1200, swings=(2.0,)), 100)[0]
    assert np.min(np.diff(centres)) > 3.9 * 2 * np.pi / 1200


def test_functions_sum_to_one_wherever_they_are() -> None:
    centres = place_basis(steps_and_pauses(LONG), 100)
    basis = normalised_basis(np.linspace(0, 2 * np.pi, 777), centres, basis_widths(centres))
    assert basis.shape == (777, 1, 100)
    np.testing.assert_allclose(basis.sum(axis=-1), 1.0, atol=1e-12)


def test_a_long_loop_is_fitted_below_a_millimetre_by_a_hundred_functions() -> None:
    y = steps_and_pauses(LONG)
    dmp = RhythmicDmp.fit(y, 6.0, 100)
    error = dmp.position(2 * np.pi * np.arange(LONG) / LONG) - y
    assert dmp.n_basis == 100
    assert np.sqrt(np.mean(error**2)) < 5e-4
    assert dmp.shape(2 * np.pi * np.arange(LONG) / LONG).mean() == pytest.approx(0, abs=1e-12)


def test_closed_and_integrated_forms_agree_with_uneven_functions_too() -> None:
    dmp = RhythmicDmp.fit(steps_and_pauses(LONG), 6.0)
    integrator = DmpIntegrator(dmp)
    for _ in range(300):
        integrator.step(0.02)
        assert integrator.position[0] == pytest.approx(float(dmp.position(integrator.phase)[0]), abs=1e-8)


def test_a_dimension_that_does_not_move_is_kept() -> None:
    dmp = RhythmicDmp.fit(np.full((LONG, 1), 0.3), 6.0)
    np.testing.assert_allclose(dmp.position(np.linspace(0, 6, 20)), 0.3, atol=1e-14)
