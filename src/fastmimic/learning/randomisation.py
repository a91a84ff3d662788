"""In what the robots of a training differ: disturbances drawn for each robot from a range."""

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fastmimic.base.errors import ConfigError
from fastmimic.simulation.disturbances import DISTURBANCES, Disturbance, disturbance_named
from fastmimic.simulation.ranges import USUAL, Range, check_once, part


@dataclass(frozen=True)
class Randomisation(Range):
    """A range of a disturbance that is there all the time."""

    def __post_init__(self) -> None:
        disturbance_named(self.name)
        if self.name not in _possible():
            raise ConfigError(f"'{self.name}' cannot differ between robots; what can: {', '.join(_possible())}")
        super().__post_init__()


@dataclass(frozen=True)
class RandomWorld:
    """The disturbances of n robots, each with n values."""

    disturbances: tuple[Disturbance, ...]

    def part(self, rows: slice) -> "RandomWorld":
        """Some of the robots'."""
        return RandomWorld(part(self.disturbances, rows))


def random_world(randomize: Sequence[Randomisation], n: int, rng: np.random.Generator) -> RandomWorld:
    """Draws the disturbances of n robots.

    Raises:
        ConfigError: one is given twice.
    """
    check_once(randomize)
    return RandomWorld(tuple(Disturbance(r.name, tuple(rng.uniform(r.lower, r.upper, n).tolist())) for r in randomize))


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
    return [name for name in USUAL if not DISTURBANCES[name].timed and name != "delay"]
