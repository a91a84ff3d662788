"""The viewer's web server: its port, and the browsers' cameras."""

import contextlib
import errno
import io
import logging
import socket
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, Self

import numpy as np

from fastmimic.base.errors import ConfigError
from fastmimic.robot import Robot

if TYPE_CHECKING:
    import viser

HOST: Final = "127.0.0.1"
DEFAULT_PORT: Final = 8080
PORTS_TRIED: Final = 50
FRAMES_PER_S: Final = 30.0
_FOV_RAD: Final = 0.7
_SETTLE_S: Final = 10.0
_PORTRAIT: Final = 0.7  # width over height of a picture that a phone shows


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
    try:
        import viser
    except ImportError:
        raise ConfigError("the viewer needs viser: pip install 'fastmimic[view]'") from None
    if not hasattr(viser.GuiApi, "add_panel"):
        raise ConfigError(f"viser {viser.__version__} is too old: pip install --upgrade 'fastmimic[view]'")


@dataclass(frozen=True)
class Camera:
    """A camera's place and target, scene coordinates, m."""

    position: tuple[float, float, float]
    look_at: tuple[float, float, float]


def default_camera(robot: Robot, beside: Sequence[float], yaw: float, aspect: float = 1.6) -> Camera:
    """From the robot's front right, high enough to see the ground under its feet, with everything in the picture. The
    robot's size sets the distance; `beside` are the places of robots and animal, m to the left of the middle; `yaw` is
    the heading at the start, rad; `aspect` width over height of the picture."""
    span = float(np.ptp(robot.hip_pos_b[:, 0])) + robot.leg_length
    alone = len(beside) == 1
    across = 0.0 if alone else max(beside) - min(beside)
    wide = (1.6 if alone else 1.1) * span + 0.9 * across
    half = np.tan(_FOV_RAD / 2)
    distance = max(1.15 * span / half, 0.5 * wide / (half * min(aspect, 1.6)))
    azimuth, elevation = yaw - np.radians(48.0 if alone else 32.0), np.radians(20.0)
    middle = 0.5 * (max(beside) + min(beside))
    height = 0.4 * robot.leg_length
    if aspect < _PORTRAIT:
        height -= 0.45 * half * distance  # the lower half is the controls'
    look_at = np.array([-np.sin(yaw) * middle, np.cos(yaw) * middle, height])
    arm = distance * np.array(
        [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)]
    )
    x, y, z = (float(v) for v in look_at + arm)
    return Camera((x, y, z), (float(look_at[0]), float(look_at[1]), height))


class Cameras:
    """The cameras of all browsers, and their initial place; arguments as for `default_camera`."""

    def __init__(self, server: "viser.ViserServer", robot: Robot, beside: Sequence[float], yaw: float) -> None:
        self._server, self._robot, self._beside, self._yaw = server, robot, tuple(beside), yaw
        camera, initial = default_camera(robot, beside, yaw), server.initial_camera
        initial.position, initial.look_at, initial.fov = camera.position, camera.look_at, _FOV_RAD
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
        camera = default_camera(self._robot, self._beside, self._yaw, float(client.camera.aspect))
        client.camera.position, client.camera.look_at = camera.position, camera.look_at
        client.camera.up_direction = (0.0, 0.0, 1.0)
        client.camera.fov = _FOV_RAD


class WebPage:
    """A page served by viser's `server`, silently, to this machine's browsers, at the first free port from `port` on. A
    context manager; otherwise `close` it. Raises `ConfigError` if viser is not installed, or no port is free."""

    def __init__(self, port: int = DEFAULT_PORT) -> None:
        require_viser()
        import viser

        logging.getLogger("websockets").setLevel(logging.CRITICAL)  # connections that come and go are no news
        with contextlib.redirect_stdout(io.StringIO()):
            self.server = viser.ViserServer(host=HOST, port=free_port(port), label="FastMimic", verbose=False)

    @property
    def url(self) -> str:
        return f"http://{HOST}:{self.server.get_port()}"

    def watched(self) -> bool:
        return bool(self.server.get_clients())

    def close(self) -> None:
        with contextlib.redirect_stdout(io.StringIO()):
            self.server.stop()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()
