"""The figures of a rollout: one record for files, tables and reports."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from fastmimic.base.arrays import Array
from fastmimic.base.text import plain
from fastmimic.episode.reward import REWARD_TERMS
from fastmimic.episode.rollout import Rollout
from fastmimic.motion.contacts import swing_tops
from fastmimic.motion.motion import Motion


@dataclass(frozen=True, kw_only=True)
class EstimationMetrics:
    """Errors of the state estimate: root mean squares over the episodes.

    Attributes:
        drift_percent: mean over the episodes that travelled; NaN if none did.
    """

    drift_percent: float
    velocity_rmse_m_per_s: float
    height_rmse_m: float
    tilt_rmse_rad: float
    heading_error_rad: float


@dataclass(frozen=True, kw_only=True)
class Metrics:
    """Figures over the episodes of a rollout; NaN where there is no value (no swing).

    Attributes:
        duration_s: length of each episode.
        reward_mean, reward_std, reward_worst: over the episodes; steps after a fall count 0.
        components: mean of each term of the reward, by name.
        fell: share of the episodes that ended in a fall, in [0, 1].
        drift_m_per_s: speed that the synchronisation of the reference hides.
        swing_clearance_m: (4,) mean greatest height of each foot in its swings.
        early_contacts_per_s: early touch-downs.
        stance_slip_m: mean path that a loaded foot slides in a stance.
        foot_x_rmse_m, foot_z_rmse_m: against the demonstration, body frame.
        qp_failures: steps in which the stance QP failed, in all episodes.
        estimate: None if the controller was told the true state.
    """

    episodes: int
    duration_s: float
    reward_mean: float
    reward_std: float
    reward_worst: float
    components: dict[str, float]
    fell: float
    drift_m_per_s: float
    swing_clearance_m: tuple[float, ...]
    early_contacts_per_s: float
    stance_slip_m: float
    foot_x_rmse_m: float
    foot_z_rmse_m: float
    qp_failures: int
    estimate: EstimationMetrics | None = None

    @classmethod
    def of(cls, rollout: Rollout) -> "Metrics":
        """The figures of all episodes of a rollout."""
        r = rollout
        return cls(
            episodes=len(r.reward),
            duration_s=r.duration_s,
            reward_mean=float(r.reward.mean()),
            reward_std=float(r.reward.std()),
            reward_worst=float(r.reward.min()),
            components={name: float(r.terms[:, i].mean()) for i, name in enumerate(REWARD_TERMS)},
            fell=float(r.fell.mean()),
            drift_m_per_s=float(r.drift.mean()),
            swing_clearance_m=tuple(_mean_over_episodes(r.clearance).tolist()),
            early_contacts_per_s=float(r.early_contacts.mean()),
            stance_slip_m=float(r.slip.mean()),
            foot_x_rmse_m=rms(r.foot_rmse[..., 0]),
            foot_z_rmse_m=rms(r.foot_rmse[..., 2]),
            qp_failures=int(r.qp_failures.sum()),
            estimate=_estimation(r),
        )

    @property
    def fell_once(self) -> bool:
        """Whether any episode ended in a fall."""
        return self.fell > 0.0

    @property
    def mean_clearance_m(self) -> float:
        """Mean of the feet's swing clearances; NaN without swings."""
        return mean_of_known(np.array(self.swing_clearance_m))

    def as_dict(self) -> dict[str, Any]:
        """Everything by name, for JSON: None for NaN, the estimation's figures with the prefix `estimate_`."""
        found = plain(self)
        estimate = found.pop("estimate")
        return found | {f"estimate_{name}": value for name, value in (estimate or {}).items()}


def _estimation(rollout: Rollout) -> EstimationMetrics | None:
    errors = rollout.estimation
    if errors is None:
        return None
    return EstimationMetrics(
        drift_percent=mean_of_known(errors.position_drift),
        velocity_rmse_m_per_s=rms(errors.velocity_rmse),
        height_rmse_m=rms(errors.height_rmse),
        tilt_rmse_rad=rms(errors.tilt_rmse),
        heading_error_rad=rms(errors.heading_error),
    )


def rms(values: Array) -> float:
    """Root mean square of all values."""
    return float(np.sqrt(np.mean(np.square(values))))


def mean_of_known(values: Array) -> float:
    """Mean of the finite values; NaN if there are none."""
    known = values[np.isfinite(values)]
    return float(known.mean()) if len(known) else float("nan")


def _mean_over_episodes(values: Array) -> Array:
    """Mean of the finite values over the first axis; NaN where there are none."""
    present = np.isfinite(values)
    total = np.where(present, values, 0.0).sum(axis=0)
    return np.where(present.any(axis=0), total / np.maximum(present.sum(axis=0), 1), np.nan)


def swing_clearance(motion: Motion, foot_radius: float) -> Array:
    """(4,) each foot's greatest height above the ground, mean over a motion's complete swings, m; NaN without any."""
    height = motion.foot_pos_w[..., 2] - foot_radius
    out = np.full(4, np.nan)
    for leg in range(4):
        tops = [top for _, top in swing_tops(motion.contact[:, leg], height[:, leg], motion.cycle is not None)]
        if tops:
            out[leg] = np.mean(tops)
    return out
