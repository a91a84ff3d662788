"""Domain randomisation of the search (Tobin et al. 2017; Peng et al. 2018): each candidate is scored over several
robots that differ from the one that the controller knows.

All candidates of an iteration meet the same robots (common random numbers), so that they are ranked by what they are
and not by whom they met; every iteration has new ones. The first of them is the robot as it is: what is found must not
be bought with the reward on it, and a part of the score does not change from iteration to iteration. The result is
chosen on robots that the search has not met, and its worth measured on yet others.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np

from fastmimic.base.arrays import Array
from fastmimic.base.errors import ConfigError, did_you_mean
from fastmimic.simulation.disturbance_kinds import DISTURBANCES, PUSH_DURATION_S, PUSH_TIME_S
from fastmimic.simulation.disturbances import Disturbance
from fastmimic.simulation.ranges import PUSH_WINDOW_S, Range, check_once, draw, parse_range, usual_range

ROBOTS: Final = 4
"""For each candidate, if nothing is said: a search takes as many times as long."""
_WORST: Final = "worst"
CRITERIA: Final[dict[str, Callable[[Array], Array]]] = {
    "mean": lambda scores: np.mean(scores, axis=-1),
    _WORST: lambda scores: np.min(scores, axis=-1),
}
"""What scores (…, m) over m robots are worth together, (…,), by name."""

HELD_OUT_ROBOTS: Final = 16
# Streams of random numbers by purpose, after the seed; the optimiser's own are 0 and 1. A generator's trailing zeros do
# not count, so iterations are numbered from 1.
_SEARCH, _CHOICE, _HELD_OUT = 2, 3, 4


def usual_randomization() -> tuple[Range, ...]:
    """The ranges by default: ground, load and motors, which never match their model; not slopes and pushes, which are
    tasks of their own."""
    return tuple(usual_range(name) for name, kind in DISTURBANCES.items() if kind.randomized)


@dataclass(frozen=True)
class Randomization:
    """Over which robots a candidate is scored.

    Attributes:
        robots: for each candidate, the robot as it is among them.
        over: in what the others differ; texts such as "friction" or "payload=0:3" are read as on the command line.
        criterion: one of `CRITERIA`.
    """

    robots: int = ROBOTS
    over: tuple[Range, ...] = field(default_factory=usual_randomization)
    criterion: str = "mean"

    def __post_init__(self) -> None:
        if self.robots < 2:
            raise ConfigError(
                f"randomisation takes at least 2 robots, found {self.robots}: the robot as it is, and one that differs"
            )
        if self.criterion not in CRITERIA:
            raise ConfigError(
                f"unknown criterion '{self.criterion}'; there are {', '.join(CRITERIA)}"
                f"{did_you_mean(self.criterion, CRITERIA)}"
            )
        given: Sequence[Any] = self.over
        if isinstance(given, str):
            given = (given,)
        ranges = [parse_range(r) if isinstance(r, str) else r for r in given]
        if not ranges:
            raise ConfigError("randomisation needs at least one disturbance, such as friction")
        check_once(ranges)
        order = list(DISTURBANCES)  # what is drawn does not depend on how it was written down
        object.__setattr__(self, "over", tuple(sorted(ranges, key=lambda r: order.index(r.name))))

    def check(self, episode_s: float) -> None:
        """Raises `ConfigError` if an episode, s, may be over before a push."""
        latest = PUSH_TIME_S + PUSH_WINDOW_S + PUSH_DURATION_S
        late = [r.name for r in self.over if r.timed]
        if late and episode_s < latest:
            raise ConfigError(
                f"an episode of {episode_s:g} s may end before a push, which comes until {latest:g} s; leave out"
                f" '{late[0]}', or give a longer duration"
            )

    def scored(self, scores: Array) -> Array:
        """What scores (…, m) over m robots are worth, (…,)."""
        return CRITERIA[self.criterion](scores)

    def of_iteration(self, seed: int, iteration: int) -> tuple[Disturbance, ...]:
        """The robots that all candidates of an iteration, from 0 on, meet."""
        return draw(self.over, self.robots, np.random.default_rng([seed, _SEARCH, iteration + 1]), nominal_first=True)

    def of_choice(self, seed: int, n: int) -> tuple[Disturbance, ...]:
        """Those that the result is chosen on: the robot as it is, and n − 1 that the search has not met."""
        return draw(self.over, n, np.random.default_rng([seed, _CHOICE]), nominal_first=True)

    def held_out(self, n: int = HELD_OUT_ROBOTS) -> tuple[Disturbance, ...]:
        """Those that the result is measured on: all of them differ, and neither search nor choice has met them. They
        depend on the ranges alone, so that what different seeds, criteria and numbers of robots lead to can be
        compared."""
        return draw(self.over, n, np.random.default_rng([0, _HELD_OUT]))

    def as_dict(self) -> dict[str, Any]:
        """Plain values, JSON-serialisable: ranges as (lower, upper) by name."""
        return {
            "robots": self.robots,
            "criterion": self.criterion,
            "over": {r.name: [r.lower, r.upper] for r in self.over},
        }

    def __str__(self) -> str:
        over = ", ".join(str(r) for r in self.over)
        return f"{self.robots} robots for each candidate, the {self.criterion} of their scores, over {over}"


def randomization(given: "int | Randomization | None") -> Randomization | None:
    """What `imitate` takes: a number of robots stands for the usual disturbances and the mean."""
    return Randomization(robots=given) if isinstance(given, int) else given
