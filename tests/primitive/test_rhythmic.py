"""The rhythmic DMP: what it fits, and that its closed and integrated forms are one system."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fastmimic.base.errors import ConfigError, MotionError
from fastmimic.primitive import RhythmicDmp
from fastmimic.primitive.rhythmic import ALPHA
from primitive.integrator import DmpIntegrator, forcing, shape_rate, velocity

PERIOD = 0.55
N = 275  # samples of a trot at 500 Hz
# The quadrature of the forcing is good to 1e-8 of its size; positions here are of the order of 1.
AGREE = 1e-6


def phases(n: int = N) -> np.ndarray:
    return 2 * np.pi * np.arange(n) / n


def cycle(n: int = N) -> np.ndarray:
    """Three dimensions: a lifted foot with corners, smooth harmonics, almost constant."""
    p = phases(n)
    return np.column_stack(
        [
            0.06 * np.maximum(0.0, np.sin(p)),
            np.cos(p) + 0.3 * np.sin(5 * p),
            3.0 + 0.01 * np.sin(2 * p),
        ]
    )


@pytest.fixture(scope="module")
def dmp() -> RhythmicDmp:
    return RhythmicDmp.fit(cycle(), PERIOD)


def test_smooth_cycles_are_fitted_exactly_and_corners_to_a_tenth_of_a_millimetre(dmp: RhythmicDmp) -> None:
    error = np.sqrt(np.mean((dmp.position(phases()) - cycle()) ** 2, axis=0))
    assert error[0] < 1e-4
    assert np.all(error[1:] < 1e-6)


def test_a_hundred_basis_functions_are_the_default(dmp: RhythmicDmp) -> None:
    assert dmp.n_basis == 100
    assert dmp.weights.shape == (3, 100)


def test_goal_is_the_mean_and_the_shape_has_none(dmp: RhythmicDmp) -> None:
    np.testing.assert_allclose(dmp.goal, cycle().mean(axis=0), atol=1e-15)
    np.testing.assert_allclose(dmp.shape(phases(1000)).mean(axis=0), 0, atol=1e-14)


def test_the_closed_form_solves_the_differential_equation(dmp: RhythmicDmp) -> None:
    """y″ + αy′ + αβ(y − g) = a f over the phase, with derivatives taken numerically."""
    p, step = np.linspace(0, 2 * np.pi, 50), 1e-4
    second = (shape_rate(dmp, p + step) - shape_rate(dmp, p - step)) / (2 * step)
    left = second + ALPHA * shape_rate(dmp, p) + ALPHA**2 / 4 * dmp.shape(p)
    scale = np.abs(forcing(dmp, p)).max(axis=0)
    np.testing.assert_allclose(left / scale, forcing(dmp, p) / scale, atol=1e-5)


def test_the_rate_is_the_derivative_of_the_shape(dmp: RhythmicDmp) -> None:
    p, step = np.linspace(0, 2 * np.pi, 50), 1e-5
    numeric = (dmp.shape(p + step) - dmp.shape(p - step)) / (2 * step)
    np.testing.assert_allclose(shape_rate(dmp, p), numeric, atol=1e-7)
    np.testing.assert_allclose(velocity(dmp, p), shape_rate(dmp, p) * 2 * np.pi / PERIOD, atol=1e-12)


@pytest.mark.parametrize("dt", [0.002, 0.0137, 0.1])
def test_the_integrated_form_stays_on_the_closed_form(dmp: RhythmicDmp, dt: float) -> None:
    integrator = DmpIntegrator(dmp, phase=0.4)
    phase, positions, velocities = np.zeros(int(2 * PERIOD / dt) + 1), [], []
    for i in range(len(phase)):
        integrator.step(dt)
        phase[i] = integrator.phase
        positions.append(integrator.position.copy())
        velocities.append(integrator.velocity.copy())
    np.testing.assert_allclose(positions, dmp.position(phase), atol=AGREE)
    np.testing.assert_allclose(velocities, velocity(dmp, phase), atol=100 * AGREE)


@settings(max_examples=20, deadline=None)
@given(
    goal=st.floats(-2, 2),
    amplitude=st.floats(-2, 3),
    period=st.floats(0.2, 6.0),
)
def test_from_rest_the_integrated_form_converges_to_g_plus_a_s(goal: float, amplitude: float, period: float) -> None:
    dmp = RhythmicDmp.fit(cycle(60), PERIOD, n_basis=20)
    integrator = DmpIntegrator(dmp, position=np.zeros(3))
    integrator.goal = dmp.goal + goal
    integrator.amplitude = np.full(3, amplitude)
    integrator.period_s = period
    for _ in range(100):  # one cycle: transients have died to e^(-α/2 · 2π)
        integrator.step(period / 100)
    expected = dmp.position(integrator.phase, dmp.goal + goal, amplitude)
    np.testing.assert_allclose(integrator.position, expected, atol=1e-5)
    np.testing.assert_allclose(
        integrator.velocity * period, velocity(dmp, integrator.phase, amplitude, period) * period, atol=1e-3
    )


def test_a_new_goal_and_amplitude_are_reached_smoothly(dmp: RhythmicDmp) -> None:
    """Position and velocity do not jump when g and a do: the filter bounds the acceleration."""
    integrator, dt = DmpIntegrator(dmp), 1e-4
    before, speed = integrator.position.copy(), integrator.velocity.copy()
    integrator.goal = dmp.goal + 0.1
    integrator.amplitude = np.full(3, 1.5)
    integrator.step(dt)
    rate = 2 * np.pi / PERIOD
    forces = ALPHA**2 / 4 * 0.1 + np.abs(forcing(dmp, phases())).max(axis=0) * 2
    np.testing.assert_array_less(np.abs(integrator.position - before - speed * dt), forces * (rate * dt) ** 2)
    np.testing.assert_array_less(np.abs(integrator.velocity - speed), 3 * forces * rate * (rate * dt))


def test_each_dimension_is_fitted_as_if_alone(dmp: RhythmicDmp) -> None:
    for dim in range(3):
        alone = RhythmicDmp.fit(cycle()[:, [dim]], PERIOD)
        scale = np.abs(dmp.weights[dim]).max()
        np.testing.assert_allclose(alone.weights[0] / scale, dmp.weights[dim] / scale, atol=1e-6)


def test_fewer_samples_than_basis_functions_are_still_passed_through() -> None:
    dmp = RhythmicDmp.fit(cycle(40), PERIOD)
    np.testing.assert_allclose(dmp.position(phases(40)), cycle(40), atol=1e-4)
    between = dmp.position(phases(400))
    assert np.abs(between[:, 0] - cycle(400)[:, 0]).max() < 5e-3, "no ringing between the samples"


@pytest.mark.parametrize(
    ("samples", "message"),
    [
        (np.zeros((3, 2)), r"at least 4 samples, found shape \(3, 2\)"),
        (np.zeros(10), r"found shape \(10,\)"),
        (np.where(np.arange(10)[:, None] == 7, np.nan, 0.0), r"sample 7 of the cycle is not finite"),
    ],
)
def test_what_cannot_be_fitted_is_refused(samples: np.ndarray, message: str) -> None:
    with pytest.raises(MotionError, match=message):
        RhythmicDmp.fit(samples, PERIOD)


@pytest.mark.parametrize("setting", ["period_s", "n_basis"])
def test_settings_must_be_positive(setting: str) -> None:
    with pytest.raises(ConfigError, match=f"{setting} must be positive, found 0"):
        RhythmicDmp.fit(cycle(), **{"period_s": PERIOD, setting: 0})  # type: ignore[arg-type]
