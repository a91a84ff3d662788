"""The discrete DMP: what it fits, how it begins and ends, and that its closed form is the differential equation."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.special import softmax

from fastmimic.base.errors import ConfigError, MotionError
from fastmimic.primitive import DiscreteDmp, RhythmicDmp
from fastmimic.primitive.discrete import DECAY
from fastmimic.primitive.rhythmic import ALPHA

SHORT, LONG = 0.75, 4.0
RATE_HZ = 500


def piece(duration_s: float) -> np.ndarray:
    """Three dimensions from one place to another: two lifted steps with corners, a turn that starts at speed, a trunk
    that sinks."""
    t = np.arange(round(duration_s * RATE_HZ) + 1) / RATE_HZ
    s = t / duration_s
    lift = 0.06 * np.maximum(0.0, np.sin(2 * np.pi * t / 0.5)) - 0.27
    return np.column_stack([lift, 0.3 + 1.7 * s + 0.2 * np.sin(5 * t), 0.3 - 0.12 * s**3 * (10 - 15 * s + 6 * s**2)])


@pytest.fixture(scope="module", params=[SHORT, LONG], ids=["short", "long"])
def fitted(request: pytest.FixtureRequest) -> tuple[DiscreteDmp, np.ndarray]:
    samples = piece(request.param)
    return DiscreteDmp.fit(samples, request.param), samples


Fitted = tuple[DiscreteDmp, np.ndarray]


def test_the_demonstration_is_reproduced(fitted: Fitted) -> None:
    """Corners to half a millimetre, the rest exactly."""
    dmp, samples = fitted
    error = np.sqrt(np.mean((dmp.position(len(samples)) - samples) ** 2, axis=0))
    assert error[0] < 5e-4
    assert np.all(error[1:] < 1e-6)


def test_a_rhythmic_primitive_of_the_same_piece_jumps_at_its_ends(fitted: Fitted) -> None:
    dmp, samples = fitted
    rhythmic = RhythmicDmp.fit(samples, len(samples) / RATE_HZ)
    error = np.abs(rhythmic.position(2 * np.pi * np.arange(len(samples)) / len(samples)) - samples).max(axis=0)
    assert error[1] > 0.2, "it would have to be at both ends at once"
    assert np.abs(dmp.position(len(samples)) - samples).max(axis=0)[1] < 1e-5


def test_it_begins_as_the_demonstration_whatever_is_modulated(fitted: Fitted) -> None:
    dmp, samples = fitted
    y = dmp.position(len(samples), dmp.goal + 0.1, np.full(3, 1.5))
    np.testing.assert_array_equal(y[0], samples[0])
    speed = np.gradient(y, 1 / RATE_HZ, axis=0, edge_order=2)[0]
    np.testing.assert_allclose(speed, dmp.start_rate / dmp.duration_s, atol=0.15)


def test_the_goal_is_where_it_ends(fitted: Fitted) -> None:
    dmp, samples = fitted
    moved = np.array([0.02, -0.3, 0.1])
    change = dmp.position(len(samples), dmp.goal + moved) - dmp.position(len(samples))
    np.testing.assert_allclose(change[-1], moved, rtol=2e-3)
    assert np.all(np.diff(change / moved, axis=0) > -1e-12), "a critically damped spring does not overshoot"
    within = round(0.5 * RATE_HZ)
    np.testing.assert_allclose(change[within:], np.broadcast_to(moved, change[within:].shape), rtol=0.05)


def test_the_amplitude_scales_the_forcing(fitted: Fitted) -> None:
    dmp, samples = fitted
    none, one, two = (dmp.position(len(samples), amplitude=np.full(3, a)) for a in (0.0, 1.0, 2.0))
    np.testing.assert_allclose(two - one, one - none, atol=1e-10)
    np.testing.assert_allclose(two[-1], samples[-1], atol=1e-3, err_msg="the end is the goal's, not the amplitude's")
    at_rest = DiscreteDmp.fit(samples, dmp.duration_s)
    np.testing.assert_array_equal(at_rest.weights, dmp.weights)


def test_steps_that_end_where_they_began_are_scaled_about_the_ground() -> None:
    """What is scaled by g − y₀ would have no size here."""
    t = np.arange(501) / RATE_HZ
    z = (0.05 * np.sin(np.pi * np.clip((t - 0.2) / 0.3, 0, 1)) ** 2 - 0.28)[:, None]
    higher = DiscreteDmp.fit(z, 1.0).position(501, amplitude=np.array([1.4]))
    np.testing.assert_allclose(higher.max() + 0.28, 1.4 * 0.05, atol=1e-4)
    np.testing.assert_allclose(higher[[0, 50, 400, 500]], -0.28, atol=1e-4)


@pytest.mark.slow
def test_the_closed_form_solves_the_differential_equation_and_rests_at_the_goal(fitted: Fitted) -> None:
    """τ ż = α(β(g − y) − z) + a f(x), τ ẏ = z, T ẋ = −αₓ x, integrated by another hand, to twice the duration."""
    dmp, samples = fitted
    goal, amplitude, tau = dmp.goal + np.array([0.01, 0.2, -0.05]), np.array([1.3, 0.8, 1.1]), dmp.tau_s

    def rate(t: float, state: np.ndarray) -> np.ndarray:
        y, z = state[:3], state[3:]
        x = np.exp(-DECAY * t / dmp.duration_s)
        basis = softmax(-dmp.widths * (x - dmp.centres) ** 2)
        forcing = x * (dmp.weights @ basis)
        spring = ALPHA * (ALPHA / 4 * (goal - y) - z)
        return np.concatenate([z, spring + amplitude * forcing]) / tau

    first = np.concatenate([dmp.start, dmp.start_rate * tau / dmp.duration_s])
    times = np.linspace(0, dmp.duration_s, len(samples))
    end = 2 * dmp.duration_s
    found = solve_ivp(rate, (0, end), first, t_eval=[*times, end], rtol=1e-6, max_step=1 / RATE_HZ)
    np.testing.assert_allclose(found.y[:3, :-1].T, dmp.position(len(samples), goal, amplitude), atol=2e-4)
    np.testing.assert_allclose(found.y[:3, -1], goal, atol=2e-3)


def test_a_long_piece_gets_a_function_each_25_ms() -> None:
    assert DiscreteDmp.fit(piece(SHORT), SHORT).n_basis == 100
    assert DiscreteDmp.fit(piece(LONG), LONG).n_basis == 160


@pytest.mark.parametrize("name", ["duration_s", "n_basis"])
def test_settings_that_are_not_positive_are_refused(name: str) -> None:
    given = {"duration_s": SHORT} | {name: 0}
    with pytest.raises(ConfigError, match=f"{name} must be positive, found 0"):
        DiscreteDmp.fit(piece(SHORT), **given)


def test_what_cannot_be_fitted_is_refused() -> None:
    with pytest.raises(MotionError, match=r"at least 4 samples, found shape \(3, 3\)"):
        DiscreteDmp.fit(piece(SHORT)[:3], SHORT)
    broken = piece(SHORT)
    broken[7, 1] = np.nan
    with pytest.raises(MotionError, match="sample 7 of the motion is not finite"):
        DiscreteDmp.fit(broken, SHORT)
    with pytest.raises(MotionError, match=r"lasts 600 s at most, found 601\.0 s; choose a part \(--frames\)"):
        DiscreteDmp.fit(piece(SHORT), 601.0)
