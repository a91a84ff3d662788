"""The figures of a rollout: one record for files, tables and reports; clearance and style of foot motions."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from fastmimic.base.arrays import Array
from fastmimic.base.text import plain
from fastmimic.episode.reward import REWARD_TERMS
from fastmimic.episode.rollout import Rollout
from fastmimic.episode.tracking_errors import TRACKING_ERRORS
from fastmimic.motion.contacts import swing_tops
from fastmimic.motion.motion import Motion

TRACKED: Final = tuple(TRACKING_ERRORS.names or ())
"""The field's measures of motion tracking, by their names in `Metrics`."""

_LEAST_AMPLITUDE: Final = 1e-4  # m; a foot that moves less has no path of its own


@dataclass(frozen=True, kw_only=True)
class Metrics:
    """Figures over the episodes of a rollout; NaN where there is no value (no swing). From `success` on, the field's
    measures of motion tracking (`TRACKING_ERRORS`), means over the episodes."""

    episodes: int
    duration_s: float
    reward_mean: float  # over the episodes; steps after a fall count 0
    reward_std: float
    reward_worst: float
    components: dict[str, float]  # mean of each term of the reward, by name
    fell: float  # share of the episodes that ended in a fall, in [0, 1]
    drift_m_per_s: float  # speed that the synchronisation of the reference hides
    swing_clearance_m: tuple[float, ...]  # (4,) mean greatest height of each foot in its swings
    early_contacts_per_s: float
    stance_slip_m: float  # mean path that a loaded foot slides in a stance
    foot_x_rmse_m: float  # against the demonstration, body frame
    foot_z_rmse_m: float
    qp_failures: int  # steps in which the stance QP failed, in all episodes
    success: float  # share of the episodes, in [0, 1]
    mpjpe_mm: float
    mpbpe_root_mm: float
    root_position_error_m: float
    root_heading_error_rad: float
    joint_velocity_error_rad_s: float
    acceleration_distance: float
    reward_animal: float | None = None  # mean against the animal's motion, for a motion that was made executable
    # errors of the state estimate by name, root mean squares over the episodes (of the drift the mean over those that
    # travelled); None if the controller was told the true state
    estimate: dict[str, float] | None = None

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
            **{name: mean_of_known(r.tracking[name].astype(float)) for name in TRACKED},
            reward_animal=None if np.isnan(r.reward_animal).any() else float(r.reward_animal.mean()),
            estimate=None
            if r.estimation is None
            else {
                "drift_percent": mean_of_known(r.estimation.position_drift),
                "velocity_rmse_m_per_s": rms(r.estimation.velocity_rmse),
                "height_rmse_m": rms(r.estimation.height_rmse),
                "tilt_rmse_rad": rms(r.estimation.tilt_rmse),
                "heading_error_rad": rms(r.estimation.heading_error),
                "foot_sensors_share": float(r.estimation.foot_sensors.mean()),
            },
        )

    @property
    def fell_once(self) -> bool:
        """Whether any episode ended in a fall."""
        return self.fell > 0.0

    @property
    def mean_clearance_m(self) -> float:
        """Mean of the feet's swing clearances; NaN without swings."""
        return mean_of_known(np.array(self.swing_clearance_m))

    def named(self, names: Iterable[str], of: str = "") -> dict[str, Any]:
        """Some figures by name, for a row; `of` is appended where it has several kinds of episodes."""
        return {f"{name}_{of}" if of else name: getattr(self, name) for name in names}

    def as_dict(self) -> dict[str, Any]:
        """Everything by name, for JSON: None for NaN, the estimation's figures with the prefix `estimate_`."""
        found = plain(self)
        estimate = found.pop("estimate")
        if found["reward_animal"] is None:
            del found["reward_animal"]
        return found | {f"estimate_{name}": value for name, value in (estimate or {}).items()}


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


def style_distance(foot_pos_b: Array, reference_b: Array, cycle_b: Array | None = None) -> float:
    """Distance between two courses of the feet, in units of the reference's own amplitude, so that another motion
    cannot earn a reward. For each leg, with RMS over time,

        d² = (RMS Δz / A_z)² + (RMS Δ(x, y) / A_xy)²,

    where A is the RMS of the reference path about its mean; the result, dimensionless, is the legs' mean. Height and
    ground plane each have their own amplitude, because a swing is an order of magnitude longer than high: a foot that
    is no longer lifted would hardly count otherwise. So 0 is the same motion, feet of constant height have 1, feet that
    do not move √2, and another amplitude a of the height alone |1 − a|. Nothing is aligned: another phase, another
    height, or exchanged legs are another motion. A_xy is at least A_z, so that stepping on the spot is not measured by
    its noise. Legs that do not move in the reference are left out.

    `foot_pos_b` and `reference_b` (t, 4, 3) are feet in the body frame at the same times, m; samples with a NaN are
    left out. The amplitudes are those of `cycle_b` (k, 4, 3), the reference's cycle, or of `reference_b` if None. NaN
    if nothing can be compared.
    """
    cycle = reference_b if cycle_b is None else cycle_b
    spread = cycle - cycle.mean(axis=0)
    vertical = np.sqrt(np.mean(spread[..., 2] ** 2, axis=0))
    horizontal = np.maximum(np.sqrt(np.mean(np.sum(spread[..., :2] ** 2, axis=-1), axis=0)), vertical)
    moves = vertical > _LEAST_AMPLITUDE
    known = np.isfinite(foot_pos_b).all(axis=(1, 2))
    if not known.any() or not moves.any():
        return float("nan")
    error = foot_pos_b[known] - reference_b[known]
    up = np.mean(error[..., 2] ** 2, axis=0)[moves] / vertical[moves] ** 2
    along = np.mean(np.sum(error[..., :2] ** 2, axis=-1), axis=0)[moves] / horizontal[moves] ** 2
    return float(np.mean(np.sqrt(up + along)))
