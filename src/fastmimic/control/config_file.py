"""The controller's parameters in a file: those of a named set, and what is other than there.

    {"format": "fastmimic controller", "version": 1, "base": "default",
     "robot": "a1", "stance": {"friction": 0.4}, "load": {"mass": 2.0}}

`base` is the name of a set, "default" if it is left out; `robot` the only one that the file is for; the parts and their
fields are those of `fastmimic.control.config.ControllerConfig`. What stands under "identified" is for people.
"""

import dataclasses
import json
from pathlib import Path
from typing import Any, Final

from fastmimic.base.errors import ConfigError, did_you_mean
from fastmimic.control.config import CONFIGS, ControllerConfig

FORMAT: Final = "fastmimic controller"
VERSION: Final = 1
_ABOUT: Final = ("format", "version", "base", "identified")


def read_config(path: str | Path) -> ControllerConfig:
    """Reads a controller's configuration, whose name becomes the file's.

    Raises:
        ConfigError: no such file, not such a configuration, or a field or value that there is not.
    """
    path = Path(path)
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise ConfigError(
            f"{path}: no such file; expected a controller's configuration ({', '.join(CONFIGS)})"
        ) from None
    except (OSError, ValueError) as error:
        raise ConfigError(f"{path}: cannot be read ({error})") from None
    if not isinstance(found, dict) or found.get("format") != FORMAT or found.get("version") != VERSION:
        raise ConfigError(
            f'{path}: not a controller\'s configuration; expected "format": "{FORMAT}", "version": {VERSION}'
        )
    base = found.get("base", "default")
    if base not in CONFIGS:
        raise ConfigError(
            f"{path}: unknown base '{base}'; there are {', '.join(CONFIGS)}{did_you_mean(str(base), CONFIGS)}"
        )
    config = dataclasses.replace(CONFIGS[base](), name=path.name)
    return changed(config, {name: value for name, value in found.items() if name not in _ABOUT}, str(path))


def changed(config: Any, changes: dict[str, Any], where: str) -> Any:
    """A configuration, or a part of one, with some of its fields changed.

    Args:
        config: a dataclass.
        changes: by field; those of a part are a dictionary.
        where: for messages.

    Raises:
        ConfigError: an unknown field, or a value of another kind than the one that is there.
    """
    fields = {field.name: getattr(config, field.name) for field in dataclasses.fields(config) if field.name != "name"}
    new: dict[str, Any] = {}
    for name, value in changes.items():
        if name not in fields:
            raise ConfigError(f"{where}: unknown '{name}'; there are {', '.join(fields)}{did_you_mean(name, fields)}")
        present = fields[name]
        if dataclasses.is_dataclass(present):
            if not isinstance(value, dict):
                raise ConfigError(f"{where}: '{name}' must be an object with the fields of {type(present).__name__}")
            new[name] = changed(present, value, f"{where}: {name}")
        else:
            new[name] = _like(present, value, f"{where}: '{name}'")
    return dataclasses.replace(config, **new)


def _like(present: Any, value: Any, where: str) -> Any:
    """The value as the kind of the present one."""
    if isinstance(present, tuple):
        if isinstance(value, list) and len(value) == len(present):
            return tuple(_like(p, v, where) for p, v in zip(present, value, strict=True))
        raise ConfigError(f"{where} must be a list of {len(present)} numbers, not {value!r}")
    if isinstance(present, float) and isinstance(value, int | float) and not isinstance(value, bool):
        return float(value)
    if type(value) is not type(present):
        raise ConfigError(f"{where} must be of the kind of {present!r}, not {value!r}")
    return value
