"""Whom a page's server answers, over real sockets and in a real browser."""

import http.client
import logging
import socket
import threading
import types
import urllib.error
import urllib.request
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any
from urllib.parse import urlsplit

import pytest

from browsing import PATIENCE_S, open_page, until
from fastmimic.base.errors import ConfigError
from fastmimic.viewer.viewer import HOST, Gate, WebPage

viser = pytest.importorskip("viser", reason="the extra 'view' is not installed")
from websockets.datastructures import Headers  # noqa: E402
from websockets.exceptions import InvalidStatus  # noqa: E402
from websockets.sync.client import connect  # noqa: E402

FOREIGN = ("http://evil.example", "https://{own}", "http://127.0.0.1:1", "http://localhost:{port}", "null")


@pytest.fixture(scope="module")
def page() -> Iterator[WebPage]:
    with WebPage(8800) as served:
        yield served


def port_of(page: WebPage) -> int:
    return int(page.server.get_port())


def get(page: WebPage, path: str | None = None, **headers: str) -> tuple[int, str]:
    """Status and text; `path` is the page's own unless given, `Host` the server's."""
    connection = http.client.HTTPConnection(HOST, port_of(page), timeout=PATIENCE_S)
    connection.putrequest("GET", urlsplit(page.url).path if path is None else path, skip_host=True)
    for name, value in ({"Host": f"{HOST}:{port_of(page)}"} | headers).items():
        connection.putheader(name, value)
    connection.endheaders()
    answer = connection.getresponse()
    return answer.status, answer.read().decode()


def handshake(page: WebPage, path: str | None = None, host: str | None = None, origin: str | None = None) -> int:
    """The status that a websocket's handshake ends with, 101 if it is open."""
    port = port_of(page)
    path = urlsplit(page.url).path if path is None else path
    raw = socket.create_connection((HOST, port), timeout=PATIENCE_S)
    version: Any = [f"viser-v{viser.__version__}"]
    try:
        with connect(f"ws://{host or f'{HOST}:{port}'}{path}", sock=raw, origin=origin, subprotocols=version):
            return 101
    except InvalidStatus as refused:
        return refused.response.status_code


def test_the_printed_address_and_its_websocket_are_answered(page: WebPage) -> None:
    own = f"{HOST}:{port_of(page)}"
    token = urlsplit(page.url).path.strip("/")
    assert len(token) >= 20
    for path in (f"/{token}/", f"/{token}", f"/{token}/?a=b", f"/{token}?a=b", f"/{token}/index.html"):
        status, text = get(page, path)
        assert status == 200
        assert "<html" in text
    assert get(page, f"/{token}/nothing.js")[0] == 404
    assert handshake(page, origin=f"http://{own}") == 101
    assert handshake(page, f"/{token}", origin=f"http://{own}") == 101
    assert handshake(page) == 101  # a program's, which has no origin
    for name in ("localhost", "LocalHost", "[::1]"):
        assert get(page, Host=f"{name}:{port_of(page)}")[0] == 200
    assert handshake(page, host=f"localhost:{port_of(page)}", origin=f"http://localhost:{port_of(page)}") == 101


def test_without_the_token_there_is_neither_page_nor_websocket(page: WebPage) -> None:
    token = urlsplit(page.url).path.strip("/")
    wrong = ["/", f"/{token[:-1]}/", f"/{token}x/", f"/x/{token}/", f"//{token}/", f"/?token={token}", "/index.html"]
    for path in [*wrong, f"/{Gate().token}/", f"/%2e/{token}/"]:
        status, text = get(page, path)
        assert (status, text.count("\n")) == (403, 1)
        assert "printed where it was started" in text
    for path in wrong:
        assert handshake(page, path) == 403


def test_another_name_or_port_is_refused(page: WebPage) -> None:
    port = port_of(page)
    for host in ("evil.example", f"evil.example:{port}", HOST, f"{HOST}:{port + 1}", f"127.0.0.1.evil.example:{port}"):
        status, text = get(page, Host=host)
        assert status == 403
        assert f"those of {HOST}:{port} or localhost:{port}" in text
        assert handshake(page, host=host, origin=f"http://{host}") == 403


def test_pages_of_another_origin_are_refused(page: WebPage) -> None:
    own = f"{HOST}:{port_of(page)}"
    for template in FOREIGN:
        origin = template.format(own=own, port=port_of(page))
        status, text = get(page, Origin=origin)
        assert status == 403
        assert "its own pages only" in text
        assert handshake(page, origin=origin) == 403


def test_headers_that_are_missing_or_said_twice_are_refused() -> None:
    gate = Gate()
    path, own, others = f"/{gate.token}/", ("Host", "127.0.0.1:8080"), ("Host", "evil.example")
    assert gate.refusal(Headers([own]), path, 8080) is None
    assert gate.refusal(Headers([own]), path, 8081) is not None
    assert gate.refusal(Headers([]), path, 8080) is not None
    assert gate.refusal(Headers([own, others]), path, 8080) is not None
    assert gate.refusal(Headers([own]), "/\udcc3\udca9/", 8080) is not None  # not ASCII, as websockets reads it
    origin = ("Origin", "http://127.0.0.1:8080")
    assert gate.refusal(Headers([own, origin]), path, 8080) is None
    assert gate.refusal(Headers([own, origin, ("Origin", "http://evil.example")]), path, 8080) is not None
    at_80 = Headers([("Host", "localhost"), ("Origin", "http://localhost")])  # a browser leaves port 80 out
    assert gate.refusal(at_80, path, 80) is None


def test_refusals_are_not_logged(page: WebPage, caplog: pytest.LogCaptureFixture, capfd: Any) -> None:
    with caplog.at_level(logging.DEBUG):
        assert get(page, "/")[0] == 403
        assert handshake(page, origin="http://evil.example") == 403
    assert [record for record in caplog.records if record.levelno > logging.DEBUG] == []
    assert capfd.readouterr() == ("", "")


def test_every_page_has_its_own_token(page: WebPage) -> None:
    with WebPage(8810) as other:
        token = urlsplit(page.url).path
        assert urlsplit(other.url).path != token
        assert get(other, token)[0] == 403


def test_a_viser_that_cannot_be_guarded_serves_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    import websockets
    from viser.infra import _infra

    kept = types.SimpleNamespace(**vars(websockets.asyncio.server))  # as one that imports `serve` itself would have
    exceptions, structures = websockets.exceptions, websockets.datastructures
    inside = types.SimpleNamespace(
        asyncio=types.SimpleNamespace(server=kept), exceptions=exceptions, datastructures=structures
    )
    monkeypatch.setattr(_infra, "websockets", inside)
    began: list[Any] = []
    start = viser.ViserServer
    monkeypatch.setattr(viser, "ViserServer", lambda **options: began.append(start(**options)) or began[-1])
    with pytest.raises(ConfigError, match=r"cannot be guarded .*pip install 'viser==1\.1"):
        WebPage(8820)
    with pytest.raises(urllib.error.URLError):
        urllib.request.urlopen(f"http://{HOST}:{began[0].get_port()}/", timeout=PATIENCE_S)


@pytest.fixture
def foreign_site() -> Iterator[str]:
    """An empty page on another port."""

    class Empty(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            self.send_response(200)
            self.send_header("Content-Type", "text/html")
            self.end_headers()

        def log_message(self, *_: Any) -> None:
            pass

    with ThreadingHTTPServer((HOST, 0), Empty) as site:
        threading.Thread(target=site.serve_forever).start()
        yield f"http://{HOST}:{site.server_port}/"
        site.shutdown()


OPENING = """url => new Promise(done => {
  const socket = new WebSocket(url, ["viser-v%s"]);
  socket.onopen = () => done("open");
  socket.onerror = () => done("refused");
})"""


@pytest.mark.slow
def test_a_browser_opens_the_address_and_another_site_in_it_gets_nothing(
    browser: Any, page: WebPage, foreign_site: str
) -> None:
    sees = open_page(browser, 700, 520)
    sees.goto(page.url)
    until(page.watched, sees)
    socket_url, opening = page.url.replace("http:", "ws:"), OPENING % viser.__version__
    assert sees.evaluate(opening, socket_url) == "open"
    assert sees.goto(page.url.removesuffix(urlsplit(page.url).path)).status == 403
    assert "whole address" in sees.inner_text("body")
    sees.goto(foreign_site)
    assert sees.evaluate(opening, socket_url) == "refused"  # although it knows the token
    sees.context.close()
