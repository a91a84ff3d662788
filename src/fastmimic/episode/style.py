"""Distance of two foot motions in style, so that another motion cannot earn a reward."""

import numpy as np

from fastmimic.base.arrays import Array

_LEAST_AMPLITUDE = 1e-4  # m; a foot that moves less has no path of its own


def style_distance(foot_pos_b: Array, reference_b: Array, cycle_b: Array | None = None) -> float:
    """Distance between two courses of the feet, in units of the reference's own amplitude.

    For each leg, with RMS over time,

        d² = (RMS Δz / A_z)² + (RMS Δ(x, y) / A_xy)²,

    where A is the RMS of the reference path about its mean; the result is the legs' mean. Height and ground plane each
    have their own amplitude, because a swing is an order of magnitude longer than high: a foot that is no longer lifted
    would hardly count otherwise. So 0 is the same motion, feet of constant height have 1, feet that do not move √2, and
    another amplitude a of the height alone |1 − a|. Nothing is aligned: another phase, another height, or exchanged
    legs are another motion. A_xy is at least A_z, so that stepping on the spot is not measured by its noise. Legs that
    do not move in the reference are left out.

    Args:
        foot_pos_b: (t, 4, 3) feet in the body frame, m. Samples with a NaN are left out.
        reference_b: (t, 4, 3) compared with, at the same times.
        cycle_b: (k, 4, 3) the reference's cycle, which gives the amplitudes; `reference_b` itself if None.

    Returns:
        The distance, dimensionless; NaN if nothing can be compared.
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
