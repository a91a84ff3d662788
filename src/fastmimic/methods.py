"""The methods that can be compared: which controller follows the motion, and what of the motion is optimised.

Each differs from its neighbour only in what its name claims; the gains, the gait planner, the online adaptation and the
demonstration are the same for all (paper, §IV-B). Whether the controller has the paper's form is another question:
see `fastmimic.control.config.CONFIGS`.
"""

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

from fastmimic.control.config import ControllerConfig
from fastmimic.errors import ConfigError, did_you_mean

NOTHING: Final = "none"
FOOT_HEIGHT: Final = "foot-height"
PARAMETER_GROUPS: Final = (NOTHING, FOOT_HEIGHT)
"""What may be optimised: nothing, or the paper's eight parameters: g and a of the four feet's z."""


@dataclass(frozen=True)
class Method:
    """A way to make a robot imitate a motion.

    Attributes:
        name: as on the command line.
        label: as in figures.
        summary: one line.
        parameters: what is optimised, one of `PARAMETER_GROUPS`.
        change: what it changes in the controller's configuration.
        own_feet: whether the swing feet follow the method's own path instead of the motion's.
    """

    name: str
    label: str
    summary: str
    parameters: str
    change: Callable[[ControllerConfig], ControllerConfig]
    own_feet: bool = False

    def __post_init__(self) -> None:
        if self.parameters not in PARAMETER_GROUPS:
            raise ConfigError(
                f"method '{self.name}': unknown parameters '{self.parameters}'; there are {', '.join(PARAMETER_GROUPS)}"
            )

    @property
    def optimises(self) -> bool:
        """Whether anything is optimised; without it the method is deterministic."""
        return self.parameters != NOTHING

    def configure(self, config: ControllerConfig) -> ControllerConfig:
        """The method's controller, made of the given one."""
        return self.change(config)


def _same(config: ControllerConfig) -> ControllerConfig:
    return config


def _raibert(config: ControllerConfig) -> ControllerConfig:
    # what the animal's legs take from the ground is not what these take
    stance = dataclasses.replace(config.stance, leg_momentum=False)
    return dataclasses.replace(config, stance=stance, swing=dataclasses.replace(config.swing, foothold="raibert"))


def _horizon(config: ControllerConfig) -> ControllerConfig:
    return dataclasses.replace(config, stance=dataclasses.replace(config.stance, forces="horizon"))


_METHODS = (
    Method(
        "raibert",
        "Raibert",
        "the animal's trunk; feet swing straight to the Raibert foothold (Kang et al. 2021)",
        NOTHING,
        _raibert,
        own_feet=True,
    ),
    Method("mbc", "MBC", "the model-based controller follows the retargeted motion", NOTHING, _same),
    Method("lh", "LH", "the same with long-horizon forces (Di Carlo et al. 2018)", NOTHING, _horizon),
    Method("mbc-dmp", "MBC-DMP", "mbc after its motion's DMPs were optimised (the paper's method)", FOOT_HEIGHT, _same),
    Method("lh-dmp", "LH-DMP", "lh after its motion's DMPs were optimised", FOOT_HEIGHT, _horizon),
)

METHODS: Final = {method.name: method for method in _METHODS}
"""All methods by name, in the order of the paper's figure."""


def method_named(name: str) -> Method:
    """The method of that name.

    Raises:
        ConfigError: there is none; the message lists them.
    """
    if name not in METHODS:
        raise ConfigError(f"unknown method '{name}'; there are {', '.join(METHODS)}{did_you_mean(name, METHODS)}")
    return METHODS[name]
