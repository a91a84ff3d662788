"""Settings as data: unit, range and meaning stand in the field's metadata, the source of everything else.

    @documented
    @dataclass(frozen=True)
    class GaitConfig:
        min_switch_time: float = parameter(0.1, unit="s", about="least time between two switches of a leg")

The metadata give the checks (`check`), the kernels' records (`record_fields`, `pack`), values read from files and the
command line (`changed`), the class's docstring (`documented`) and the documentation's tables. Those of a long class may
stand in its room's `parameters.json` (`tabulated`).
"""

import dataclasses
import math
import re
import textwrap
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Final, TypeVar

import numpy as np

from fastmimic.base.errors import ConfigError, did_you_mean
from fastmimic.base.files import packaged

_KEY: Final = "parameter"
_Kind = TypeVar("_Kind")


@dataclass(frozen=True)
class ParameterInfo:
    """Metadata of a field: bounds `low` and `high` inclusive, `above` and `below` exclusive; None for no bound."""

    about: str = ""  # its meaning
    unit: str = ""  # of its value; empty for a plain number
    low: float | None = 0.0
    high: float | None = None
    above: float | None = None
    below: float | None = None
    choices: tuple[Any, ...] = ()  # the possible values; empty for a number
    key: str | None = None  # its name in the packed record; None for the field's own, empty if it is not packed
    scale: str = ""  # the factor of `pack` that multiplies it; empty for none

    def problem(self, value: Any, default: Any) -> str:
        """How a value is wrong, such as "be positive" (after "must"); empty if it is right."""
        if self.choices:
            return "" if value in self.choices else f"be one of {', '.join(map(str, self.choices))}"
        if isinstance(default, bool):
            return "" if isinstance(value, bool) else "be true or false"
        if isinstance(default, tuple):
            if len(value) != len(default):
                return f"have {len(default)} numbers"
            return next((p for v, d in zip(value, default, strict=True) if (p := self.problem(v, d))), "")
        if not isinstance(value, int | float) or isinstance(value, bool):
            return "be a number"
        if not math.isfinite(value):
            return "be finite"
        if isinstance(default, int) and not isinstance(value, int):
            return "be a whole number"
        inside = (self.low is None or value >= self.low) and (self.high is None or value <= self.high)
        inside = inside and (self.above is None or value > self.above) and (self.below is None or value < self.below)
        return "" if inside else self._bounds()

    def range(self) -> str:
        """The possible values, for tables."""
        if self.choices:
            return ", ".join(map(str, self.choices))
        low, high = self.low if self.above is None else self.above, self.high if self.below is None else self.below
        if low is None and high is None:
            return ""
        if high is None:
            return f"{'>' if self.above is not None else '≥'} {low:g}"
        if low is None:
            return f"{'<' if self.below is not None else '≤'} {high:g}"
        return f"{'(' if self.above is not None else '['}{low:g}, {high:g}{')' if self.below is not None else ']'}"

    def _bounds(self) -> str:
        if self.high is None and self.below is None:
            if self.above is not None:
                return "be positive" if self.above == 0 else f"be above {self.above:g}"
            return "not be negative" if self.low == 0 else f"be at least {self.low:g}"
        return f"be in {self.range()}" if (self.low, self.above) != (None, None) else f"be {self.range()}"


def parameter(default: Any, *, above: float | None = None, low: float | None = 0.0, **known: Any) -> Any:
    """A dataclass field with its `ParameterInfo`: `known` are its attributes. By default no number may be negative."""
    info = ParameterInfo(low=low if above is None else None, above=above, **known)
    return dataclasses.field(default=default, metadata={_KEY: info})


def parse_pair(text: str, form: str, takes: str) -> tuple[int, int]:
    """The two whole numbers of a text in this form; raises `ConfigError`, beginning with what is taken."""
    found = re.fullmatch(form, text.strip())
    if found is None:
        raise ConfigError(f"{takes}; found '{text}'")
    return int(found[1]), int(found[2])


def parameters(kind: Any) -> dict[str, tuple[ParameterInfo, Any]]:
    """The parameters of a settings class, or of its instance, by the field's name, each with its default."""
    return {f.name: (f.metadata[_KEY], f.default) for f in dataclasses.fields(kind) if _KEY in f.metadata}


def check(settings: Any, where: str) -> None:
    """Checks all parameters, also of nested settings; raises `ConfigError`, beginning with `where`, for a wrong one."""
    for name, (known, default) in parameters(settings).items():
        value = getattr(settings, name)
        problem = known.problem(value, default)
        if problem:
            raise ConfigError(f"{where}{name} must {problem}, found {value}")
    for field in dataclasses.fields(settings):
        part = getattr(settings, field.name)
        if dataclasses.is_dataclass(part):
            check(part, f"{where}{field.name}.")


def record_fields(kind: type) -> list[tuple[Any, ...]]:
    """The fields of a record for the parameters: whole numbers and choices as i8, all others as f8."""
    found: list[tuple[Any, ...]] = []
    for name, (known, default) in parameters(kind).items():
        key = name if known.key is None else known.key
        if not key:
            continue
        whole = isinstance(default, str) or (isinstance(default, int) and not isinstance(default, bool))
        found.append((key, "f8", (len(default),)) if isinstance(default, tuple) else (key, "i8" if whole else "f8"))
    return found


def pack(settings: Any, record: np.ndarray, scales: Mapping[str, float] | None = None) -> None:
    """Writes the parameters into a record: a choice as its index, a number times the factor that `scale` names."""
    for name, (known, default) in parameters(settings).items():
        key, value = name if known.key is None else known.key, getattr(settings, name)
        if not key:
            continue
        if isinstance(default, str):
            value = known.choices.index(value)
        record[key] = np.multiply(value, scales[known.scale]) if known.scale and scales is not None else value


def changed(settings: _Kind, changes: Mapping[str, Any], where: str) -> _Kind:
    """A settings dataclass with some fields changed, as read from a file; `changes` are nested like the settings.
    Raises `ConfigError`, beginning with `where`, for an unknown field, or a value of another kind or out of range."""
    given: Any = settings
    present = {field.name: getattr(given, field.name) for field in dataclasses.fields(given)}
    new: dict[str, Any] = {}
    for name, value in changes.items():
        if name not in present:
            raise ConfigError(f"{where}: unknown '{name}'; there are {', '.join(present)}{did_you_mean(name, present)}")
        if not dataclasses.is_dataclass(present[name]):
            new[name] = _like(present[name], value, f"{where}: '{name}'")
        elif isinstance(value, Mapping):
            new[name] = changed(present[name], value, f"{where}: {name}")
        else:
            raise ConfigError(f"{where}: '{name}' must be an object with the fields of {type(present[name]).__name__}")
    return dataclasses.replace(given, **new)


def _like(present: Any, value: Any, where: str) -> Any:
    """The value as the kind of the present one."""
    if isinstance(present, tuple):
        if isinstance(value, list | tuple) and len(value) == len(present):
            return tuple(_like(p, v, where) for p, v in zip(present, value, strict=True))
        raise ConfigError(f"{where} must be a list of {len(present)} numbers, not {value!r}")
    if isinstance(value, int | float) and not isinstance(value, bool | np.bool_) and not isinstance(present, bool):
        if isinstance(present, float):
            return float(value)
        if isinstance(present, int) and abs(value) < 2**63 and float(value).is_integer():
            return int(value)
    if type(value) is not type(present):
        raise ConfigError(f"{where} must be of the kind of {present!r}, not {value!r}")
    return value


def documented(kind: type[_Kind]) -> type[_Kind]:
    """A class decorator: appends the parameters' meanings and units to the docstring, as its attributes."""
    lines = []
    for name, (known, _) in parameters(kind).items():
        text = f"{name}: {known.about}{f', {known.unit}' if known.unit else ''}."
        lines.append(textwrap.fill(text, 116, initial_indent=" " * 8, subsequent_indent=" " * 12))
    kind.__doc__ = f"{kind.__doc__}\n\n    Attributes:\n" + "\n".join(lines) + "\n    "
    return kind


def tabulated(kind: type[_Kind]) -> type[_Kind]:
    """A class decorator: `documented`, with the fields' `ParameterInfo` from `parameters.json` in the class's room, by
    the names of class and field; as with `parameter`, no number may be negative by default."""
    fields = {field.name: field for field in dataclasses.fields(kind)}  # type: ignore[arg-type]
    room = kind.__module__.rpartition(".")[0]
    for name, known in packaged(room, "parameters.json", dict[str, dict[str, ParameterInfo]])[kind.__name__].items():
        info = known if known.above is None else dataclasses.replace(known, low=None)
        fields[name].metadata = MappingProxyType({_KEY: info})
    return documented(kind)
