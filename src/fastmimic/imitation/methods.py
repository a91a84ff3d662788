"""The methods to compare: which controller follows the motion, and which parameters of the motion are optimised.

A method differs from its neighbour only in the feature that its name gives; gains, gait planner, online adaptation and
demonstration are the same for all (paper, §IV-B). `fastmimic.control.config.CONFIGS` decides separately whether the
controller has the paper's form.
"""

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import msgspec

from fastmimic.base.errors import ConfigError
from fastmimic.base.registry import Registry
from fastmimic.control.config import CONFIGS, ControllerConfig, controller_config
from fastmimic.motion.motion import Motion
from fastmimic.motion.provenance import MadeWith, RandomizationRecord
from fastmimic.optimize.parameters import FEET_AND_TRUNK, FOOT_HEIGHT, FOOT_PATH, PARAMETER_GROUPS
from fastmimic.optimize.randomization import Randomization

if TYPE_CHECKING:  # loads the compiler
    from fastmimic.episode.loop import MakeController

NOTHING: Final = "none"  # `Method.parameters` of a method without a search
ConfigChange = Callable[[ControllerConfig], ControllerConfig]


@dataclass(frozen=True)
class Method:
    """A way to make a robot imitate a motion."""

    name: str
    label: str
    summary: str
    parameters: str = NOTHING  # that, or one of `fastmimic.optimize.parameters.PARAMETER_GROUPS`
    change: ConfigChange | None = None  # of the controller's configuration
    controller: "MakeController | None" = None  # makes a controller in place of the model-based one
    own_feet: bool = False  # whether the swing feet follow the method's own path instead of the motion's
    learned: bool = False  # whether it needs a trained policy
    base: str = ""  # name of the method that runs the motion before it is optimised; empty for the method itself
    playable: bool = False  # whether a live session offers it
    color: str = "#999999"
    dark_color: str = ""  # on a dark page; empty for `color`
    hatch: str = "--"  # of its bars, one of Matplotlib's
    symbol: str = "circle"  # of its points, one of Plotly's

    def __post_init__(self) -> None:
        known = (NOTHING, *PARAMETER_GROUPS)
        if self.parameters not in known:
            raise ConfigError(
                f"method '{self.name}': unknown parameters '{self.parameters}'; there are {', '.join(known)}"
            )
        if self.controller is not None and (self.optimises or self.learned):
            raise ConfigError(f"method '{self.name}' has a controller of its own, so it cannot optimise or be learned")

    @property
    def optimises(self) -> bool:
        """Whether it optimises anything; otherwise it is deterministic."""
        return self.parameters != NOTHING

    @property
    def unoptimised(self) -> "Method":
        """The method that runs the motion before it is optimised."""
        return METHODS[self.base or self.name]

    def configure(self, config: ControllerConfig | str) -> ControllerConfig:
        """The controller parameters, given or by name, with the method's changes."""
        given = controller_config(config) if isinstance(config, str) else config
        return given if self.change is None else self.change(given)


def _raibert(config: ControllerConfig) -> ControllerConfig:
    # the robot's legs do not receive the animal's ground reaction forces; the regulator would count on its footholds
    stance = dataclasses.replace(config.stance, leg_momentum=False, feedback="constant")
    return dataclasses.replace(config, stance=stance, swing=dataclasses.replace(config.swing, foothold="raibert"))


def _horizon(config: ControllerConfig) -> ControllerConfig:
    return dataclasses.replace(config, stance=dataclasses.replace(config.stance, forces="horizon"))


RL: Final = "rl"

METHODS: Final = Registry(
    "method",
    (  # colours of Okabe and Ito, each with a hatch so that bars read in grey
        Method(
            RL,
            "RL",
            "a policy trained for the motion (Peng et al. 2018, 2020)",
            own_feet=True,
            learned=True,
            color="#009e73",
            dark_color="#20b98c",
            hatch="..",
            symbol="cross",
        ),
        Method(
            "raibert",
            "Raibert",
            "the animal's trunk, and feet that swing straight to the Raibert foothold (Kang et al. 2021)",
            change=_raibert,
            own_feet=True,
            playable=True,
            color="#e69f00",
            dark_color="#e9b23c",
            hatch="//",
            symbol="square",
        ),
        Method(
            "mbc",
            "MBC",
            "the model-based controller follows the retargeted motion",
            playable=True,
            color="#d55e00",
            dark_color="#e8792c",
            hatch="",
            symbol="triangle-up",
        ),
        Method(
            "lh",
            "LH",
            "mbc with long-horizon forces (Di Carlo et al. 2018)",
            change=_horizon,
            playable=True,
            color="#cc79a7",
            dark_color="#d890b6",
            hatch="\\\\",
            symbol="triangle-down",
        ),
        Method(
            "mbc-dmp",
            "MBC-DMP",
            "mbc after its motion's DMPs were optimised (the paper's method)",
            FOOT_HEIGHT,
            base="mbc",
            color="#0072b2",
            dark_color="#3d97d6",
            hatch="",
            symbol="diamond",
        ),
        Method(
            "lh-dmp",
            "LH-DMP",
            "lh after its motion's DMPs were optimised",
            FOOT_HEIGHT,
            _horizon,
            base="lh",
            color="#56b4e9",
            dark_color="#8fd0f5",
            hatch="xx",
            symbol="star",
        ),
        Method(
            "mbc-dmp-path",
            "MBC-DMP, 24",
            "mbc-dmp that moves the feet's whole paths: 24 parameters",
            FOOT_PATH,
            base="mbc",
            color="#f0e442",
        ),
        Method(
            "mbc-dmp-body",
            "MBC-DMP, 26",
            "mbc-dmp-path that also moves the trunk's height and pitch: 26 parameters",
            FEET_AND_TRUNK,
            base="mbc",
            color="#000000",
            hatch="..",
        ),
    ),
)
"""All methods. `METHODS.register(Method(…))` adds one."""
PAPER_METHODS: Final = ("raibert", "mbc", "lh", "mbc-dmp", "lh-dmp")
"""Methods that need only the motion, in the order of the paper's figure."""


def method_named(name: str) -> Method:
    """The method of that name; otherwise raises `ConfigError` with the list of names."""
    return METHODS[name]


def check_controller(method: Method, given: bool) -> None:
    """Raises `ConfigError` if a policy is given to a method without one, or missing for a method that needs one."""
    if method.learned and not given:
        raise ConfigError(
            f"method '{method.name}' needs a trained policy: give one to 'fastmimic evaluate' or 'fastmimic compare'"
            " with --policy FILE; 'fastmimic train' makes it"
        )
    if given and not method.learned:
        raise ConfigError(f"method '{method.name}' does not use a policy; drop --policy")


def made_with(
    motion: Motion, method: str, config: ControllerConfig, randomization: Randomization | None = None
) -> Motion:
    """An optimised motion (a demonstration records no method) with its method and settings in its provenance. Of
    `config`, with the method's changes, only the name of its set is kept; None if it equals no set."""
    same = config.name in CONFIGS and method_named(method).configure(CONFIGS[config.name]()) == config
    over = None if randomization is None else msgspec.convert(randomization.as_dict(), RandomizationRecord)
    record = MadeWith(method, config.name if same else None, over)
    return dataclasses.replace(motion, provenance=dataclasses.replace(motion.provenance, made_with=record))


def controller_for(
    motion: Motion, method: str | None = None, config: ControllerConfig | str | None = None
) -> tuple[Method, ControllerConfig]:
    """The method for running a motion, and the controller's parameters with its changes. `method` is one of `METHODS`,
    `config` the parameters or the name of a set; None for the motion's own, or if it records none mbc and "default".
    Raises `ConfigError` for an unknown name, or a motion made with parameters of no set if none are given."""
    record = motion.provenance.made_with or MadeWith("mbc", "default")
    config = record.config if config is None else config
    if config is None:
        raise ConfigError(
            f"motion '{motion.name}' was optimised with controller parameters of its own, which it does not carry;"
            f" give the configuration to run it with ({', '.join(CONFIGS)}, or from Python the same parameters)"
        )
    chosen = method_named(record.method if method is None else method)
    return chosen, chosen.configure(config)
