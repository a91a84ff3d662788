"""Serves a page in the browser until Ctrl-C."""

import sys
import threading
from typing import TYPE_CHECKING, Protocol

from fastmimic.commands.console import note, put

if TYPE_CHECKING:
    import viser


class ServedPage(Protocol):
    """A page of `view` or `play`."""

    server: "viser.ViserServer"

    @property
    def url(self) -> str: ...

    def run(self, stop: threading.Event) -> None: ...


def serve(page: ServedPage, what: str, port: int) -> int:
    """Prints the page's address, and its port if `port` was taken; returns the exit status."""
    taken = page.server.get_port()
    if taken != port:
        note(f"port {port} is taken; listening on {taken} instead")
    try:
        put(f"{what}: open {page.url} in a browser; Ctrl-C ends it")
        sys.stdout.flush()
        page.run(threading.Event())
    except KeyboardInterrupt:
        note("closed")
    return 0
