import json

import numpy as np
import pytest

from fastmimic.episode.metrics import Metrics, mean_of_known, rms
from fastmimic.episode.rollout import Rollout
from fastmimic.episode.tracking_errors import TRACKING_ERRORS


def rollout(**changes: object) -> Rollout:
    """Two episodes, of which the second fell."""
    values: dict[str, object] = {
        "reward": np.array([0.8, 0.2]),
        "reward_animal": np.full(2, np.nan),
        "terms": np.array([[0.9, 0.8, 0.7, 0.6, 0.5], [0.1, 0.2, 0.3, 0.4, 0.5]]),
        "fell": np.array([False, True]),
        "steps": np.array([1000, 200]),
        "duration_s": 2.0,
        "drift": np.array([0.01, 0.03]),
        "clearance": np.array([[0.05, 0.06, np.nan, np.nan], [0.07, np.nan, np.nan, 0.04]]),
        "slip": np.full((2, 4), 0.002),
        "early_contacts": np.array([1.0, 3.0]),
        "foot_rmse": np.full((2, 4, 3), 0.01),
        "qp_failures": np.array([0, 2]),
        "tracking": np.array([(True, 2.0, *[0.1] * 5), (False, *[np.nan] * 6)], TRACKING_ERRORS),
    }
    return Rollout(**{**values, **changes})  # type: ignore[arg-type]


def test_figures_are_over_all_episodes() -> None:
    found = Metrics.of(rollout())
    assert found.episodes == 2
    assert found.reward_mean == pytest.approx(0.5)
    assert found.reward_std == pytest.approx(0.3)
    assert found.reward_worst == 0.2
    assert found.components["pose"] == pytest.approx(0.5)
    assert (found.fell, found.fell_once) == (0.5, True)
    assert found.swing_clearance_m[:2] == pytest.approx((0.06, 0.06))
    assert np.isnan(found.swing_clearance_m[2])
    assert found.mean_clearance_m == pytest.approx((0.06 + 0.06 + 0.04) / 3)
    assert found.foot_x_rmse_m == pytest.approx(0.01)
    assert found.qp_failures == 2
    assert (found.success, found.mpjpe_mm) == (0.5, 2.0)  # the second had no step


def test_the_dictionary_is_json_with_none_for_what_there_is_not() -> None:
    found = Metrics.of(rollout()).as_dict()
    assert json.loads(json.dumps(found, allow_nan=False)) == found
    assert found["swing_clearance_m"][2] is None
    assert not [name for name in found if name.startswith("estimate")]
    assert "reward_animal" not in found
    animal = Metrics.of(rollout(reward_animal=np.array([0.7, 0.1]))).as_dict()
    assert animal["reward_animal"] == pytest.approx(0.4)


def test_means_leave_out_what_is_not_known() -> None:
    assert mean_of_known(np.array([1.0, np.nan, 3.0])) == 2.0
    assert np.isnan(mean_of_known(np.array([np.nan])))
    assert rms(np.array([3.0, -4.0])) == pytest.approx(np.sqrt(12.5))


def test_rows_take_their_figures_by_name() -> None:
    second = rollout().episodes(slice(1, 2))
    assert second.reward.tolist() == [0.2]
    assert second.terms.shape == (1, 5)
    figures = Metrics.of(second)
    assert figures.named(("reward_mean", "fell"), "robots") == {"reward_mean_robots": 0.2, "fell_robots": 1.0}
    assert figures.named(("episodes",)) == {"episodes": 1}
