"""Which parameters of a motion's DMPs can be optimised, in groups: the paper's eight (§III-C), and more; and how a
search chooses its result among its best candidates."""

from collections.abc import Iterable
from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING, Any, Final

from fastmimic.base.conventions import LEGS
from fastmimic.base.errors import ConfigError, MotionError, unknown

if TYPE_CHECKING:  # loads the compiler
    from fastmimic.primitive import MotionDmp

FOOT_HEIGHT: Final = "foot-height"
FOOT_PATH: Final = "foot-path"
FEET_AND_TRUNK: Final = "feet-and-trunk"

_GOAL, _AMPLITUDE = "goal", "amplitude"


@dataclass(frozen=True)
class Parameter:
    """One number that the optimiser varies, such as `FR_foot_z.goal` or `FR_foot_z.amplitude`, in its `unit`, "m",
    "rad" or "1". `initial` is the value of the unmodulated motion."""

    name: str
    unit: str
    lower: float
    upper: float
    initial: float

    def __post_init__(self) -> None:
        if not self.lower < self.upper or not self.lower <= self.initial <= self.upper:
            raise ConfigError(f"parameter {self.name}: {self.initial:g} is not within [{self.lower:g}, {self.upper:g}]")


def _goals(dimensions: Iterable[str], unit: str, each_way: float) -> tuple[Parameter, ...]:
    """Baselines, relative to the fitted ones."""
    return tuple(Parameter(f"{name}.{_GOAL}", unit, -each_way, each_way, 0.0) for name in dimensions)


def _amplitudes(dimensions: Iterable[str], lower: float, upper: float) -> tuple[Parameter, ...]:
    return tuple(Parameter(f"{name}.{_AMPLITUDE}", "1", lower, upper, 1.0) for name in dimensions)


_UP: Final = [f"{leg}_foot_z" for leg in LEGS]
_ALONG: Final = [f"{leg}_foot_{axis}" for leg in LEGS for axis in "xy"]
_HEIGHTS: Final = (*_goals(_UP, "m", 0.03), *_amplitudes(_UP, 0.7, 1.8))
_PATHS: Final = (*_HEIGHTS, *_goals(_ALONG, "m", 0.03), *_amplitudes(_ALONG, 0.8, 1.2))
_TRUNK: Final = (*_goals(["root_z"], "m", 0.03), *_goals(["root_pitch"], "rad", 0.1))

PARAMETER_GROUPS: Final = {
    FOOT_HEIGHT: _HEIGHTS,  # the paper's eight: g and a of the z dimension of each foot's DMP
    FOOT_PATH: _PATHS,  # 24: g and a of all dimensions of the feet
    FEET_AND_TRUNK: (*_PATHS, *_TRUNK),  # 26: and g of the trunk's height and pitch
}
"""Parameters by group, goals relative to fitted ones; each group holds all of those before it. Add one to open more."""


def parameters_of_group(group: str, dmp: "MotionDmp") -> tuple[Parameter, ...]:
    """The parameters of a group for this motion; raises `ConfigError` if there is no such group."""
    _check_group(group)
    found = []
    for known in PARAMETER_GROUPS[group]:
        dimension, kind = known.name.split(".")
        if kind == _GOAL:
            g = float(dmp.goal[dmp.index(dimension)])
            known = replace(known, lower=g + known.lower, upper=g + known.upper, initial=g)
        found.append(known)
    return tuple(found)


def needed_group(group: str, *started: Iterable[str]) -> str:
    """The group, or the first after it with all these parameters; raises `ConfigError`, `MotionError` if none has."""
    _check_group(group)
    wanted = set().union(*started)
    names = list(PARAMETER_GROUPS)
    for candidate in names[names.index(group) :]:
        known = {parameter.name for parameter in PARAMETER_GROUPS[candidate]}
        if wanted <= known:
            return candidate
    raise MotionError(f"a motion moves {', '.join(sorted(wanted - known))}, which no method optimises")


def _check_group(group: str) -> None:
    if group not in PARAMETER_GROUPS:
        raise unknown("parameters", group, PARAMETER_GROUPS)


@dataclass(frozen=True)
class FinalChoice:
    """The validation at the end of a search. It does not change the search, so checkpoints do not depend on it."""

    candidates: int = 8  # that compete for being the result
    episodes: int = 4  # of each; one begins at the motion's start, the others perturbed
    duration_s: float = 10.0  # of an episode

    @property
    def simulated_s(self) -> float:
        """Time to simulate for the validation, s."""
        return self.candidates * self.episodes * self.duration_s


class SearchSettings:
    """What dataclasses of settings with a `choice` have in common."""

    choice: FinalChoice

    def as_dict(self) -> dict[str, Any]:
        """Plain values, JSON-serialisable; `choice` only if it is not the usual one."""
        found = asdict(self)  # type: ignore[call-overload]
        if self.choice == FinalChoice():
            del found["choice"]
        return dict(found)
