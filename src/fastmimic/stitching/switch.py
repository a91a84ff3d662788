"""Finds the phases at which one cyclic motion switches to another: where their feet agree best.

Each leg switches within a stance or a swing: the last of the first motion and the first of the second are merged. The
phases that keep the merged durations nearest to the usual ones are chosen, so that no foot has to stand and swing at
once. From a pace to a trot some stances become longer and others shorter, by as little as the best phases allow.
"""

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np

from fastmimic.base.arrays import Array, Flags
from fastmimic.base.rotations import rotate_planar, yaw_from_quat
from fastmimic.motion.contacts import Stance, stances_of
from fastmimic.motion.motion import Motion
from fastmimic.motion.provenance import Span
from fastmimic.retargeting.feet import Reach

SEARCH_S: Final = 0.6  # largest distance of a switch from whole cycles, at most half a cycle
MAX_ACCELERATION: Final = 1.4  # m/s², of the trunk's mean velocity within a transition
MAX_TURN_ACCELERATION: Final = 6.0  # rad/s²
_STEEPEST: Final = 1.875  # slope of the smooth step at its middle
_LEAST_STRIDES: Final = 0.5  # shortest transition of the trunk
_STEP_S: Final = 0.02
_FINER: Final = 5
_LOOK_S: Final = 0.01
_SHORTEST: Final = 0.5  # shortest merged stance, as a share of its usual duration; `_SHORTEST_SWING` for swings
_SHORTEST_SWING: Final = 0.85
_FORBIDDEN: Final = 100.0
_OFF_CENTRE: Final = 0.3
_OUT_OF_REACH: Final = 20.0
_SPEED_CHANGE: Final = 0.1  # s²/m²
_STRANGE_SUPPORT: Final = np.array([16.0, 8.0, 2.0, 0.0, 0.0])
"""Cost of a stride on 0, …, 4 feet in a combination that neither motion has."""
_CANDIDATES: Final = 150
_FOREVER: Final = 100  # strides of the stance of a foot that never lifts off


@dataclass(frozen=True, eq=False)
class Cycle:
    """A cyclic motion for the search of a switch: `n` samples with contact (n, 4), and the stances of each leg, empty
    for one that never lifts off. `velocity` (n, 3) is the trunk's, heading frame, averaged over a stride: m/s, m/s,
    rad/s. `stride` is the mean number of samples between two steps of a leg."""

    n: int
    stances: tuple[tuple[Stance, ...], ...]
    contact: Flags
    velocity: Array
    stride: int

    @classmethod
    def of(cls, motion: Motion) -> "Cycle":
        n = motion.n_samples
        stances = tuple(() if on.all() else tuple(stances_of(on, periodic=True)) for on in motion.contact.T)
        steps = max((len(s) for s in stances), default=0)
        stride = min(round(n / max(steps, 1)), round(0.8 * motion.rate_hz))
        yaw = yaw_from_quat(motion.root_quat_wxyz)
        planar = rotate_planar(-yaw, motion.root_lin_vel_w[:, :2])
        velocity = np.column_stack([planar, motion.root_ang_vel_w[:, 2]])
        window = np.zeros(n)
        window[np.arange(-(stride // 2), stride - stride // 2) % n] += 1.0 / stride
        smooth = np.fft.irfft(np.fft.rfft(velocity, axis=0) * np.fft.rfft(window)[:, None].conj(), n, axis=0)
        return cls(n, stances, motion.contact, smooth, stride)

    def around(self, leg: int, phase: int, reach: int) -> list[Stance]:
        """Stances of a leg within `reach` samples of a phase, relative to it; a very long one if it never lifts off."""
        if not self.stances[leg]:
            return [Stance(-_FOREVER * reach, _FOREVER * reach)]
        found = []
        for touch_down, lift_off in self.stances[leg]:
            turns = np.arange((phase - reach - lift_off) // self.n, (phase + reach - touch_down) // self.n + 2)
            for k in turns:
                stance = Stance(int(touch_down + k * self.n - phase), int(lift_off + k * self.n - phase))
                if stance.lift_off > -reach and stance.touch_down < reach:
                    found.append(stance)
        return sorted(found)


@dataclass(frozen=True)
class Switch:
    """A switch between two cyclic motions, where sample `out` of the first, not wrapped, meets `into` of the second.
    `feet` are the merged stances or swings relative to it; `half` is half the samples of the trunk's blend."""

    out: int
    into: int
    feet: tuple[Span, Span, Span, Span]
    half: int
    cost: float  # small where the motions agree well


def best_switch(a: Cycle, b: Cycle, out: int, rate_hz: float, reach: Reach, linger_s: float) -> Switch:
    """The best switch from `a`, near its unwrapped sample `out`, to the beginning of `b`."""
    step = max(1, round(_STEP_S * rate_hz))
    finer = max(1, step // _FINER)
    farthest = [min(cycle.n // 2, round(SEARCH_S * rate_hz)) for cycle in (a, b)]
    offsets, intos = (range(-most + 1, most + 1, step) for most in farthest)
    coarse = _best_of(a, b, out, offsets, intos, rate_hz, reach, linger_s)
    best = zip((coarse.out - out, coarse.into), farthest, strict=True)
    offsets, intos = (range(max(at - step, -most + 1), min(at + step, most) + 1, finer) for at, most in best)
    fine = _best_of(a, b, out, offsets, intos, rate_hz, reach, linger_s)
    return min(coarse, fine, key=lambda switch: switch.cost)


def _best_of(
    a: Cycle, b: Cycle, out: int, offsets: range, intos: range, rate_hz: float, reach: Reach, linger_s: float
) -> Switch:
    """The best switch at samples `out` + offset of `a` and `into` of `b`."""
    near = 2 * max(a.stride, b.stride)
    stride = 0.5 * (a.stride + b.stride)
    sweep = reach.longest_stance(1.0, 0.0)
    into = {k: [b.around(leg, k, near) for leg in range(4)] for k in intos}
    found = []
    for o in offsets:
        before = [a.around(leg, out + o, near) for leg in range(4)]
        v_a = a.velocity[(out + o) % a.n]
        for k, after in into.items():
            v_b = b.velocity[k % b.n]
            half = _half_transition(v_b - v_a, stride, rate_hz)
            passing = _Passing(
                (v_a[:2] / rate_hz).tolist(), (v_b[:2] / rate_hz).tolist(), half, sweep, linger_s * rate_hz
            )
            merged = [_merge(x, y, stride, passing) for x, y in zip(before, after, strict=True)]
            change = v_b[:2] - v_a[:2]
            cost = sum(c for c, _ in merged) + _SPEED_CHANGE * float(change @ change)
            found.append((cost, o, k, half, [span for _, span in merged]))
    found.sort(key=lambda entry: entry[:3])
    allowed = _supports(a.contact) | _supports(b.contact)
    every = max(1, round(_LOOK_S * rate_hz))
    switches = []
    for cost, o, k, half, spans in found[:_CANDIDATES]:
        strange = _strangeness(a, b, out + o, k, spans, allowed, stride, every)
        feet = (spans[0], spans[1], spans[2], spans[3])
        switches.append(Switch(out + o, k, feet, half, cost + strange))
    return min(switches, key=lambda s: (s.cost, s.out, s.into))


def _half_transition(change: Array, stride: float, rate_hz: float) -> int:
    """Half the samples of the trunk's blend for a change (3,) of its velocity, m/s and rad/s."""
    speed = _STEEPEST * math.hypot(change[0], change[1]) / MAX_ACCELERATION
    turn = _STEEPEST * abs(float(change[2])) / MAX_TURN_ACCELERATION
    return math.ceil(0.5 * max(_LEAST_STRIDES * stride, speed * rate_hz, turn * rate_hz))


@dataclass(frozen=True, eq=False)
class _Passing:
    """The trunk's travel from one velocity (2,), m a sample, to another within ± `half` samples. `sweep`, m, is its
    travel over a foot in reach, and `linger` the samples near the foothold before and after the stance."""

    before: list[float]
    after: list[float]
    half: int
    sweep: float
    linger: float

    def excess(self, start: int, end: int, own: float) -> float:
        """Excess of a stance over the leg's reach, or over `own`, the travel in its own motion, m, as a share."""
        first, last = start - self.linger, end + self.linger
        later = self._covered(last) - self._covered(first)
        sooner = last - first - later
        way = math.hypot(
            sooner * self.before[0] + later * self.after[0], sooner * self.before[1] + later * self.after[1]
        )
        return max(0.0, way / max(self.sweep, own) - 1.0)

    def _covered(self, sample: float) -> float:
        """Integral of the smooth step up to a sample."""
        u = min(max(0.5 * (sample / self.half + 1.0), 0.0), 1.0)
        return 2 * self.half * u**4 * (2.5 - 3 * u + u * u) + max(0.0, sample - self.half)


def _merge(before: list[Stance], after: list[Stance], stride: float, passing: _Passing) -> tuple[float, Span]:
    """The least cost of merging two stances or swings of one leg, and the merged one."""
    best = _merge_swings(before, after, stride)
    for x in before:
        for y in after:
            start, end = x.touch_down, y.lift_off
            duration, lasted, lasts = end - start, x.duration, y.duration
            if duration <= 0:
                continue
            if lasted > _FOREVER * stride or lasts > _FOREVER * stride:  # it stands throughout one of the motions
                start, end = (y.touch_down, y.lift_off) if lasted > lasts else (x.touch_down, x.lift_off)
                cost = _off_centre(start, end, stride)
            elif (cost := _off_centre(start, end, stride)) < best[0]:
                usual = 0.5 * (min(lasted, stride) + min(lasts, stride))
                cost = ((duration - usual) / usual) ** 2 + cost
                if cost >= best[0]:
                    continue
                own = min(lasted * math.hypot(*passing.before), lasts * math.hypot(*passing.after))
                cost += _OUT_OF_REACH * passing.excess(start, end, own)
                if duration < _SHORTEST * min(lasted, lasts):
                    cost += _FORBIDDEN
            if cost < best[0]:
                best = (cost, Span(start, end))
    return best


def _off_centre(start: int, end: int, stride: float) -> float:
    """Cost of a span whose middle is not the moment of the switch."""
    return _OFF_CENTRE * (0.5 * (start + end) / stride) ** 2


def _merge_swings(before: list[Stance], after: list[Stance], stride: float) -> tuple[float, Span]:
    best = (math.inf, Span(0, 0))
    for x, following in pairwise(before):
        for previous, y in pairwise(after):
            start, end = x.lift_off, y.touch_down
            if end <= start or (cost := _off_centre(start, end, stride)) >= best[0]:
                continue
            usual = following.touch_down - x.lift_off, y.touch_down - previous.lift_off
            if end - start < _SHORTEST_SWING * max(usual):  # the joints' speed
                continue
            mean = 0.5 * sum(usual)
            cost = ((end - start - mean) / mean) ** 2 + cost
            if cost < best[0]:
                best = (cost, Span(start, end, stands=False))
    return best


def _supports(contact: Flags) -> set[int]:
    """The sets of standing feet in more than 2 % of a motion, as bits."""
    code, count = np.unique(contact @ (1 << np.arange(4)), return_counts=True)
    return {int(c) for c, k in zip(code, count, strict=True) if k >= 0.02 * len(contact)}


def _strangeness(
    a: Cycle, b: Cycle, out: int, into: int, feet: list[Span], allowed: set[int], stride: float, step: int
) -> float:
    when = np.arange(-round(1.5 * stride), round(1.5 * stride), step)
    contact = np.empty((len(when), 4), np.bool_)
    for leg, span in enumerate(feet):
        later = np.where(when < span.end, span.stands, b.contact[(into + when) % b.n, leg])
        contact[:, leg] = np.where(when < span.start, a.contact[(out + when) % a.n, leg], later)
    strange = ~np.isin(contact @ (1 << np.arange(4)), list(allowed))
    return float(np.sum(strange * _STRANGE_SUPPORT[contact.sum(axis=1)]) * step / stride)
