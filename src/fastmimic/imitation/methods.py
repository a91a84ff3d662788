"""The methods to compare: which controller follows the motion, and which parameters of the motion are optimised.

A method differs from its neighbour only in the feature that its name gives; gains, gait planner, online adaptation and
demonstration are the same for all (paper, §IV-B). `fastmimic.control.config.CONFIGS` decides separately whether the
controller has the paper's form.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any, Final

from fastmimic.base.configuration import changed
from fastmimic.base.errors import ConfigError, unknown
from fastmimic.base.files import packaged
from fastmimic.base.registry import Registry
from fastmimic.control.config import CONFIGS, ControllerConfig, controller_config
from fastmimic.motion.motion import Motion
from fastmimic.motion.provenance import MadeWith
from fastmimic.optimize.parameters import PARAMETER_GROUPS

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
    hatch: str = "--"  # of its bars, one of Matplotlib's

    def __post_init__(self) -> None:
        known = (NOTHING, *PARAMETER_GROUPS)
        if self.parameters not in known:
            raise ConfigError(f"method '{self.name}': {unknown('parameters', self.parameters, known)}")
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


RL: Final = "rl"


def _built_in(said: dict[str, Any]) -> Method:
    """A method of `methods.json`, which has `changes` nested like the configuration for `change`."""
    changes = said.pop("changes", None)
    change = None if changes is None else partial(changed, changes=changes, where=f"method '{said['name']}'")
    return Method(**said, change=change)


METHODS: Final = Registry(
    "method", map(_built_in, packaged("fastmimic.imitation", "methods.json", list[dict[str, Any]]))
)
"""All methods; `METHODS.register(Method(…))` adds one. Raibert's stance leaves out two things: the robot's legs do not
receive the animal's ground reaction forces, and the regulator would count on its footholds. Colours are those of Okabe
and Ito, each with a hatch so that bars read in grey."""
PAPER_METHODS: Final = ("raibert", "mbc", "lh", "mbc-dmp", "lh-dmp")
"""Methods that need only the motion, in the order of the paper's figure."""


def check_controller(method: Method, given: bool) -> None:
    """Raises `ConfigError` if a policy is given to a method without one, or missing for a method that needs one."""
    if method.learned and not given:
        raise ConfigError(
            f"method '{method.name}' needs a trained policy: give one to 'fastmimic evaluate' or 'fastmimic compare'"
            " with --policy FILE; 'fastmimic train' makes it"
        )
    if given and not method.learned:
        raise ConfigError(f"method '{method.name}' does not use a policy; drop --policy")


def made_with(motion: Motion, method: str, config: ControllerConfig) -> Motion:
    """An optimised motion (a demonstration records no method) with its method and settings in its provenance. Of
    `config`, with the method's changes, only the name of its set is kept; None if it equals no set."""
    same = config.name in CONFIGS and METHODS[method].configure(CONFIGS[config.name]) == config
    record = MadeWith(method, config.name if same else None)
    return replace(motion, provenance=replace(motion.provenance, made_with=record))


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
    chosen = METHODS[record.method if method is None else method]
    return chosen, chosen.configure(config)
