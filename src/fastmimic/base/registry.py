"""Entries by name: the package's own of a kind, and the user's."""

from collections.abc import Iterable, Iterator, Mapping
from typing import Any, Generic, Protocol, TypeVar

from fastmimic.base.errors import ConfigError, FastMimicError, did_you_mean


class Named(Protocol):
    """An entry of a registry."""

    @property
    def name(self) -> str:
        """What it is called on the command line and in files."""


Entry = TypeVar("Entry", bound=Named)


class Registry(Mapping[str, Entry], Generic[Entry]):
    """A mapping from names to entries, in the order of registration.

    Args:
        kind: what one entry is, in the singular, for messages: "method".
        error: raised for an unknown or a duplicate name.

    Example:
        METHODS.register(Method("mine", …))
        METHODS["mine"]
    """

    def __init__(self, kind: str, entries: Iterable[Entry] = (), *, error: type[FastMimicError] = ConfigError) -> None:
        self.kind = kind
        self._error = error
        self._entries: dict[str, Entry] = {}
        for entry in entries:
            self.register(entry)

    def register(self, entry: Entry) -> Entry:
        """Adds an entry and returns it; raises the registry's error if the name is empty or taken."""
        if not entry.name:
            raise self._error(f"a {self.kind} needs a name")
        if entry.name in self._entries:
            raise self._error(f"there is a {self.kind} '{entry.name}' already; choose another name")
        self._entries[entry.name] = entry
        return entry

    def unregister(self, name: str) -> Entry:
        """Removes an entry and returns it; raises the registry's error for an unknown name."""
        entry = self[name]
        del self._entries[name]
        return entry

    def __getitem__(self, name: str) -> Entry:
        """The entry of that name; raises the registry's error, which lists the names, if there is none."""
        if name not in self._entries:
            raise self._error(
                f"unknown {self.kind} '{name}'; there are {', '.join(self)}{did_you_mean(name, self._entries)}"
            )
        return self._entries[name]

    # not Mapping's, which wait for a KeyError
    def __contains__(self, name: object) -> bool:
        return name in self._entries

    def get(self, name: str, default: Any = None) -> Any:
        return self._entries.get(name, default)

    def __iter__(self) -> Iterator[str]:
        return iter(self._entries)

    def __len__(self) -> int:
        return len(self._entries)

    def __repr__(self) -> str:
        return f"Registry({self.kind}: {', '.join(self)})"
