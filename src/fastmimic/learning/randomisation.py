"""In what the robots of a training differ: disturbances drawn for each robot from a range."""

import dataclasses
import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fastmimic.errors import ConfigError
from fastmimic.simulation.disturbances import DISTURBANCES, Disturbance, disturbance_named


@dataclass(frozen=True)
class Randomisation:
    """A disturbance drawn uniformly from a range, for each robot once.

    Attributes:
        name: one of `fastmimic.simulation.disturbances.DISTURBANCES` that is there all the time.
        lower, upper: of the range, in its unit.
    """

    name: str
    lower: float
    upper: float

    def __post_init__(self) -> None:
        kind = disturbance_named(self.name)
        if self.name not in _possible():
            raise ConfigError(f"'{self.name}' cannot differ between robots; what can: {', '.join(_possible())}")
        if not kind.lower <= self.lower <= self.upper <= kind.upper:
            raise ConfigError(
                f"'{self.name}' takes a range within {kind.show(kind.lower)} to {kind.show(kind.upper)}, found"
                f" {self.lower:g} to {self.upper:g}: {kind.about}"
            )


@dataclass(frozen=True)
class RandomWorld:
    """The disturbances of n robots, each with n values."""

    disturbances: tuple[Disturbance, ...]

    def part(self, rows: slice) -> "RandomWorld":
        """Some of the robots'."""
        return RandomWorld(tuple(dataclasses.replace(d, values=d.values[rows]) for d in self.disturbances))


def random_world(randomise: Sequence[Randomisation], n: int, rng: np.random.Generator) -> RandomWorld:
    """Draws the disturbances of n robots.

    Raises:
        ConfigError: one is given twice.
    """
    names = [r.name for r in randomise]
    for name in names:
        if names.count(name) > 1:
            raise ConfigError(f"the range of '{name}' is given twice")
    return RandomWorld(tuple(Disturbance(r.name, tuple(rng.uniform(r.lower, r.upper, n).tolist())) for r in randomise))


def parse_randomisation(text: str) -> Randomisation:
    """A range from `name=lower:upper`.

    Raises:
        ConfigError: it does not read so, or there is no such disturbance or range.
    """
    found = re.fullmatch(r"\s*([\w-]+)\s*=\s*([^:]+):([^:]+)", text)
    try:
        if found is None:
            raise ValueError
        return Randomisation(found[1], float(found[2]), float(found[3]))
    except ValueError:
        raise ConfigError(
            f"a range is written name=lower:upper, such as friction=0.4:1.2; found '{text}'. There are"
            f" {', '.join(_possible())}"
        ) from None


def _possible() -> list[str]:
    """A delay is left out, because the commands under way are no part of the state that a training resumes from."""
    return [
        name
        for name, kind in DISTURBANCES.items()
        if kind.per_robot and not kind.timed and "mujoco" in kind.simulators and name != "delay"
    ]
