"""Settings of the optimisation and evaluation of all motions of a library."""

import hashlib
import json
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Final

from fastmimic.base.errors import ConfigError
from fastmimic.control.config import CONFIGS, controller_config
from fastmimic.imitation.methods import RL, method_named
from fastmimic.optimize.cma_es import CmaSettings
from fastmimic.optimize.final_choice import FinalChoice
from fastmimic.optimize.problem import Objective
from fastmimic.optimize.randomization import Randomization

HELD_OUT: Final = 16
SECOND_SIMULATOR_EPISODES: Final = 3


@dataclass(frozen=True)
class BuildSettings:
    """Settings of all jobs of a library.

    Attributes:
        config: name of the controller's parameters, or their file.
        duration_s: length of the search's episodes, s.
        evaluation_s: length of the evaluation's episodes, s.
        perturbed: number of evaluation episodes from perturbed starts.
        others: number of other robots in the evaluation, with floors, loads and motors from the usual ranges.
        second_simulator: whether to evaluate in PyBullet, if it knows the robot.
        choice: how a search chooses its result.
    """

    method: str = "mbc-dmp"
    config: str = "default"
    duration_s: float = 5.0
    iterations: int = 200
    population: int = 10
    evaluation_s: float = 10.0
    perturbed: int = 8
    others: int = HELD_OUT
    second_simulator: bool = True
    choice: FinalChoice = FinalChoice()

    def __post_init__(self) -> None:
        if method_named(self.method).name == RL:
            raise ConfigError("a library's motions are made by a model-based method; a policy is not one motion")
        controller_config(self.config)
        if self.config not in CONFIGS:  # an absolute path, valid in any process
            object.__setattr__(self, "config", str(Path(self.config).resolve()))
        CmaSettings(self.iterations, self.population)
        Objective(self.duration_s)
        for name, least in (("perturbed", 1), ("others", 0)):
            if getattr(self, name) < least:
                raise ConfigError(f"{name} must be at least {least}, found {getattr(self, name)}")
        if not self.evaluation_s > 0:
            raise ConfigError(f"the length of an episode must be positive, found {self.evaluation_s}")

    def as_dict(self) -> dict[str, Any]:
        """Plain values, JSON-serialisable; `choice` only if it is not the usual one."""
        found = asdict(self)
        if self.choice == FinalChoice():
            del found["choice"]
        return found

    @cached_property
    def digest(self) -> str:
        """16 hexadecimal digits of all settings, including the content of a parameter file."""
        config = self.config if self.config in CONFIGS else "a file"
        said = {**self.as_dict(), "config": config, "over": Randomization().as_dict()["over"]}
        return _digest({**self._search(), **said})

    @cached_property
    def search_digest(self) -> str:
        """Digest of a search's settings without its length: a longer search resumes a shorter one's checkpoint."""
        return _digest(self._search())

    def _search(self) -> dict[str, Any]:
        method = method_named(self.method)
        return {
            "method": method.name,
            "parameters": method.parameters,
            "controller": method.configure(controller_config(self.config)).as_dict(),
            "objective": Objective(self.duration_s).as_dict(),
            "population": self.population,
        }


def _digest(said: dict[str, Any]) -> str:
    return hashlib.sha256(json.dumps(said, sort_keys=True).encode()).hexdigest()[:16]
