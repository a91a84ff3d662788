"""Domain randomisation of the search (Tobin et al. 2017; Peng et al. 2018): each candidate is scored over several
robots that differ from the controller's model.

All candidates of an iteration meet the same robots (common random numbers), for a fair ranking; each iteration draws
new ones. The first is always the nominal robot: it guards the nominal reward, and makes a part of the score comparable
between iterations. Unseen robots choose the result, and others measure it.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np

from fastmimic.base.arrays import Array
from fastmimic.base.errors import ConfigError, unknown
from fastmimic.simulation.conditions import (
    PUSH_WINDOW_S,
    Disturbance,
    Range,
    check_once,
    draw,
    parse_range,
    usual_range,
)
from fastmimic.simulation.disturbance_kinds import DISTURBANCES, PUSH_DURATION_S, PUSH_TIME_S

ROBOTS: Final = 4  # per candidate by default; the cost of a search is in proportion
CRITERIA: Final[dict[str, Callable[[Array], Array]]] = {
    "mean": lambda scores: np.mean(scores, axis=-1),
    "worst": lambda scores: np.min(scores, axis=-1),
}
"""Aggregates of scores (…, m) over m robots to (…,), by name."""

HELD_OUT_ROBOTS: Final = 16
# Streams of random numbers, after the seed; the optimiser uses 0 and 1. Generators ignore trailing zeros, so iterations
# count from 1.
_SEARCH, _CHOICE, _HELD_OUT = 2, 3, 4


def usual_randomization() -> tuple[Range, ...]:
    """The default ranges: ground, load and motors, which never match their model. Slopes and pushes are other tasks."""
    return tuple(usual_range(name) for name, kind in DISTURBANCES.items() if kind.randomized)


@dataclass(frozen=True)
class Randomization:
    """The `robots` that score a candidate, the nominal one included, by a `criterion`, one of `CRITERIA`. `over` are
    the ranges of their differences; texts such as "friction" or "payload=0:3" are read as on the command line."""

    robots: int = ROBOTS
    over: tuple[Range, ...] = field(default_factory=usual_randomization)
    criterion: str = "mean"

    def __post_init__(self) -> None:
        if self.robots < 2:
            raise ConfigError(
                f"randomisation takes at least 2 robots, found {self.robots}: the robot as it is, and one that differs"
            )
        if self.criterion not in CRITERIA:
            raise unknown("criterion", self.criterion, CRITERIA)
        given: Sequence[Any] = self.over
        if isinstance(given, str):
            given = (given,)
        ranges = [parse_range(r) if isinstance(r, str) else r for r in given]
        if not ranges:
            raise ConfigError("randomisation needs at least one disturbance, such as friction")
        check_once(ranges)
        order = list(DISTURBANCES)  # draws do not depend on the order given
        object.__setattr__(self, "over", tuple(sorted(ranges, key=lambda r: order.index(r.name))))

    def check(self, episode_s: float) -> None:
        """Raises `ConfigError` if a push may come after the end of an episode, s."""
        latest = PUSH_TIME_S + PUSH_WINDOW_S + PUSH_DURATION_S
        late = [r.name for r in self.over if DISTURBANCES[r.name].timed]
        if late and episode_s < latest:
            raise ConfigError(
                f"an episode of {episode_s:g} s may end before a push, which comes until {latest:g} s; leave out"
                f" '{late[0]}', or give a longer duration"
            )

    def scored(self, scores: Array) -> Array:
        """Aggregate of scores (…, m) over m robots, (…,)."""
        return CRITERIA[self.criterion](scores)

    def of_iteration(self, seed: int, iteration: int) -> tuple[Disturbance, ...]:
        """The robots that all candidates of an iteration (from 0) meet."""
        return draw(self.over, self.robots, np.random.default_rng([seed, _SEARCH, iteration + 1]), nominal_first=True)

    def of_choice(self, seed: int, n: int) -> tuple[Disturbance, ...]:
        """The n robots that choose the result: the nominal one, and n − 1 that the search has not met."""
        return draw(self.over, n, np.random.default_rng([seed, _CHOICE]), nominal_first=True)

    def held_out(self, n: int = HELD_OUT_ROBOTS) -> tuple[Disturbance, ...]:
        """The robots that measure the result: all differ from the nominal one, and neither search nor choice has met
        them. They depend on the ranges only, so that other seeds, criteria and numbers of robots compare."""
        return draw(self.over, n, np.random.default_rng([0, _HELD_OUT]))

    def as_dict(self) -> dict[str, Any]:
        """Plain values, JSON-serialisable; ranges as (lower, upper) by name."""
        return {
            "robots": self.robots,
            "criterion": self.criterion,
            "over": {r.name: [r.lower, r.upper] for r in self.over},
        }

    def __str__(self) -> str:
        over = ", ".join(str(r) for r in self.over)
        return f"{self.robots} robots for each candidate, the {self.criterion} of their scores, over {over}"
