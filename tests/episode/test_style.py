"""The style distance sees every change of the feet's motion, in units of the motion's own size."""

import numpy as np
import pytest

from fastmimic.episode.metrics import style_distance

PHASE = np.linspace(0, 2 * np.pi, 200, endpoint=False)
LEGS = np.array([0.0, np.pi, np.pi, 0.0])


def feet(
    height: float | np.ndarray = 0.06, stride: float | np.ndarray = 0.3, lift: float = 0.0, shift: float = 0.0
) -> np.ndarray:
    """(200, 4, 3) feet that go back and forth and are lifted: swing long, but not high."""
    phase = PHASE[:, None] + LEGS + shift
    x = 0.5 * np.asarray(stride) * np.cos(phase)
    z = np.asarray(height) * np.maximum(np.sin(phase), 0.0) ** 2 + lift - 0.27
    return np.stack([x, 0.01 * np.sin(phase), z], axis=-1)


def flattened(path: np.ndarray) -> np.ndarray:
    """The feet at their mean height."""
    flat = path.copy()
    flat[..., 2] = path[..., 2].mean(axis=0)
    return flat


def test_the_same_motion_is_at_no_distance() -> None:
    assert style_distance(feet(), feet()) == 0.0


def test_feet_that_are_not_lifted_are_at_one_however_low_the_animal_lifts_them() -> None:
    for height in (0.02, 0.06, 0.12):
        assert style_distance(flattened(feet(height)), feet(height)) == pytest.approx(1.0)


def test_feet_that_stay_where_they_are_have_lost_both_directions() -> None:
    still = np.broadcast_to(feet().mean(axis=0), feet().shape)
    assert style_distance(still, feet()) == pytest.approx(np.sqrt(2), rel=1e-3)


@pytest.mark.parametrize("amplitude", [0.5, 0.7, 1.3])
def test_another_amplitude_about_the_mean_is_its_share(amplitude: float) -> None:
    path = feet()
    scaled = path.copy()
    scaled[..., 2] = path[..., 2].mean(axis=0) + amplitude * (path[..., 2] - path[..., 2].mean(axis=0))
    assert style_distance(scaled, path) == pytest.approx(abs(1 - amplitude))


def test_it_does_not_depend_on_the_size_of_the_animal() -> None:
    small, large = (style_distance(k * feet(0.03), k * feet()) for k in (0.5, 2.0))
    assert small == pytest.approx(large)


@pytest.mark.parametrize(
    "other",
    [feet(lift=0.01), feet(shift=0.3), feet(stride=0.2), feet()[:, [1, 0, 3, 2]]],
    ids=["height", "phase", "stride", "legs exchanged"],
)
def test_nothing_is_aligned_away(other: np.ndarray) -> None:
    assert style_distance(other, feet()) > 0.2


def test_the_mean_over_the_legs_counts_one_leg_for_a_quarter() -> None:
    path = feet()
    path[:, 2] = flattened(path)[:, 2]
    assert style_distance(path, feet()) == pytest.approx(0.25)


def test_a_leg_that_never_moves_does_not_count() -> None:
    wanted = feet()
    wanted[:, 3] = wanted[0, 3]
    other = wanted.copy()
    other[:, 3] += 0.01
    assert style_distance(other, wanted) == 0.0


def test_steps_on_the_spot_are_not_measured_by_their_noise() -> None:
    wanted = feet(stride=0.001)
    other = wanted + np.array([0.001, 0.0, 0.0])
    assert style_distance(other, wanted) < 0.1


def test_what_is_unknown_is_left_out() -> None:
    path = flattened(feet())
    path[::2] = np.nan
    assert style_distance(path, feet()) == pytest.approx(1.0)
    assert np.isnan(style_distance(np.full((200, 4, 3), np.nan), feet()))
    assert np.isnan(style_distance(feet(0.0), feet(0.0)))
