"""The viewer: its server with the browsers' cameras, and takes, played back in a browser."""

import contextlib
import errno
import hmac
import http
import io
import logging
import math
import secrets
import socket
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Final, Literal, Self

import numpy as np

from fastmimic.base.arrays import Array, Indices
from fastmimic.base.errors import ConfigError
from fastmimic.base.machine import optional
from fastmimic.render.tracks import Animal
from fastmimic.robot import Robot
from fastmimic.viewer.panel import ViewerPanel
from fastmimic.viewer.scene import animal_aside, line_up
from fastmimic.viewer.take import Take

if TYPE_CHECKING:
    import viser

HOST: Final = "127.0.0.1"
DEFAULT_PORT: Final = 8080
PORTS_TRIED: Final = 50
FRAMES_PER_S: Final = 30.0
_FOV_RAD: Final = 0.7
_SETTLE_S: Final = 10.0
_PORTRAIT: Final = 0.7  # width over height of a picture that a phone shows
Repeat = Literal["all", "cycle", "off"]
_CHARTS_PER_S: Final = 8.0
IDLE_S: Final = 0.05
_LOOPBACK: Final = ("127.0.0.1", "localhost", "[::1]")  # names that no site can have
_exchanging: Final = threading.Lock()


def free_port(port: int, tries: int = PORTS_TRIED) -> int:
    """The first free port from `port` on, on loopback; raises `ConfigError` if there is none."""
    if not 1 <= port <= 65535:
        raise ConfigError(f"--port takes 1 to 65535, found {port}")
    for candidate in range(port, min(port + tries, 65536)):
        with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                probe.bind((HOST, candidate))
            except OSError as error:
                if error.errno == errno.EADDRINUSE:
                    continue
                raise ConfigError(f"cannot listen on {HOST}:{candidate}: {error.strerror}") from None
            return candidate
    raise ConfigError(f"the ports {port} to {min(port + tries, 65536) - 1} are all taken; choose another --port")


def require_viser() -> None:
    """Raises `ConfigError` with advice if viser is not installed, or too old."""
    viser = optional("viser", ConfigError("the viewer needs viser: pip install 'fastmimic[view]'"))
    if not hasattr(viser.GuiApi, "add_panel"):
        raise ConfigError(f"viser {viser.__version__} is too old: pip install --upgrade 'fastmimic[view]'")


def default_camera(robot: Robot, beside: Sequence[float], yaw: float, aspect: float = 1.6) -> tuple[Array, Array]:
    """A camera's place and what it looks at, (3,) scene coordinates, m: from the robot's front right, high enough to
    see the ground under its feet, with everything in the picture. `beside` are the places of robots and animal, m to
    the left of the middle; `yaw` is the heading at the start, rad; `aspect` the picture's width over its height."""
    span = float(np.ptp(robot.hip_pos_b[:, 0])) + robot.leg_length
    alone = len(beside) == 1
    wide = (1.6 if alone else 1.1) * span + 0.9 * (max(beside) - min(beside))
    half = np.tan(_FOV_RAD / 2)
    distance = max(1.15 * span / half, 0.5 * wide / (half * min(aspect, 1.6)))
    azimuth, elevation = yaw - np.radians(48.0 if alone else 32.0), np.radians(20.0)
    middle = 0.5 * (max(beside) + min(beside))
    height = 0.4 * robot.leg_length
    if aspect < _PORTRAIT:
        height -= 0.45 * half * distance  # the lower half is the controls'
    look_at = np.array([-np.sin(yaw) * middle, np.cos(yaw) * middle, height])
    level = np.cos(elevation)
    arm = distance * np.array([level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation)])
    return look_at + arm, look_at


class Cameras:
    """The cameras of all browsers, and their initial place; arguments as for `default_camera`."""

    def __init__(self, server: "viser.ViserServer", robot: Robot, beside: Sequence[float], yaw: float) -> None:
        self._server, self._robot, self._beside, self._yaw = server, robot, tuple(beside), yaw
        initial = server.initial_camera
        initial.position, initial.look_at = default_camera(robot, beside, yaw)
        initial.fov = _FOV_RAD
        server.on_client_connect(self._welcome)

    def reset(self, client: "viser.ClientHandle | None") -> None:
        """Resets the camera of one browser, or of all."""
        for each in self._server.get_clients().values() if client is None else (client,):
            self._aim(each)

    def _welcome(self, client: "viser.ClientHandle") -> None:
        """Aims, and again when the panels are in place."""
        self._aim(client)
        began, aimed = time.monotonic(), float(client.camera.aspect)

        @client.camera.on_update
        def _(camera: "viser.CameraHandle") -> None:
            nonlocal aimed
            aspect = float(camera.aspect)
            if time.monotonic() - began < _SETTLE_S and abs(aspect - aimed) > 0.05 * aimed:
                aimed = aspect
                self._aim(client)

    def _aim(self, client: "viser.ClientHandle") -> None:
        """Aims; a narrow window, as a phone's, needs a camera further away."""
        camera = client.camera
        camera.position, camera.look_at = default_camera(self._robot, self._beside, self._yaw, float(camera.aspect))
        camera.up_direction, camera.fov = (0.0, 0.0, 1.0), _FOV_RAD


class Gate:
    """Whom a page's server answers: its own pages, and the websockets that they open, of those who know `token`, the
    first part of the path of both: viser's client opens its websocket at the path of its page.

    Two attacks come through the user's own browser, from any site that is open in it. Cross-site websockets: the
    same-origin policy lets every page open websockets to this machine; in `Origin` the browser says whose page it is.
    DNS rebinding: a site's name comes to stand for 127.0.0.1, so that the browser takes the server for that site; in
    `Host` it says that name. Other users of this machine can say there what they like, but do not know the token."""

    def __init__(self) -> None:
        self.token = secrets.token_urlsafe(16)

    def refusal(self, headers: Any, path: str, port: int) -> str | None:
        """Why a request with these headers (websockets' `Headers`) to this port is refused; None if it is answered."""
        hosts = [f"{name}:{port}".removesuffix(":80") for name in _LOOPBACK]  # browsers leave out port 80
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
        from websockets.asyncio import server as websocket

        serve, guarded = websocket.serve, threading.Event()

        def serve_guarded(*arguments: Any, process_request: Any = lambda *_: None, **options: Any) -> Any:
            def answer(connection: Any, request: Any) -> Any:
                if reason := self.refusal(request.headers, request.path, connection.local_address[1]):
                    return connection.respond(http.HTTPStatus.FORBIDDEN, reason + "\n")
                return process_request(connection, replace(request, path=request.path.removeprefix(f"/{self.token}")))

            guarded.set()
            return serve(*arguments, process_request=answer, **options)

        with _exchanging:
            websocket.serve = serve_guarded  # type: ignore[assignment,misc]
            try:
                server = viser.ViserServer(**options)
            finally:
                websocket.serve = serve  # type: ignore[misc]
        if not guarded.is_set():
            server.stop()
            raise ConfigError("this viser's pages cannot be guarded from other sites: pip install 'viser==1.1.1'")
        return server


class WebPage:
    """A page served by viser's `server`, silently, at the first free port from `port` on, to those who open `url`
    (see `Gate`). A context manager; otherwise `close` it. Raises `ConfigError` without viser, its guard or a port."""

    def __init__(self, port: int = DEFAULT_PORT) -> None:
        require_viser()
        logging.getLogger("websockets").setLevel(logging.CRITICAL)  # connections that come and go are no news
        self._gate = Gate()
        with contextlib.redirect_stdout(io.StringIO()):
            self.server = self._gate.serve(host=HOST, port=free_port(port), label="FastMimic", verbose=False)

    @property
    def url(self) -> str:
        return f"http://{HOST}:{self.server.get_port()}/{self._gate.token}/"

    def watched(self) -> bool:
        return bool(self.server.get_clients())

    def close(self) -> None:
        with contextlib.redirect_stdout(io.StringIO()):
            self.server.stop()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()


@dataclass
class Player:
    """A position in the rows of a take that advances in real time. At the end it starts again (`repeat` "all"), stops
    ("off"), or repeats the present cycle ("cycle")."""

    rows: int
    rate_hz: float  # rows a second of real time
    cycle_starts: Indices  # first rows of the cycles, ascending from 0
    playing: bool = True
    speed: float = 1.0  # times real time, positive
    repeat: Repeat = "all"
    _position: float = 0.0

    @property
    def row(self) -> int:
        return min(int(self._position), self.rows - 1)

    @property
    def cycle(self) -> int:
        """The cycle of the present row, from 0."""
        return int(np.searchsorted(self.cycle_starts, self.row, side="right")) - 1

    def cycle_rows(self, cycle: int) -> tuple[int, int]:
        """First row and end of a cycle."""
        ends = [*self.cycle_starts[1:], self.rows]
        return int(self.cycle_starts[cycle]), int(ends[cycle])

    def advance(self, seconds: float) -> None:
        """Advances by this much real time, if playing."""
        if not self.playing or seconds <= 0:
            return
        first, end = self.cycle_rows(self.cycle) if self.repeat == "cycle" else (0, self.rows)
        position = self._position + seconds * self.speed * self.rate_hz
        if position >= end:
            if self.repeat == "off":
                position, self.playing = float(self.rows - 1), False
            else:
                position = first + math.fmod(position - first, max(end - first, 1))
        self._position = position

    def seek(self, row: int) -> None:
        self._position = float(min(max(row, 0), self.rows - 1))

    def step_cycle(self, by: int) -> None:
        """Goes to the start of a later (earlier, if negative) cycle; of the present one if it is the last (first)."""
        cycle = min(max(self.cycle + by, 0), len(self.cycle_starts) - 1)
        self.seek(int(self.cycle_starts[cycle]))

    def toggle(self) -> None:
        """Plays or pauses; starts again at the end."""
        if not self.playing and self.row >= self.rows - 1:
            self.seek(0)
        self.playing = not self.playing


class Viewer(WebPage):
    """Plays takes in the browsers of this machine: each robot's in `shown`, left to right in the picture, one at a
    time, with the animal beside the first robot. `heading` is the panel's, such as "trot on a1"; `port` the first one
    to try. Raises `ConfigError` if viser is not installed, or no port is free."""

    def __init__(
        self, robot: Robot, shown: Sequence[Sequence[Take]], heading: str, port: int, animal: Animal | None = None
    ) -> None:
        super().__init__(port)
        self._shown = [tuple(takes) for takes in shown]
        self.lock = threading.RLock()
        first = [takes[0] for takes in self._shown]
        self.player = Player(*_longest(first))
        self.robots = line_up(self.server, first, animal)
        beside = [scene.aside for scene in self.robots]
        if animal is not None:
            beside.append(beside[0] + animal_aside(robot))
        cameras = Cameras(self.server, robot, beside, float(first[0].heading[0]))
        self.panel = ViewerPanel(self, cameras, heading, max(len(takes) for takes in self._shown))
        self._drawn: tuple[int, int] | None = None
        self._charts_at = 0.0
        self.draw(force=True)

    def choose(self, episode: int) -> None:
        """Shows another episode, from its start."""
        with self.lock:
            takes = [takes[min(episode, len(takes) - 1)] for takes in self._shown]
            for scene, take in zip(self.robots, takes, strict=True):
                scene.set_take(take)
            player = self.player
            player.rows, player.rate_hz, player.cycle_starts = _longest(takes)
            player.seek(0)
            self.panel.set_takes()
            self.draw(force=True)

    def draw(self, *, force: bool = False) -> None:
        with self.lock:
            row = self.player.row
            if not force and self._drawn == (row, self.panel.version):
                return
            moment = time.monotonic()
            charts = force or not self.player.playing or moment - self._charts_at >= 1.0 / _CHARTS_PER_S
            with self.server.atomic():
                for scene in self.robots:
                    scene.show(row, follow=self.panel.follow)
                if charts:
                    self.panel.show(row)
                    self._charts_at = moment
            self._drawn = (row, self.panel.version)

    def run(self, stop: threading.Event) -> None:
        """Plays until `stop` is set; pauses without a browser."""
        before = time.monotonic()
        while not stop.wait(IDLE_S if not self.watched() else 0.2 / FRAMES_PER_S):
            now = time.monotonic()
            if not self.watched():
                before = now
                continue
            if now - before < 1.0 / FRAMES_PER_S:
                continue
            with self.lock:
                was = self.player.playing
                self.player.advance(min(now - before, 0.25))  # a machine that was busy does not jump
                if was and not self.player.playing:
                    self.panel.show_playing()
            before = now
            self.draw()


def _longest(takes: Sequence[Take]) -> tuple[int, float, Indices]:
    """Rows, rate and cycle starts of the longest take."""
    longest = max(takes, key=lambda take: take.rows)
    return longest.rows, longest.rate_hz, longest.cycle_starts
