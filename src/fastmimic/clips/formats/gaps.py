"""Gaps and outliers in the paths of tracked points. Short ones are filled from their neighbours, long ones split the
take into whole parts. All frames are those of the file, 0-based, end exclusive."""

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np

from fastmimic.base.arrays import Array, Flags, Indices, stretches
from fastmimic.base.errors import ClipError
from fastmimic.clips.clip import KEYPOINTS, POINT_NAMES, not_in_clip

LONGEST_S: Final = 0.2  # of a gap that is filled
LEAST_CONFIDENCE: Final = 0.6  # below, DeepLabCut does not draw a point either (`pcutoff`)
SHORTEST_PART_S: Final = 0.6  # room for two of the shortest cycles that `fastmimic.clips.segment` finds

_AROUND_S: Final = 0.04  # on both sides of a frame, for a point's usual place there
_JUMP: Final = 0.2  # largest distance from it, as a share of a leg's length; 0.14 in a dog that turns, at 30 Hz
_STRETCH: Final = 0.3  # largest excess over a limb's length in the take, likewise; 0.11 in that dog
_STRAIGHT: Final = 90  # percentile of a limb's length in the take; a sitting dog's median is a folded leg

Part = tuple[int, int]


class Filled(NamedTuple):
    """Points (t, 10, 3), NaN where a long gap is; the whole parts, at least one; and sentences on what was done."""

    points: Array
    parts: list[Part]
    notes: list[str]


def fill_gaps(points: Array, rate_hz: float, confidence: Array | None = None) -> Filled:
    """Fills the short gaps of the ten points (t, 10, 3), in any unit; a gap is NaN, `confidence` (t, 10) below 0.6, or
    a point of `outliers`. Raises `ClipError`: no part is whole."""
    missing = ~np.isfinite(points).all(axis=2)
    doubtful = np.zeros_like(missing) if confidence is None else ~missing & ~(confidence >= LEAST_CONFIDENCE)
    for name, column in zip(POINT_NAMES, (missing | doubtful).T, strict=True):
        if (~column).sum() < 2:
            raise ClipError(f"the point for {name} is missing in all frames; name another one (--point-map)")
    points = np.where((missing | doubtful)[..., None], np.nan, points)
    astray = outliers(points, rate_hz)
    absent = missing | doubtful | astray
    filled = _short(absent, rate_hz)
    for k in np.flatnonzero(absent.any(axis=0)):
        points[:, k] = _filled(points[:, k], absent[:, k], filled[:, k])
    whole = np.asarray(np.all(filled | ~absent, axis=1))
    parts = [(a, b) for a, b in stretches(whole) if b - a >= min(SHORTEST_PART_S * rate_hz, 0.5 * len(whole))]
    if not parts:
        gaps = _counts(absent & ~filled)
        raise ClipError(f"no {SHORTEST_PART_S:g} s without a gap of more than {LONGEST_S:g} s: {gaps}")
    causes = {"missing": missing, f"with a confidence below {LEAST_CONFIDENCE:g}": doubtful, "astray": astray}
    said = ", ".join(f"{n} {cause}" for cause, which in causes.items() if (n := int((which & filled).sum())))
    notes = [f"gaps of up to {LONGEST_S:g} s are filled: {_counts(filled)} ({said})"] if filled.any() else []
    return Filled(points, parts, notes)


def part_for(parts: Sequence[Part], frames: Part | None, n_frames: int) -> tuple[Part, list[str]]:
    """The part with `frames` (first, end), or the longest part and a sentence on what is left out. Raises `ClipError`:
    frames that are not in the take, or hold a long gap."""
    listed = ", ".join(f"{first}:{end}" for first, end in parts)
    if frames is not None:
        first, end = frames
        if not 0 <= first < end <= n_frames:
            raise not_in_clip(frames, n_frames)
        part = next((part for part in parts if part[0] <= first and end <= part[1]), None)
        if part is None:
            raise ClipError(f"frames {first}:{end} hold a gap of more than {LONGEST_S:g} s; whole parts are {listed}")
        return part, []
    first, end = max(parts, key=lambda part: part[1] - part[0])
    if (first, end) == (0, n_frames):
        return (first, end), []
    left_out = " and ".join(f"{a}:{b}" for a, b in ((0, first), (end, n_frames)) if b > a)
    said = f"this is the longest part without long gaps, frames {first}:{end}; {left_out} are left out"
    return (first, end), [f"{said} (all parts: {listed})"]


def outliers(points: Array, rate_hz: float) -> Flags:
    """Which of the ten points (t, 10, 3) are where they cannot be, (t, 10): far from the median of their path around
    that frame, or where a limb is longer than nearly always; that is the fault of its end with most wrong limbs."""
    from scipy.ndimage import median_filter

    ends = np.array(KEYPOINTS.bones)
    lengths = np.linalg.norm(points[:, ends[:, 0]] - points[:, ends[:, 1]], axis=2)
    if np.isnan(lengths).all(axis=0).any():
        return np.zeros(points.shape[:2], dtype=bool)
    typical = np.nanpercentile(lengths, _STRAIGHT, axis=0)
    leg = float(np.median(typical[-4:]))
    paths = bridged(points)
    usual = median_filter(paths, (2 * max(2, round(_AROUND_S * rate_hz)) + 1, 1, 1), mode="nearest")
    found = np.linalg.norm(paths - usual, axis=2) > _JUMP * leg
    whole = np.linalg.norm(np.diff(np.where(found[..., None], usual, paths)[:, ends], axis=2)[:, :, 0], axis=2)
    wrong = whole - typical > _STRETCH * leg
    for frame in np.flatnonzero(wrong.any(axis=1)):
        found[frame] |= _at_fault(wrong[frame], ends)
    return np.asarray(found & np.isfinite(points).all(axis=2))


def bridged(points: Array) -> Array:
    """Points (t, k, 3) with straight lines where they are missing, and at their mean if they are never there."""
    t, mean = np.arange(len(points)), np.nanmean(points, axis=(0, 1))
    columns = np.array(points.reshape(len(points), -1))
    for k, column in enumerate(columns.T):
        there = np.isfinite(column)
        columns[:, k] = np.interp(t, t[there], column[there]) if there.any() else mean[k % 3]
    return columns.reshape(points.shape)


def _at_fault(wrong: Flags, ends: Indices) -> Flags:
    """The points (10,) that explain the wrong limbs (k,), those with the largest share of wrong limbs first."""
    found = np.zeros(len(POINT_NAMES), dtype=bool)
    limbs = np.bincount(ends.ravel(), minlength=len(found))
    while wrong.any():
        count = np.bincount(ends[wrong].ravel(), minlength=len(found))
        worst = int(np.argmax(count / limbs + 1e-3 * count))
        found[worst] = True
        wrong = wrong & (ends != worst).all(axis=1)
    return found


def _short(absent: Flags, rate_hz: float) -> Flags:
    """Which of the gaps (t, 10) are short and lie between two frames with the point."""
    short = np.zeros_like(absent)
    for k, column in enumerate(absent.T):
        for first, end in stretches(column):
            short[first:end, k] = first > 0 and end < len(column) and end - first <= LONGEST_S * rate_hz + 0.5
    return short


def _filled(path: Array, absent: Flags, filled: Flags) -> Array:
    """A path (t, 3) with a curve through its neighbours where `filled`, and NaN elsewhere where `absent`."""
    from scipy.interpolate import PchipInterpolator

    path = np.where(absent[:, None], np.nan, path)
    known = np.flatnonzero(~absent)
    if filled.any():  # a curve takes two frames; a short gap has one on each side
        path[filled] = PchipInterpolator(known, path[known])(np.flatnonzero(filled))
    return path


def _counts(which: Flags) -> str:
    """`FR_toe 8 frames, neck 4`."""
    counts = {name: int(n) for name, n in zip(POINT_NAMES, which.sum(axis=0), strict=True) if n}
    words = [f"{name} {n}" for name, n in sorted(counts.items(), key=lambda item: -item[1])]
    return ", ".join([f"{words[0]} frames", *words[1:]]) if words else ""
