"""Basis functions of a cycle: evenly spaced, and of a long loop as many as its swings need."""

import numpy as np
import pytest

from fastmimic.primitive import RhythmicDmp
from fastmimic.primitive.rhythmic import basis
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


@pytest.mark.parametrize("n", [1, 10, 300])
def test_functions_sum_to_one_and_are_greatest_at_their_centres(n: int) -> None:
    found = basis(np.linspace(0, 2 * np.pi, 777), n)
    assert found.shape == (777, n)
    np.testing.assert_allclose(found.sum(axis=-1), 1.0, atol=1e-12)
    centres = 2 * np.pi * np.arange(n) / n
    assert list(np.argmax(basis(centres, n), axis=-1)) == list(range(n))


def test_the_swings_of_a_long_loop_are_fitted_below_a_tenth_of_a_millimetre() -> None:
    y = steps_and_pauses(LONG)
    dmp = RhythmicDmp.fit(y, 6.0)
    error = dmp.position(2 * np.pi * np.arange(LONG) / LONG) - y
    assert dmp.n_basis == 300
    assert np.sqrt(np.mean(error**2)) < 1e-4
    assert dmp.shape(2 * np.pi * np.arange(LONG) / LONG).mean() == pytest.approx(0, abs=1e-12)


def test_closed_and_integrated_forms_agree_in_a_long_loop_too() -> None:
    dmp = RhythmicDmp.fit(steps_and_pauses(LONG), 6.0)
    integrator = DmpIntegrator(dmp)
    for _ in range(300):
        integrator.step(0.02)
        assert integrator.position[0] == pytest.approx(float(dmp.position(integrator.phase)[0]), abs=1e-8)


def test_a_dimension_that_does_not_move_is_kept() -> None:
    dmp = RhythmicDmp.fit(np.full((LONG, 1), 0.3), 6.0)
    np.testing.assert_allclose(dmp.position(np.linspace(0, 6, 20)), 0.3, atol=1e-14)
