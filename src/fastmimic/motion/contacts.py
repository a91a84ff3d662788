"""Foot contacts: stances and swings, and their detection in an animal's motion."""

from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from fastmimic.base.arrays import Array, Flags, stretches
from fastmimic.base.configuration import tabulated


class Stance(NamedTuple):
    """One contact of one foot: the first sample on the ground, in [0, n) of a cycle of n samples, and the first sample
    off the ground again, which exceeds n where the contact straddles the seam."""

    touch_down: int
    lift_off: int

    @property
    def duration(self) -> int:
        return self.lift_off - self.touch_down


Stances = list[list[Stance]]  # of each leg, in order of time


@tabulated
@dataclass(frozen=True)
class ContactConfig:
    """How contacts are detected; activity is that of `foot_activity`."""

    enter: float = 0.25
    leave: float = 0.30
    height_weight: float = 0.5
    window_s: float = 0.75
    least_height_m: float = 0.03
    least_speed_m_per_s: float = 0.6
    rest_s: float = 0.5
    rest_speed_m_per_s: float = 0.1
    shortest_s: float = 0.06


def foot_activity(toe_height: Array, toe_speed: Array, rate_hz: float, periodic: bool, config: ContactConfig) -> Array:
    """Activity of each foot, (t, 4): 0 at rest on the ground, about 1 in mid-swing.

    It is the larger of height above the leg's own ground (`toe_height`, (t, 4), m) and horizontal world speed
    (`toe_speed`, (t, 4), m/s), each relative to its largest value nearby in time. Relative measures suit any animal and
    gait, and find slow steps beside fast ones. A foot that rests stands, though its toe may be higher than in a step.
    """
    from scipy.ndimage import maximum_filter1d

    window = 2 * round(config.window_s * rate_hz) + 1
    mode = "wrap" if periodic else "nearest"

    def relative(values: Array, least: float) -> Array:
        return values / np.maximum(maximum_filter1d(values, window, axis=0, mode=mode), least)

    rests = _resting(toe_height, toe_speed, rate_hz, periodic, config)
    height = relative(np.where(rests, 0.0, np.maximum(toe_height, 0.0)), config.least_height_m)
    return np.maximum(config.height_weight * height, relative(toe_speed, config.least_speed_m_per_s))


def _resting(toe_height: Array, toe_speed: Array, rate_hz: float, periodic: bool, config: ContactConfig) -> Flags:
    """Whether a foot (t, 4) does not move for a while, near the ground."""
    from scipy.ndimage import binary_opening

    n, laps = len(toe_height), 3 if periodic else 1
    height, speed = np.tile(toe_height, (laps, 1)), np.tile(toe_speed, (laps, 1))
    rises = np.abs(np.diff(height, axis=0, prepend=height[:1])) * rate_hz
    still = (np.maximum(speed, rises) < config.rest_speed_m_per_s) & (height < 2.0 * config.least_height_m)
    rests = binary_opening(still, np.ones((max(1, round(config.rest_s * rate_hz)), 1)))
    return np.asarray(rests[n * (laps // 2) :][:n])


def detect(activity: Array, rate_hz: float, periodic: bool, config: ContactConfig) -> Stances:
    """Stances of each leg from its activity (t, legs), by hysteresis and a minimum duration."""
    shortest = round(config.shortest_s * rate_hz)
    legs = []
    for series in activity.T:
        on = _hysteresis(series, config, periodic)
        on = _without_short(on, False, shortest, periodic)
        legs.append(stances_of(_without_short(on, True, shortest, periodic), periodic))
    return legs


def stances_of(on: Flags, periodic: bool) -> list[Stance]:
    """The stances in a boolean series (t,)."""
    found = [Stance(a, b) for a, b in stretches(on)]
    if periodic and len(found) > 1 and on[0] and on[-1]:
        first, *between, last = found
        found = [*between, Stance(last.touch_down, first.lift_off + len(on))]
    return found


def contact_mask(stances: Stances, n: int) -> Flags:
    """Contact (n, legs), True in stance."""
    on = np.zeros((n, len(stances)), dtype=bool)
    for leg, spans in enumerate(stances):
        for span in spans:
            on[np.arange(*span) % n, leg] = True
    return on


def duty_factors(stances: Stances, n: int) -> Array:
    """Share of the time that each leg stands, (legs,)."""
    return np.array([sum(span.duration for span in leg) / n for leg in stances])


def swings_of(spans: list[Stance], n: int, periodic: bool) -> list[tuple[int, int]]:
    """Non-empty swings (lift-off, next touch-down) of one leg; the ends cut them off if the motion is not periodic."""
    if not spans:
        return [(0, n)]
    swings = [(a.lift_off, b.touch_down) for a, b in pairwise(spans)]
    if periodic:
        swings.append((spans[-1].lift_off, spans[0].touch_down + n))
    else:
        swings = [(0, spans[0].touch_down), *swings, (spans[-1].lift_off, n)]
    return [swing for swing in swings if swing[1] > swing[0]]


def swung(contact: Flags, periodic: bool) -> Array:
    """Share of each leg's swing that is over, of a motion with contact (n, legs): in [0, 1), and 0 in stance."""
    share = np.zeros(contact.shape)
    for leg, down in enumerate(contact.T):
        for first, last in stances_of(~down, periodic):
            share[np.arange(first, last) % len(down), leg] = np.arange(last - first) / (last - first)
    return share


def swing_tops(contact: Flags, height: Array, periodic: bool) -> list[tuple[int, float]]:
    """Touch-down sample and greatest height, m, of each swing of one foot with contact (n,) and height (n,). Without
    `periodic`, swings that the ends cut off do not count."""
    first = int(contact.argmax()) if periodic else 0  # starts in a stance, so that no swing is cut in two
    swings = stances_of(np.roll(~contact, -first), periodic=False)
    rolled = np.roll(height, -first)
    if not contact.any():
        return []
    return [(b + first, float(rolled[a:b].max())) for a, b in swings if periodic or (a > 0 and b < len(contact))]


def _hysteresis(series: Array, config: ContactConfig, periodic: bool) -> Flags:
    on = np.empty(len(series), dtype=bool)
    state = bool(series[0] < config.enter)
    for _ in range(2 if periodic else 1):  # the second pass starts from the state at the seam
        for i, value in enumerate(series):
            state = bool(value < (config.leave if state else config.enter))
            on[i] = state
    return on


def _without_short(on: Flags, value: bool, shortest: int, periodic: bool) -> Flags:
    """Inverts runs of `value` shorter than `shortest` that the recording's ends do not cut off."""
    result = on.copy()
    for start, end in stances_of(on == value, periodic):
        cut_off = not periodic and (start == 0 or end == len(on))
        if end - start < min(shortest, len(on)) and not cut_off:
            result[np.arange(start, end) % len(on)] = not value
    return result
