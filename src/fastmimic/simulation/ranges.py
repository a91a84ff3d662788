"""Randomised robots: disturbances drawn for each robot of a batch from a range."""

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from fastmimic.base.errors import ConfigError, did_you_mean
from fastmimic.simulation.disturbance_kinds import DISTURBANCES, PUSH_TIME_S
from fastmimic.simulation.disturbances import Disturbance

PUSH_WINDOW_S: Final = 1.0  # length of the window of push times after the usual time: any phase of the gait


@dataclass(frozen=True)
class Range:
    """A disturbance drawn uniformly from a range, once for each robot; bounds are in the disturbance's unit."""

    name: str
    lower: float
    upper: float

    def __post_init__(self) -> None:
        kind = DISTURBANCES[self.name]
        if kind.usual is None:
            raise ConfigError(f"'{self.name}' cannot differ between robots; what can: {', '.join(usual_ranges())}")
        finite = math.isfinite(self.lower) and math.isfinite(self.upper)
        if not (finite and kind.lower <= self.lower <= self.upper <= kind.upper):
            raise ConfigError(
                f"'{self.name}' takes a range within {kind.show(kind.lower)} to {kind.show(kind.upper)}, found"
                f" {self.lower:g} to {self.upper:g}: {kind.about}"
            )

    @property
    def timed(self) -> bool:
        return DISTURBANCES[self.name].timed

    def __str__(self) -> str:
        unit = DISTURBANCES[self.name].unit
        return f"{self.name} {self.lower:g} … {self.upper:g} {unit}".strip()


def usual_ranges() -> dict[str, tuple[float, float]]:
    """Usual lower and upper value by name, of all disturbances in which the robots of a batch can differ."""
    return {name: kind.usual for name, kind in DISTURBANCES.items() if kind.usual is not None}


def usual_range(name: str) -> Range:
    """A disturbance over its usual range; raises `ConfigError` if it is unknown or robots cannot differ in it."""
    return Range(name, *(DISTURBANCES[name].usual or (0.0, 0.0)))


def parse_range(text: str) -> Range:
    """A range from `name=lower:upper`, or the usual one from its name; raises `ConfigError` for anything else."""
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
            f" There are {', '.join(usual_ranges())}{did_you_mean(name, usual_ranges())}"
        ) from None


def check_once(ranges: Sequence[Range]) -> None:
    """Raises `ConfigError` if a disturbance has two ranges."""
    names = [r.name for r in ranges]
    for name in names:
        if names.count(name) > 1:
            raise ConfigError(f"the range of '{name}' is given twice")


def check_lasting(ranges: Sequence[Range]) -> None:
    """Checks ranges for a training, which can be resumed at any step; raises `ConfigError` if a disturbance has two
    ranges, happens at a time, or is a delay (commands under way are not part of the training's state)."""
    check_once(ranges)
    possible = [name for name in usual_ranges() if not DISTURBANCES[name].timed and name != "delay"]
    for r in ranges:
        if r.name not in possible:
            raise ConfigError(f"'{r.name}' cannot differ between robots; what can: {', '.join(possible)}")


def draw_uniform(ranges: Sequence[Range], n: int, rng: np.random.Generator) -> tuple[Disturbance, ...]:
    """Draws n robots independently of each other; raises as `check_lasting`."""
    check_lasting(ranges)
    return tuple(Disturbance(r.name, tuple(rng.uniform(r.lower, r.upper, n).tolist())) for r in ranges)


def draw(
    ranges: Sequence[Range], n: int, rng: np.random.Generator, *, nominal_first: bool = False
) -> tuple[Disturbance, ...]:
    """Draws n robots by a Latin hypercube: one from each of n equal parts of each range, so that few robots spread. The
    ranges are of different disturbances. With `nominal_first` the first robot is undisturbed and only the others are
    drawn. Returns a disturbance of n values for each range; pushes all come at one time."""
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
    """The same robots `times` over, round after round."""
    return tuple(replace(d, values=d.values * times) for d in robots)


def part(robots: Sequence[Disturbance], rows: slice) -> tuple[Disturbance, ...]:
    """Some of the robots."""
    return tuple(replace(d, values=d.values[rows]) for d in robots)
