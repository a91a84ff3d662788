"""Turns contacts blurred by thresholds and soft paws into a contact schedule that a robot can follow."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from fastmimic.base.arrays import Array
from fastmimic.base.configuration import tabulated
from fastmimic.motion.contacts import Stance, Stances, contact_mask, stances_of, swings_of

PAIRINGS: Final = {"diagonal": ((0, 3), (1, 2)), "lateral": ((0, 2), (1, 3)), "transverse": ((0, 1), (2, 3))}
"""Legs that move together in a trot, a pace and a bound, as indices into FR, FL, RR, RL."""


@tabulated
@dataclass(frozen=True)
class ContactScheduleConfig:
    """How contacts are made a consistent schedule."""

    same_stance: float = 0.62
    flight_s: float = 0.08
    swing_s: float = 0.12
    slide_m: float = 0.005
    step_s: float = 0.24


@dataclass(frozen=True)
class ScheduleChanges:
    """The changes that made the contacts consistent: the pairs of legs that were given common times, if any; whether
    left and right were given one duty factor; numbers of closed short flights and widened short swings; and the number
    of legs (`steps`) that stood for a whole cycle that travels, and were given a step."""

    pairing: str | None = None
    common_duty: bool = False
    closed_flights: int = 0
    widened_swings: int = 0
    steps: int = 0

    def reasons(self) -> list[str]:
        """The changes in words."""
        said = {
            f"{self.pairing} pairs were given common times": self.pairing is not None,
            "left and right were given one duty factor": self.common_duty,
            f"{self.closed_flights} moments without support were closed": self.closed_flights,
            f"{self.widened_swings} short swings were widened": self.widened_swings,
            f"{self.steps} legs that stood while the cycle travels were given a step": self.steps,
        }
        return [text for text, holds in said.items() if holds]


def make_consistent(
    stances: Stances,
    n: int,
    rate_hz: float,
    periodic: bool,
    straight: bool,
    longest_s: float,
    config: ContactScheduleConfig,
) -> tuple[Stances, ScheduleChanges]:
    """Cleans contacts, as detected on `n` samples, by one rule for every gait.

    1. Legs that land and lift off together (a trot's diagonals, a pace's sides) get their mean times. A hind foot rolls
    over its toes, so that thresholds detect later landings and earlier lift-offs than the front foot's.
    2. In a straight cycle with one stance a leg, left and right get one duty factor about the middle of each stance. In
    a paired gait all four legs do.
    3. Very short swings are widened. Short flights are closed half way from both sides, while no stance exceeds
    `longest_s`, a leg's reach over the speed of travel.
    """
    pairing = _find_pairing(stances, n, config.same_stance)
    if pairing is not None:
        stances = _share_times(stances, pairing, n, config.same_stance, round(config.swing_s * rate_hz), periodic)
    common = periodic and straight and all(len(leg) == 1 and leg[0].duration < n for leg in stances)
    if common:
        stances = _common_duty(stances, n, pairing is not None)
    stances, widened = _widen_swings(stances, n, round(config.swing_s * rate_hz), periodic)
    stances, closed = _close_flights(stances, n, round(config.flight_s * rate_hz), longest_s * rate_hz, periodic)
    return stances, ScheduleChanges(pairing, common, closed, widened)


def with_steps(
    stances: Stances, travel: Array, activity: Array, rate_hz: float, config: ContactScheduleConfig
) -> tuple[Stances, int]:
    """Gives a step to every leg that stands for a whole travelling cycle and would slide; returns how many. The step is
    where most of the other feet stand, and among such moments where the animal's foot moved most. `travel` (4,) is the
    distance from each foothold to that of the next cycle, m; `activity` (n, 4) is that of the animal's feet."""
    n, result, added = len(activity), [list(leg) for leg in stances], 0
    length = min(round(config.step_s * rate_hz), n // 2)
    for leg in np.flatnonzero(travel > config.slide_m):
        if not result[leg] or result[leg][0].duration < n:
            continue
        others = np.delete(contact_mask(result, n), leg, axis=1).sum(axis=1)
        merit = others + 0.5 * np.clip(activity[:, leg], 0.0, 1.0)
        window = np.convolve(np.concatenate([merit, merit[: length - 1]]), np.ones(length), mode="valid")
        touch_down = (int(window.argmax()) + length) % n
        result[leg] = [Stance(touch_down, touch_down + n - length)]
        added += 1
    return result, added


def _overlap(a: Stance, b: Stance, n: int) -> tuple[float, int]:
    """Largest share that two stances have in common, with `b` shifted by whole cycles, and that shift."""
    best = (0.0, 0)
    for shift in (-n, 0, n):
        start, end = b.touch_down + shift, b.lift_off + shift
        shared = min(a.lift_off, end) - max(a.touch_down, start)
        union = max(a.lift_off, end) - min(a.touch_down, start)
        best = max(best, (shared / union, shift))
    return best


def _partners(a: list[Stance], b: list[Stance], n: int, least: float) -> list[tuple[int, int, int, float]]:
    """Matching stances, one to one: index in `a`, index in `b`, shift of b, share in common."""
    pairs = []
    for i, stance in enumerate(a):
        (share, shift), j = max((_overlap(stance, other, n), j) for j, other in enumerate(b))
        back = max((_overlap(other, b[j], n)[0], k) for k, other in enumerate(a))[1]
        if share >= least and back == i:
            pairs.append((i, j, shift, share))
    return pairs


def _find_pairing(stances: Stances, n: int, least: float) -> str | None:
    """The pairing of at least four in five stances, or None; None if a leg stands throughout."""
    if any(not leg or leg[0].duration >= n for leg in stances):
        return None
    total = sum(len(leg) for leg in stances) / 2
    scores = {
        name: sum(share for a, b in pairs for *_, share in _partners(stances[a], stances[b], n, least)) / total
        for name, pairs in PAIRINGS.items()
    }
    name = max(scores, key=lambda key: scores[key])
    return name if scores[name] >= 0.8 * least else None


def _share_times(stances: Stances, pairing: str, n: int, least: float, shortest_swing: int, periodic: bool) -> Stances:
    result = [list(leg) for leg in stances]
    for a, b in PAIRINGS[pairing]:
        for i, j, shift, _ in _partners(stances[a], stances[b], n, least):
            x, y = stances[a][i], stances[b][j]
            start = round((x.touch_down + y.touch_down + shift) / 2)
            end = round((x.lift_off + y.lift_off + shift) / 2)
            tried_a, tried_b = list(result[a]), list(result[b])
            tried_a[i] = tried_b[j] = _from_zero(Stance(start, end), n)
            if all(_swings_last(leg, n, shortest_swing, periodic) for leg in (tried_a, tried_b)):
                result[a], result[b] = tried_a, tried_b
    return [sorted(leg) for leg in result]


def _swings_last(spans: list[Stance], n: int, shortest: int, periodic: bool) -> bool:
    """Whether one leg's stances leave at least `shortest` samples between them."""
    spans = sorted(spans)
    following = [*spans[1:], *([Stance(spans[0].touch_down + n, 0)] if periodic else [])]
    return all(after.touch_down - before.lift_off >= shortest for before, after in zip(spans, following, strict=False))


def _from_zero(stance: Stance, n: int) -> Stance:
    """The same stance of a cycle with its touch-down in [0, n)."""
    shift = stance.touch_down // n * n
    return Stance(stance.touch_down - shift, stance.lift_off - shift)


def _common_duty(stances: Stances, n: int, paired: bool) -> Stances:
    result = [list(leg) for leg in stances]
    for group in ((0, 1, 2, 3),) if paired else ((0, 1), (2, 3)):
        duration = round(float(np.mean([stances[leg][0].duration for leg in group])))
        for leg in group:
            start = round((sum(stances[leg][0]) - duration) / 2)
            result[leg] = [_from_zero(Stance(start, start + duration), n)]
    return result


def _widen_swings(stances: Stances, n: int, shortest: int, periodic: bool) -> tuple[Stances, int]:
    """Lengthens short swings at the cost of the stances on both sides; one cut off by the end becomes stance."""
    widened = 0
    result = [list(leg) for leg in stances]
    for leg, spans in enumerate(stances):
        for lift_off, touch_down in swings_of(spans, n, periodic):
            lack = shortest - (touch_down - lift_off)
            if not periodic and (lift_off == 0 or touch_down == n):
                if 2 * lack > shortest and spans:
                    result[leg] = _moved(result[leg], lift_off, touch_down, touch_down, lift_off, 2 * n)
            elif lack > 0:
                earlier, later = lift_off - lack // 2, touch_down + lack - lack // 2
                moved = _moved(result[leg], lift_off, earlier, touch_down, later, n)
                if all(span.duration > shortest // 2 for span in moved):
                    result[leg] = sorted(_from_zero(span, n) for span in moved)
                    widened += 1
    return result, widened


def _close_flights(stances: Stances, n: int, shortest: int, longest: float, periodic: bool) -> tuple[Stances, int]:
    """Closes flights shorter than `shortest` from both sides, unless a stance becomes longer than `longest`."""
    supported = np.asarray(contact_mask(stances, n).any(axis=1))
    if supported.all() or not supported.any():
        return stances, 0
    closed = 0
    for start, end in stances_of(~supported, periodic):
        if end - start > shortest or not (periodic or (start > 0 and end < n)):
            continue
        half = (end - start) // 2
        ending = [s for leg in stances for s in leg if (s.lift_off - start) % n == 0]
        beginning = [s for leg in stances for s in leg if (s.touch_down - end) % n == 0]
        later = min(half, max(0, min(int(longest) - s.duration for s in ending)))
        earlier = min(end - start - half, max(0, min(int(longest) - s.duration for s in beginning)))
        moved = [_moved(leg, start, start + later, end, end - earlier, n) for leg in stances]
        stances = [sorted(_from_zero(stance, n) for stance in leg) for leg in moved]
        closed += later + earlier == end - start
    return stances, closed


def _moved(
    spans: list[Stance], lift_off: int, new_lift_off: int, touch_down: int, new_touch_down: int, n: int
) -> list[Stance]:
    """One leg's stances with those that end at `lift_off` or begin at `touch_down` (modulo n) moved."""
    result = []
    for start, end in spans:
        begin = start + new_touch_down - touch_down if (start - touch_down) % n == 0 else start
        finish = end + new_lift_off - lift_off if (end - lift_off) % n == 0 else end
        result.append(Stance(begin, finish))
    return result
