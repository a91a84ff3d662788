"""Entries by name: the package's own of a kind, and the user's."""

from collections.abc import Iterable
from typing import NoReturn, Protocol, TypeVar

from fastmimic.base.errors import ConfigError, FastMimicError, unknown


class Named(Protocol):
    """An entry of a registry."""

    @property
    def name(self) -> str:
        """What it is called on the command line and in files."""


Entry = TypeVar("Entry", bound=Named)


class Registry(dict[str, Entry]):
    """Entries by name, in the order of registration. An unknown name raises an error that lists the names.

    Args:
        kind: what one entry is, in the singular, for messages: "method".
        error: raised for an unknown or a duplicate name.

    Example:
        METHODS.register(Method("mine", …))
        METHODS["mine"]
    """

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

    def unregister(self, name: str) -> Entry:
        """Removes an entry and returns it; raises the registry's error for an unknown name."""
        entry = self[name]
        del self[name]
        return entry

    def __missing__(self, name: str) -> NoReturn:
        raise unknown(self.kind, name, self, self._error)
