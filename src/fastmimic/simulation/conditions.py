"""The conditions of episodes: simulator, disturbances, and what the controller observes."""

from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np

from fastmimic.base.errors import ConfigError, unknown
from fastmimic.estimation.config import EstimatorConfig
from fastmimic.simulation.disturbances import Disturbance, parse_disturbance
from fastmimic.simulation.sensors import SensorConfig
from fastmimic.simulation.simulators import SIMULATORS

OBSERVED: Final = ("truth", "sensors")


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
