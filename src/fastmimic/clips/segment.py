"""Cuts an animal's take into locomotion cycles, standing and movement that does not repeat, and names the gaits.
The cheapest path through a measure of repetition gives the period over time. Neighbouring cycles with similar tempo,
speed, turning and footfall form a segment; `footfall_of` names its gait."""

import math
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from fastmimic.base.arrays import Array, Flags, Indices, stretches
from fastmimic.base.configuration import check, tabulated
from fastmimic.base.errors import ClipError, ConfigError
from fastmimic.base.rotations import turned_about_z
from fastmimic.clips.catalogue import open_clip
from fastmimic.clips.clip import Clip


@tabulated
@dataclass(frozen=True)
class SegmentConfig:
    """How takes are cut."""

    shortest_s: float = 0.25
    longest_s: float = 1.5
    aperiodic: float = 0.45
    onset: float = 2.0
    drift: float = 6.0
    tempo: float = 0.12
    speed: float = 0.25
    turning: float = 0.30
    footfall: float = 0.16
    turn_rad: float = 0.26
    still_m: float = 0.02
    stand_s: float = 0.5
    discrete_s: float = 0.25

    def __post_init__(self) -> None:
        check(self, "segment: ")
        if self.longest_s <= self.shortest_s:
            shortest, longest = f"{self.shortest_s:g} s", f"{self.longest_s:g} s"
            raise ConfigError(f"segment: the longest cycle ({longest}) must be longer than the shortest ({shortest})")


def aperiodicity_of(toes: Array, rate_hz: float, config: SegmentConfig) -> tuple[Indices, Array]:
    """The lags (k,), frames, and d' (t, k); NaN where the take holds less than half a cycle on one side.

    It is the difference function of the pitch detector YIN (de Cheveigné and Kawahara 2002), with the toes' paths under
    the hips instead of a sound. At frame t and lag L it compares the cycle before t with the next one, d(t, L) = mean
    over s in [t - L, t) of |x(s + L) - x(s)|², relative to its mean over all shorter lags: d'(t, L) is near 0 where x
    repeats after L, near 1 where it does not.
    """
    x = toes.reshape(len(toes), -1)
    n, first = len(x), math.ceil(config.shortest_s * rate_hz)
    lags = np.arange(1, min(math.floor(config.longest_s * rate_hz), 2 * n // 3) + 1)
    difference = np.full((n, len(lags)), np.nan)
    t = np.arange(n)
    for lag in lags:
        squares = np.sum((x[lag:] - x[:-lag]) ** 2, axis=1)
        until = np.concatenate([[0.0], np.cumsum(squares)])
        start, end = np.clip([t - lag, t], 0, len(squares))
        known = 2 * (end - start) >= lag
        difference[known, lag - 1] = (until[end] - until[start])[known] / (end - start)[known]
    count = np.cumsum(np.isfinite(difference), axis=1)
    mean = np.nancumsum(difference, axis=1) / np.maximum(count, 1)
    relative = difference / np.maximum(mean, 1e-12)
    return lags[first - 1 :], relative[:, first - 1 :]


def cheapest_track(lags: Indices, aperiodicity: Array, config: SegmentConfig) -> Indices:
    """The lag (t,) at which each frame repeats, 0 where it does not: the cheapest path through d' (Viterbi)."""
    n, k = aperiodicity.shape
    cost = np.where(np.isfinite(aperiodicity), aperiodicity, np.inf)
    step = np.array([-2, -1, 0, 1, 2])
    at = np.arange(k)[:, None] + step  # (k, 5) possible previous lags
    inside = (at >= 0) & (at < k)
    at = np.clip(at, 0, k - 1)
    change = np.where(inside, config.drift * np.abs(np.log(lags[at] / lags[:, None])), np.inf)
    came = np.zeros((n, k + 1), np.int64)  # previous state: index of a lag, or k where nothing repeats
    best, silent = cost[0], config.aperiodic
    for t in range(1, n):
        ways = best[at] + change
        choice = ways.argmin(axis=1)
        staying, beginning = ways[np.arange(k), choice], silent + config.onset
        last = int(best.argmin())
        ending = best[last] + config.onset
        came[t, :k] = np.where(beginning < staying, k, at[np.arange(k), choice])
        came[t, k] = last if ending < silent else k
        best, silent = cost[t] + np.minimum(staying, beginning), config.aperiodic + min(ending, silent)
    state = int(best.argmin()) if best.min() < silent else k
    found = np.zeros(n, np.int64)
    for t in range(n - 1, -1, -1):
        found[t] = lags[state] if state < k else 0
        state = came[t, state]
    return found


FOOTFALLS: Final = ("walk", "trot", "pace", "canter", "gallop", "bound")
_SQUARE: Final = 0.125  # cycles: half way between pace, walk and trot


def footfall_of(phases: Array) -> str:
    """The gait of legs with phases (4,), cycles, in the common order; one of `FOOTFALLS` (Hildebrand 1965). In a
    symmetrical gait left and right are half a cycle apart; the fore foot's lag behind the hind foot of its side, in
    cycles, then distinguishes pace (0), walk (1/4) and trot (1/2)."""

    def apart(a: int, b: int) -> float:
        return float(abs((phases[a] - phases[b] + 0.5) % 1.0 - 0.5))

    fr, fl, rr, rl = range(4)
    fore, hind = apart(fr, fl), apart(rr, rl)
    if fore > 0.5 - 1.5 * _SQUARE and hind > 0.5 - 1.5 * _SQUARE:  # symmetrical
        diagonal = (apart(fr, rl) + apart(fl, rr)) / 2
        lateral = (apart(fr, rr) + apart(fl, rl)) / 2
        if lateral < _SQUARE:
            return "pace"
        return "trot" if diagonal < _SQUARE else "walk"
    if fore < _SQUARE / 2 and hind < _SQUARE / 2:
        return "bound"
    if min(apart(fr, rl), apart(fl, rr)) < _SQUARE / 2:
        return "canter"  # three beats: one diagonal lands together
    return "gallop"


STAND: Final = "stand"
DISCRETE: Final = "discrete"
TURN: Final = "turn"
GAITS: Final = (*FOOTFALLS, TURN, STAND, DISCRETE)
"""Kinds of segment: `discrete` does not repeat, `turn` is any footfall that turns enough."""


@dataclass(frozen=True)
class Segment:
    """A part of a take.

    Attributes:
        start, end: frames, 0-based, end exclusive.
        gait: one of `GAITS`.
        footfall: one of `FOOTFALLS`, of a turn as well; None where nothing repeats.
        period_frames, cycle: period, and the cycle (first, end) that repeats best; None where nothing repeats.
        confidence: from 0, d' no better than chance, to 1, an exact repetition; of others, how clearly nothing repeats.
        speed_m_per_s: mean over the ground, of the trunk, in the animal's size.
        yaw_rate_rad_per_s: mean of its heading, positive to the left.
    """

    start: int
    end: int
    gait: str
    footfall: str | None
    period_frames: float | None
    cycle: tuple[int, int] | None
    confidence: float
    speed_m_per_s: float
    yaw_rate_rad_per_s: float

    def later(self, frames: int) -> "Segment":
        """The segment in a take that begins so many frames earlier."""
        cycle = None if self.cycle is None else (self.cycle[0] + frames, self.cycle[1] + frames)
        return replace(self, start=self.start + frames, end=self.end + frames, cycle=cycle)


@dataclass(frozen=True, eq=False)
class _Take:
    """x (t, 4, 3): toes from their hips in the heading frame, m; heading (t,) rad, unwrapped; trunk (t, 2), m."""

    toes: Array
    heading: Array
    trunk: Array
    rate_hz: float
    config: SegmentConfig

    @cached_property
    def repetition(self) -> tuple[Indices, Array]:
        """The lags, and d' (`aperiodicity_of`)."""
        return aperiodicity_of(self.toes, self.rate_hz, self.config)


def find_segments(clip: Clip | str | Path, config: SegmentConfig | None = None) -> list[Segment]:
    """Cuts a take of at least two cycles, or that of a name or file as for `open_clip`, into ordered segments without
    overlap; keeps a clip that its source calls one cycle. Raises `ClipError`: it is too short, or its frame rate too
    low."""
    clip = clip if isinstance(clip, Clip) else open_clip(clip)
    config = config if config is not None else SegmentConfig()
    if clip.is_cycle and clip.n_frames <= config.longest_s * clip.rate_hz:
        return [as_one_cycle(clip, config)]
    fewest = 2 * math.ceil(config.shortest_s * clip.rate_hz)
    if clip.n_frames < fewest:
        said = f"{clip.origin}: {clip.n_frames} frames at {clip.rate_hz:g} Hz are too few to find cycles in"
        raise ClipError(f"{said}; two cycles of {config.shortest_s:g} s are {fewest} frames")
    if config.shortest_s * clip.rate_hz < 6:
        raise ClipError(f"{clip.rate_hz:g} frames a second are too few for cycles of {config.shortest_s:g} s")
    take = take_of(clip, config)
    period = cheapest_track(*take.repetition, config)
    period[_still(take)] = 0
    return _with_the_rest(take, _periodic(take, period))


def as_one_cycle(clip: Clip, config: SegmentConfig = SegmentConfig()) -> Segment:
    """A clip as one cycle: its gait, speed and turning, and how well it closes."""
    take = take_of(clip, config)
    n = len(take.heading)
    piece = _piece(take, 0, n, float(n))
    x = take.toes.reshape(n, -1)
    gap = float(np.sum((2 * x[-1] - x[-2] - x[0]) ** 2) / max(2 * x.var(axis=0).sum(), 1e-12))
    return _named(take, piece, float(n), (0, n), min(max(1.0 - gap, 0.0), 1.0))


def take_of(clip: Clip, config: SegmentConfig) -> _Take:
    """The paths of a clip's toes, heading and trunk."""
    neck, pelvis = clip.point("neck"), clip.point("pelvis")
    ahead = (neck - pelvis)[:, :2]
    heading = np.unwrap(np.arctan2(ahead[:, 1], ahead[:, 0]))
    toes = turned_about_z(clip.toes_w - clip.hips_w, -heading[:, None])
    return _Take(toes, heading, ((neck + pelvis) / 2)[:, :2], clip.rate_hz, config)


def _still(take: _Take) -> Flags:
    """Whether nothing moves (t,) for half a second around a frame."""
    from scipy.ndimage import maximum_filter1d, minimum_filter1d

    window = 2 * round(0.25 * take.rate_hz) + 1
    moving = np.concatenate([take.toes.reshape(len(take.toes), -1), take.trunk], axis=1)
    extent = maximum_filter1d(moving, window, axis=0) - minimum_filter1d(moving, window, axis=0)
    return np.asarray(extent.max(axis=1) < take.config.still_m)


@dataclass(eq=False)
class _Piece:
    """One or more cycles: frames [start, end), period in frames, speed in m/s, yaw in rad a cycle, and the fundamentals
    (4,) of the toes' paths, with the legs' phases."""

    start: int
    end: int
    period: float
    speed: float
    yaw: float
    legs: NDArray[np.complex128]

    def unlike(self, other: "_Piece", config: SegmentConfig) -> float:
        """Difference of two pieces; up to 1 they can be one segment."""
        phases = np.angle(self.legs * np.conj(self.legs[0]) * np.conj(other.legs) * other.legs[0]) / (2 * math.pi)
        slower = min(self.speed, other.speed)
        return max(
            abs(math.log(self.period / other.period)) / config.tempo,
            abs(self.speed - other.speed) / (config.speed * slower + 0.1),
            abs(self.yaw - other.yaw) / config.turning,
            float(np.abs(phases).max()) / config.footfall,
        )


def _periodic(take: _Take, period: Indices) -> list[Segment]:
    runs = stretches(period > 0)
    found = []
    for i, (start, end) in enumerate(runs):
        # at the start of a gait, cycles become alike only after half a cycle
        before = (runs[i - 1][1] + start) // 2 if i else 0
        after = (end + runs[i + 1][0]) // 2 if i + 1 < len(runs) else len(period)
        first = max(before, start - int(period[start]) // 2)
        last = min(after, end + int(period[end - 1]) // 2)
        track = np.interp(np.arange(first, last), np.arange(start, end), period[start:end].astype(float))
        if last - first >= 1.5 * track.mean():
            pieces = _merged(_cycles(take, first, track), take.config)
            found += [_segment(take, piece, period) for piece in pieces]
    return found


def _cycles(take: _Take, first: int, track: Array) -> list[_Piece]:
    """The cycles from frame `first` to the end, by the period (t,) at each frame; the last one takes the rest."""
    count = max(1, int(np.sum(1.0 / track)))
    done = np.concatenate([[0.0], np.cumsum(1.0 / track)])
    edges = first + np.searchsorted(done, np.arange(count) * (1.0 - 1e-9))
    edges = np.append(edges, first + len(track))
    return [_piece(take, int(a), int(b), float(np.median(track[a - first : b - first]))) for a, b in pairwise(edges)]


def _piece(take: _Take, start: int, end: int, period: float) -> _Piece:
    seconds = (end - start) / take.rate_hz
    travel = np.linalg.norm(take.trunk[min(end, len(take.trunk) - 1)] - take.trunk[start])
    turn = take.heading[min(end, len(take.heading) - 1)] - take.heading[start]
    t = np.arange(start, end)
    toes = take.toes[start:end]
    wave = np.exp(-2j * math.pi * t / period)
    fore_aft, height = (wave @ (toes[..., axis] - toes[..., axis].mean(axis=0)) for axis in (0, 2))
    # feet that step sideways or on the spot: use their height
    legs = fore_aft if np.linalg.norm(fore_aft) > np.linalg.norm(height) else height
    return _Piece(start, end, period, float(travel) / seconds, float(turn) * period / (end - start), legs)


def _merged(pieces: list[_Piece], config: SegmentConfig) -> list[_Piece]:
    """Joins neighbours, the most alike first, until none are alike."""
    pieces = list(pieces)
    while len(pieces) > 1:
        unlike = [a.unlike(b, config) for a, b in pairwise(pieces)]
        i = int(np.argmin(unlike))
        if unlike[i] > 1.0:
            break
        pieces[i : i + 2] = [_joined(*pieces[i : i + 2])]
    return pieces


def _joined(a: _Piece, b: _Piece) -> _Piece:
    na, nb = a.end - a.start, b.end - b.start
    w = na / (na + nb)
    pairs = (a.period, b.period), (a.speed, b.speed), (a.yaw, b.yaw)
    period, speed, yaw = (w * x + (1 - w) * y for x, y in pairs)
    # phases relative to the first leg do not drift if the period is slightly wrong
    legs = a.legs * np.conj(a.legs[0]) / abs(a.legs[0]) + b.legs * np.conj(b.legs[0]) / abs(b.legs[0])
    return _Piece(a.start, b.end, period, speed, yaw, np.asarray(legs))


def _segment(take: _Take, piece: _Piece, track: Indices) -> Segment:
    (lags, aperiodicity), start, end = take.repetition, piece.start, piece.end
    tracked = track[start:end]
    frames = start + np.flatnonzero(tracked > 0)
    found = np.median(track[frames]) if len(frames) else piece.period
    doubt = aperiodicity[frames, track[frames] - lags[0]] if len(frames) else np.ones(1)
    confidence = float(np.clip(1.0 - np.nanmean(doubt), 0.0, 1.0))
    return _named(take, piece, float(found), _best_cycle(take, start, end, round(found)), confidence)


def _named(take: _Take, piece: _Piece, period: float, cycle: tuple[int, int], confidence: float) -> Segment:
    speed, yaw_rate = _motion(take, piece.start, piece.end)
    footfall = footfall_of(np.angle(piece.legs) / (2 * math.pi))
    gait = TURN if abs(yaw_rate) * period / take.rate_hz > take.config.turn_rad else footfall
    return Segment(piece.start, piece.end, gait, footfall, period, cycle, confidence, speed, yaw_rate)


def _motion(take: _Take, start: int, end: int) -> tuple[float, float]:
    """Mean ground speed of the trunk, m/s, along its smoothed path, and mean turn rate, rad/s."""
    seconds = (end - start - 1) / take.rate_hz
    if seconds <= 0:
        return 0.0, 0.0
    step = max(1, round(0.2 * take.rate_hz))
    way = take.trunk[np.append(np.arange(start, end - 1, step), end - 1)]
    speed = np.linalg.norm(np.diff(way, axis=0), axis=1).sum() / seconds
    return float(speed), float(take.heading[end - 1] - take.heading[start]) / seconds


def _best_cycle(take: _Take, start: int, end: int, period: int) -> tuple[int, int]:
    """First frame and end of the cycle that closes best in the toes and their velocities."""
    if end - start <= period + 1:
        return start, min(start + period, end)
    x = take.toes[start:end].reshape(end - start, -1)
    velocity = np.asarray(np.gradient(x, axis=0))
    gap = np.sum((x[period:] - x[:-period]) ** 2, axis=1)
    gap += (period / (2 * math.pi)) ** 2 * np.sum((velocity[period:] - velocity[:-period]) ** 2, axis=1)
    first = start + int(gap.argmin())
    return first, first + period


def _with_the_rest(take: _Take, segments: list[Segment]) -> list[Segment]:
    """Adds standing and movement that does not repeat between the segments."""
    config, (_, aperiodicity) = take.config, take.repetition
    free = np.ones(len(take.heading), dtype=bool)
    for segment in segments:
        free[segment.start : segment.end] = False
    still = _still(take)
    least = np.nanmin(np.where(np.isfinite(aperiodicity), aperiodicity, np.inf), axis=1)
    found = list(segments)
    for kind, mask, shortest in ((STAND, free & still, config.stand_s), (DISCRETE, free & ~still, config.discrete_s)):
        for start, end in stretches(mask):
            if end - start >= shortest * take.rate_hz:
                certain = least[start:end]
                certain = certain[np.isfinite(certain)]
                sure = 1.0 if kind == STAND else float(np.clip(certain.mean(), 0.0, 1.0)) if len(certain) else 1.0
                found.append(Segment(start, end, kind, None, None, None, sure, *_motion(take, start, end)))
    return sorted(found, key=lambda segment: segment.start)
