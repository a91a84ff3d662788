"""In what the robots of a batch differ: disturbances drawn for each robot from a range."""

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from fastmimic.base.errors import ConfigError, did_you_mean
from fastmimic.simulation.disturbances import DISTURBANCES, PUSH_TIME_S, Disturbance, disturbance_named

PUSH_WINDOW_S: Final = 1.0
"""A push comes at a time drawn from as long as this, from its usual time on: it meets no phase of the gait in
particular."""

USUAL: Final = {
    "friction": (0.5, 1.0),
    "restitution": (0.0, 0.3),
    "softness": (0.02, 0.04),
    "slope": (-4.0, 4.0),
    "side-slope": (-2.0, 2.0),
    "payload": (0.0, 2.0),
    "com-x": (-0.03, 0.03),
    "com-y": (-0.015, 0.015),
    "motor-strength": (0.85, 1.1),
    "top-speed": (24.0, 40.0),
    "delay": (0.0, 0.004),
    "joint-friction": (0.0, 0.4),
    "joint-damping": (0.0, 0.04),
    "push": (-5.0, 5.0),
    "side-push": (-1.5, 1.5),
}
"""By disturbance, what can be expected of a robot of this class on a floor, in the disturbance's unit: every
disturbance of which each robot of a MuJoCo batch may have a value of its own. The order of magnitude, not identified on
a robot."""


@dataclass(frozen=True)
class Range:
    """A disturbance drawn uniformly from a range, for each robot once.

    Attributes:
        name: one of `USUAL`.
        lower, upper: of the range, in the disturbance's unit.
    """

    name: str
    lower: float
    upper: float

    def __post_init__(self) -> None:
        kind = disturbance_named(self.name)
        if self.name not in USUAL:
            raise ConfigError(f"'{self.name}' cannot differ between robots; what can: {', '.join(USUAL)}")
        finite = math.isfinite(self.lower) and math.isfinite(self.upper)
        if not (finite and kind.lower <= self.lower <= self.upper <= kind.upper):
            raise ConfigError(
                f"'{self.name}' takes a range within {kind.show(kind.lower)} to {kind.show(kind.upper)}, found"
                f" {self.lower:g} to {self.upper:g}: {kind.about}"
            )

    @property
    def timed(self) -> bool:
        """Whether it happens at a time."""
        return DISTURBANCES[self.name].timed

    def __str__(self) -> str:
        unit = DISTURBANCES[self.name].unit
        return f"{self.name} {self.lower:g} … {self.upper:g} {unit}".strip()


def usual_range(name: str) -> Range:
    """A disturbance over its usual range.

    Raises:
        ConfigError: there is no such disturbance, or it cannot differ between robots.
    """
    disturbance_named(name)
    return Range(name, *USUAL.get(name, (0.0, 0.0)))


def parse_range(text: str) -> Range:
    """A range from `name=lower:upper`, or a disturbance's usual one from its name.

    Raises:
        ConfigError: it does not read so, or there is no such disturbance or range.
    """
    found = re.fullmatch(r"\s*([\w-]+)\s*(?:=\s*([^:]+):([^:]+))?", text)
    try:
        if found is None:
            raise ValueError
        name, lower, upper = found.groups()
        return usual_range(name) if lower is None else Range(name, float(lower), float(upper))
    except ValueError:
        name = re.match(r"\s*([\w-]*)", text)[1]  # type: ignore[index]  # it matches anything
        raise ConfigError(
            f"a range is written name=lower:upper, such as friction=0.4:1.2, or name for the usual one; found '{text}'."
            f" There are {', '.join(USUAL)}{did_you_mean(name, USUAL)}"
        ) from None


def check_once(ranges: Sequence[Range]) -> None:
    """Raises `ConfigError` if a disturbance has two ranges."""
    names = [r.name for r in ranges]
    for name in names:
        if names.count(name) > 1:
            raise ConfigError(f"the range of '{name}' is given twice")


def draw(
    ranges: Sequence[Range], n: int, rng: np.random.Generator, *, nominal_first: bool = False
) -> tuple[Disturbance, ...]:
    """Draws n robots by a Latin hypercube: of as many equal parts of each range as robots are drawn, each has one, so
    that few robots are not all of one kind by chance.

    Args:
        ranges: of different disturbances.
        n: how many robots.
        rng: random generator.
        nominal_first: whether the first robot is undisturbed, and only the others are drawn.

    Returns:
        A disturbance for each range, of n values; pushes all at one time.
    """
    first = int(nominal_first)
    found = []
    for r in ranges:
        drawn = n - first
        share = (rng.permutation(drawn) + rng.uniform(size=drawn)) / drawn
        values = np.minimum(r.lower + (r.upper - r.lower) * share, r.upper)
        at_s = PUSH_TIME_S + PUSH_WINDOW_S * float(rng.uniform()) if r.timed else None
        nominal = (DISTURBANCES[r.name].nominal,) * first
        found.append(Disturbance(r.name, (*nominal, *values.tolist()), at_s))
    return tuple(found)


def repeated(robots: Sequence[Disturbance], times: int) -> tuple[Disturbance, ...]:
    """The same robots over and over: those of the first round, then those of the second."""
    return tuple(replace(d, values=d.values * times) for d in robots)


def part(robots: Sequence[Disturbance], rows: slice) -> tuple[Disturbance, ...]:
    """Some of the robots."""
    return tuple(replace(d, values=d.values[rows]) for d in robots)
