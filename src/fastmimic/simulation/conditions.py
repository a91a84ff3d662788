"""The conditions of episodes: simulator, disturbances, and what the controller observes; random streams and ground."""

from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np

from fastmimic.base.arrays import Array
from fastmimic.base.errors import ConfigError, unknown
from fastmimic.estimation.config import EstimatorConfig
from fastmimic.simulation.disturbances import Disturbance, parse_disturbance
from fastmimic.simulation.sensors import SensorConfig
from fastmimic.simulation.simulators import SIMULATORS

OBSERVED: Final = ("truth", "sensors")

CELL_M: Final = 0.15
CELLS: Final = 400  # on each side: 60 m; episodes begin in the middle, and a robot that leaves the field falls
HALF_SIDE_M: Final = CELL_M * CELLS / 2
_FLAT_RADIUS_M: Final = 0.45
_FULL_RADIUS_M: Final = 0.9
_GROUND_PURPOSE: Final = 71  # of the random stream
_TURN_PURPOSE: Final = 72


@dataclass(frozen=True)
class Conditions:
    """The conditions of episodes. The defaults are those of the optimisation.

    Attributes:
        simulator: one of `SIMULATORS`.
        observe: "truth" for the simulator's state, "sensors" for an estimate from noisy, biased and late sensors.
        seed: of sensors and disturbances. Each episode has its own random stream, independent of the others in a batch.
        disturbances: deviations from robot and ground of the optimisation, as objects or texts such as "payload=2".
        sensors, estimator: used where `observe` is "sensors".
    """

    simulator: str = "mujoco"
    observe: str = "truth"
    seed: int = 0
    disturbances: tuple[Disturbance, ...] = ()
    sensors: SensorConfig = field(default_factory=SensorConfig)
    estimator: EstimatorConfig = field(default_factory=EstimatorConfig)

    def __post_init__(self) -> None:
        _ = SIMULATORS[self.simulator]
        if self.observe not in OBSERVED:
            raise unknown("observation", self.observe, OBSERVED)
        if self.seed < 0:
            raise ConfigError(f"seed must not be negative, found {self.seed}")
        given: tuple[Any, ...] = self.disturbances
        read = tuple(parse_disturbance(d) if isinstance(d, str) else d for d in given)
        object.__setattr__(self, "disturbances", read)


def episode_generator(seed: int, episode: int, purpose: int) -> np.random.Generator:
    """The random stream of one episode for one purpose (each user of randomness has its own number)."""
    return np.random.default_rng(np.random.SeedSequence([seed, episode, purpose]))


def rough_ground(roughness: float, seed: int) -> Array:
    """Uneven ground: heights (m) at the corners of the cells, (CELLS + 1, CELLS + 1), rows along y, columns along x.
    Uniform in ± `roughness`; zero within 0.45 m of the middle, where episodes begin, rising to full height at 0.9 m."""
    heights = episode_generator(seed, 0, _GROUND_PURPOSE).uniform(-roughness, roughness, (CELLS + 1, CELLS + 1))
    along = np.linspace(-HALF_SIDE_M, HALF_SIDE_M, CELLS + 1)
    radius = np.hypot(along[:, None], along[None])
    return heights * np.clip((radius - _FLAT_RADIUS_M) / (_FULL_RADIUS_M - _FLAT_RADIUS_M), 0.0, 1.0)


def turns(n: int, seed: int) -> Array:
    """Turn of the field about its middle for each episode, (n,) rad: each crosses different ground."""
    return np.array([episode_generator(seed, i, _TURN_PURPOSE).uniform(-np.pi, np.pi) for i in range(n)])
