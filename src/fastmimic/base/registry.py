"""Entries by name: the package's own of a kind, and the user's, which extensions register when they are imported.

The environment variable FASTMIMIC_EXTENSIONS lists files, separated as in PATH; the installed entry points of the group
"fastmimic.extensions" are modules. The command line and worker processes load them.
"""

import importlib.util
import os
import sys
from collections.abc import Iterable
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import Any, Final, NoReturn, TypeVar

from fastmimic.base.errors import ConfigError, FastMimicError, unknown

VARIABLE: Final = "FASTMIMIC_EXTENSIONS"
GROUP: Final = "fastmimic.extensions"


Entry = TypeVar("Entry", bound=Any)  # with a `name`: what it is called on the command line and in files


class Registry(dict[str, Entry]):
    """Entries by name, in the order of registration: after `METHODS.register(Method("mine", …))` there is
    `METHODS["mine"]`. An unknown or taken name raises an `error`. `kind` is what an entry is, in messages: "method"."""

    def __init__(self, kind: str, entries: Iterable[Entry] = (), *, error: type[FastMimicError] = ConfigError) -> None:
        super().__init__()
        self.kind = kind
        self._error = error
        for entry in entries:
            self.register(entry)

    def register(self, entry: Entry) -> Entry:
        """Adds an entry and returns it; raises the registry's error if the name is empty or taken."""
        if not entry.name:
            raise self._error(f"a {self.kind} needs a name")
        if entry.name in self:
            raise self._error(f"there is a {self.kind} '{entry.name}' already; choose another name")
        self[entry.name] = entry
        return entry

    def __missing__(self, name: str) -> NoReturn:
        raise unknown(self.kind, name, self, self._error)


_loaded: set[str] = set()


def load_extensions() -> None:
    """Imports the extensions not imported yet; raises `ConfigError` if a file is missing or an extension fails."""
    for name in filter(None, os.environ.get(VARIABLE, "").split(os.pathsep)):
        path = Path(name).expanduser().resolve()
        if str(path) in _loaded:
            continue
        if not path.is_file():
            raise ConfigError(f"{VARIABLE}: {name}: no such file")
        _run(path)
        _loaded.add(str(path))
    for point in _installed():
        if point.value in _loaded:
            continue
        try:
            point.load()
        except Exception as error:
            raise ConfigError(f"extension '{point.name}' ({point.value}) fails: {_line(error)}") from error
        _loaded.add(point.value)


@cache
def _installed() -> metadata.EntryPoints:
    return metadata.entry_points(group=GROUP)


def _run(path: Path) -> None:
    main = getattr(sys.modules.get("__main__"), "__file__", None)
    if main is not None and Path(main).resolve() == path:  # the script itself, which registers what it has
        return
    name = f"fastmimic_extension_{path.stem}"
    spec = importlib.util.spec_from_file_location(name, path)
    if spec is None or spec.loader is None:
        raise ConfigError(f"{VARIABLE}: {path}: not a Python file")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # so that its classes and functions can be pickled
    try:
        spec.loader.exec_module(module)
    except Exception as error:
        del sys.modules[name]
        raise ConfigError(f"{VARIABLE}: {path} fails: {_line(error)}") from error


def _line(error: Exception) -> str:
    return f"{type(error).__name__}: {error}"
