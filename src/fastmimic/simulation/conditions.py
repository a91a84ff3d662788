"""What a robot meets and what its controller sees: the choices of an evaluation, in one place."""

from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np

from fastmimic.base.errors import ConfigError, did_you_mean
from fastmimic.estimation.config import EstimatorConfig
from fastmimic.simulation.disturbances import Disturbance, parse_disturbance
from fastmimic.simulation.sensors import SensorConfig

SIMULATORS: Final = ("mujoco", "pybullet")
OBSERVED: Final = ("truth", "sensors")


@dataclass(frozen=True)
class Conditions:
    """Under which conditions episodes run. The defaults are those under which motions are optimised.

    Attributes:
        simulator: one of `SIMULATORS`.
        observe: what the controller is told: "truth" for the simulator's state, "sensors" for what an estimator makes
            of noisy, biased and late sensors.
        seed: of all that is random: sensors and disturbances. Episode i draws from its own stream, so it does not
            depend on which and how many others run beside it.
        disturbances: what makes the robot or the ground another than those of the optimisation; texts such as
            "payload=2" are read as on the command line.
        sensors, estimator: their parameters where `observe` is "sensors".
    """

    simulator: str = "mujoco"
    observe: str = "truth"
    seed: int = 0
    disturbances: tuple[Disturbance, ...] = ()
    sensors: SensorConfig = field(default_factory=SensorConfig)
    estimator: EstimatorConfig = field(default_factory=EstimatorConfig)

    def __post_init__(self) -> None:
        for what, value, known in (("simulator", self.simulator, SIMULATORS), ("observation", self.observe, OBSERVED)):
            if value not in known:
                raise ConfigError(f"unknown {what} '{value}'; there are {', '.join(known)}{did_you_mean(value, known)}")
        if self.seed < 0:
            raise ConfigError(f"seed must not be negative, found {self.seed}")
        given: tuple[Any, ...] = self.disturbances
        read = tuple(parse_disturbance(d) if isinstance(d, str) else d for d in given)
        object.__setattr__(self, "disturbances", read)


def episode_generator(seed: int, episode: int, purpose: int) -> np.random.Generator:
    """The random stream of one episode for one purpose (each user of randomness has a number of its own)."""
    return np.random.default_rng(np.random.SeedSequence([seed, episode, purpose]))
