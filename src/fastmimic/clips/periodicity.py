"""Measures how strongly a take repeats at each moment and lag, and finds its period over time.

The measure is the difference function of the pitch detector YIN (de Cheveigné and Kawahara 2002), with the toes' paths
under the hips instead of a sound. At frame t and lag L it compares the cycle before t with the next one,

    d(t, L) = mean over s in [t - L, t) of |x(s + L) - x(s)|²,

relative to its mean over all shorter lags, d'(t, L): near 0 where x repeats after L, near 1 where it does not. The lag
over time, with stretches where nothing repeats, is the cheapest path through d' (Viterbi).
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fastmimic.base.arrays import Array
from fastmimic.base.configuration import check, documented, parameter
from fastmimic.base.errors import ConfigError


@documented
@dataclass(frozen=True)
class SegmentConfig:
    """How takes are cut."""

    shortest_s: float = parameter(0.25, unit="s", above=0.0, about="shortest cycle")
    longest_s: float = parameter(1.5, unit="s", above=0.0, about="longest cycle")
    aperiodic: float = parameter(0.45, above=0.0, about="d' above which a frame rather does not repeat")
    onset: float = parameter(2.0, above=0.0, about="cost of beginning or ending a stretch that repeats, in units of d'")
    drift: float = parameter(6.0, above=0.0, about="cost of changing the lag, for each unit of its logarithm")
    tempo: float = parameter(0.12, above=0.0, about="largest relative change of the period within a segment")
    speed: float = parameter(0.25, above=0.0, about="largest change of speed within a segment, share, plus 0.1 m/s")
    turning: float = parameter(0.30, unit="rad", above=0.0, about="largest change of the turn in a cycle")
    footfall: float = parameter(0.16, unit="cycles", above=0.0, about="largest change of any leg's phase")
    turn_rad: float = parameter(0.26, unit="rad", above=0.0, about="a segment that turns more in a cycle is a turn")
    still_m: float = parameter(
        0.02, unit="m", above=0.0, about="toes and trunk that move less than this in half a second stand"
    )
    stand_s: float = parameter(0.5, unit="s", above=0.0, about="shortest standing that is reported")
    discrete_s: float = parameter(0.25, unit="s", above=0.0, about="shortest other movement that is reported")

    def __post_init__(self) -> None:
        check(self, "segment: ")
        if self.longest_s <= self.shortest_s:
            raise ConfigError(
                f"segment: the longest cycle ({self.longest_s:g} s) must be longer than the shortest"
                f" ({self.shortest_s:g} s)"
            )


def aperiodicity_of(toes: Array, rate_hz: float, config: SegmentConfig) -> tuple[NDArray[np.int64], Array]:
    """The lags (k,), frames, and d' (t, k); NaN where the take holds less than half a cycle on one side."""
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


def cheapest_track(lags: NDArray[np.int64], aperiodicity: Array, config: SegmentConfig) -> NDArray[np.int64]:
    """The lag (t,) at which each frame repeats, 0 where it does not: the cheapest path."""
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
