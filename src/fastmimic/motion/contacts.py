"""When each foot of an animal stands on the ground."""

from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Stance(NamedTuple):
    """One contact of one foot.

    Attributes:
        touch_down: first sample on the ground, in [0, n) of a cycle of n samples.
        lift_off: first sample off the ground again; exceeds n where the contact straddles a cycle's seam.
    """

    touch_down: int
    lift_off: int

    @property
    def duration(self) -> int:
        return self.lift_off - self.touch_down


Stances = list[list[Stance]]
"""The contacts of each leg in order of time."""


@dataclass(frozen=True)
class ContactConfig:
    """How contacts are detected.

    Attributes:
        enter: a foot lands when its activity (see `foot_activity`) falls below this.
        leave: it lifts off when its activity rises above this.
        height_weight: of height against speed in the activity. Below 1, because an animal rolls over its toes: the marker
            rises by a quarter of the swing's height while the foot still carries weight.
        shortest_s: stances and swings shorter than this are flicker.
    """

    enter: float = 0.25
    leave: float = 0.30
    height_weight: float = 0.5
    shortest_s: float = 0.08


def foot_activity(toe_height: Array, toe_speed: Array, config: ContactConfig) -> Array:
    """How much each foot is in motion, (t, 4): 0 at rest on the ground, about 1 in mid-swing.

    The larger of height above the leg's own lowest tenth and horizontal speed in the world, each relative to its own largest
    value. Relative measures do not depend on the animal's size or gait, and a marker that sits
    higher on one leg than on another does not shorten that leg's contact.

    Args:
        toe_height: (t, 4) m.
        toe_speed: (t, 4) horizontal, world, m/s.
        config: weight of the height.
    """
    lift = np.maximum(toe_height - np.percentile(toe_height, 10, axis=0), 0)
    highest = np.maximum(np.percentile(lift, 98, axis=0), 1e-3)
    fastest = np.maximum(np.percentile(toe_speed, 98, axis=0), 1e-2)
    return np.maximum(config.height_weight * lift / highest, toe_speed / fastest)


def detect(activity: Array, rate_hz: float, periodic: bool, config: ContactConfig) -> Stances:
    """Contacts by hysteresis and a minimum duration.

    Args:
        activity: (t, legs) from `foot_activity`.
        rate_hz: of the samples.
        periodic: whether sample t repeats sample 0.
        config: thresholds.

    Returns:
        The stances of each leg.
    """
    shortest = round(config.shortest_s * rate_hz)
    legs = []
    for series in activity.T:
        on = _hysteresis(series, config, periodic)
        on = _without_short(on, False, shortest, periodic)
        legs.append(stances_of(_without_short(on, True, shortest, periodic), periodic))
    return legs


def stances_of(on: NDArray[np.bool_], periodic: bool) -> list[Stance]:
    """The stances in a boolean series (t,)."""
    n = len(on)
    if on.all():
        return [Stance(0, n)]
    before, after = np.roll(on, 1), np.roll(on, -1)
    if not periodic:
        before[0] = after[-1] = False
    starts = np.flatnonzero(on & ~before)
    ends = np.flatnonzero(on & ~after) + 1
    if len(starts) and ends[0] <= starts[0]:
        ends = np.append(ends[1:], ends[0] + n)
    return [Stance(int(a), int(b)) for a, b in zip(starts, ends, strict=True)]


def contact_mask(stances: Stances, n: int) -> NDArray[np.bool_]:
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
    """Swings (lift-off, next touch-down) of one leg, not empty; cut off by the ends if not periodic."""
    if not spans:
        return [(0, n)]
    swings = [(a.lift_off, b.touch_down) for a, b in pairwise(spans)]
    if periodic:
        swings.append((spans[-1].lift_off, spans[0].touch_down + n))
    else:
        swings = [(0, spans[0].touch_down), *swings, (spans[-1].lift_off, n)]
    return [swing for swing in swings if swing[1] > swing[0]]


def _hysteresis(series: Array, config: ContactConfig, periodic: bool) -> NDArray[np.bool_]:
    on = np.empty(len(series), dtype=bool)
    state = bool(series[0] < config.enter)
    for _ in range(2 if periodic else 1):  # the second time round, the state at the seam is the one before it
        for i, value in enumerate(series):
            state = bool(value < (config.leave if state else config.enter))
            on[i] = state
    return on


def _without_short(on: NDArray[np.bool_], value: bool, shortest: int, periodic: bool) -> NDArray[np.bool_]:
    """Inverts the runs of `value` that are shorter than `shortest` and not cut off by the recording's ends."""
    result = on.copy()
    for start, end in stances_of(on == value, periodic):
        cut_off = not periodic and (start == 0 or end == len(on))
        if end - start < min(shortest, len(on)) and not cut_off:
            result[np.arange(start, end) % len(on)] = not value
    return result
