"""Whom a page's server answers: its own pages, opened by somebody who knows its address with the token.

Two attacks come through the user's own browser, from any site that is open in it. Cross-site websockets: the
same-origin policy lets every page open websockets to this machine; in `Origin` the browser says whose page it is. DNS
rebinding: a site's name comes to stand for 127.0.0.1, so that the browser takes the server for that site; in `Host` it
says that name. Other users of this machine can say there what they like, but do not know the token.
"""

import hmac
import http
import secrets
import threading
from dataclasses import replace
from typing import Any, Final

from fastmimic.base.errors import ConfigError

NAMES: Final = ("127.0.0.1", "localhost", "[::1]")  # of loopback, which no site's name can be
_exchanging: Final = threading.Lock()


class Gate:
    """Gives a page, and the websocket that it opens, to those who know `token`, the first part of the path of both:
    viser's client opens its websocket at the path of its page."""

    def __init__(self) -> None:
        self.token = secrets.token_urlsafe(16)

    def refusal(self, headers: Any, path: str, port: int) -> str | None:
        """Why a request with these headers (websockets' `Headers`) to this port is refused; None if it is answered."""
        hosts = [f"{name}:{port}".removesuffix(":80") for name in NAMES]  # browsers leave out port 80
        named, origins = headers.get_all("Host"), headers.get_all("Origin")
        if len(named) != 1 or named[0].lower() not in hosts or origins not in ([], [f"http://{named[0].lower()}"]):
            return f"This server answers its own pages only, those of {' or '.join(hosts)}."
        given = path[1:].partition("?")[0].partition("/")[0]
        if not hmac.compare_digest(given.encode(errors="replace"), self.token.encode()):
            return "Open the whole address, with its token, that FastMimic printed where it was started."
        return None

    def serve(self, **options: Any) -> Any:
        """A `ViserServer` with these options, behind this gate. viser 1.1 has no place for one, so what it serves by
        is exchanged while it starts. Raises `ConfigError`, and serves nothing, if viser did not call that."""
        import viser
        from websockets.asyncio import server as library

        serve, guarded = library.serve, threading.Event()

        def serve_guarded(*arguments: Any, process_request: Any = lambda *_: None, **options: Any) -> Any:
            def answer(connection: Any, request: Any) -> Any:
                if reason := self.refusal(request.headers, request.path, connection.local_address[1]):
                    return connection.respond(http.HTTPStatus.FORBIDDEN, reason + "\n")
                return process_request(connection, replace(request, path=request.path.removeprefix(f"/{self.token}")))

            guarded.set()
            return serve(*arguments, process_request=answer, **options)

        with _exchanging:
            library.serve = serve_guarded  # type: ignore[assignment,misc]
            try:
                server = viser.ViserServer(**options)
            finally:
                library.serve = serve  # type: ignore[misc]
        if not guarded.is_set():
            server.stop()
            raise ConfigError("this viser's pages cannot be guarded from other sites: pip install 'viser==1.1.1'")
        return server
