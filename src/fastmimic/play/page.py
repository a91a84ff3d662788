"""The page of a live session: simulation in real time in one thread, drawing of its recent past in another."""

import threading
import time
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING, Final

from fastmimic.play.live_panel import PlayPanel
from fastmimic.play.live_scene import LiveHistory, LiveScene, Pacer
from fastmimic.viewer.web import DEFAULT_PORT, FRAMES_PER_S, Cameras, WebPage

if TYPE_CHECKING:
    from fastmimic.play.session import LiveSession

_CHARTS_PER_S: Final = 6.0
_IDLE_S: Final = 0.05


class PlayPage(WebPage):
    """Plays a live session in the browsers of this machine, on the first free port from `port` on. Raises `ConfigError`
    if viser is not installed or no port is free."""

    def __init__(self, session: "LiveSession", heading: str, port: int = DEFAULT_PORT) -> None:
        super().__init__(port)
        self.session = session
        self.pacer = Pacer(session)
        self.history = LiveHistory(session)
        self.scene = LiveScene(self.server, self.history)
        cameras = Cameras(self.server, session.robot, [0.0], 0.0)
        self.panel = PlayPanel(self.server.gui, self.pacer, self.history, self.scene, cameras, heading)
        self._charts_at = 0.0
        self.draw()

    def draw(self) -> None:
        """Updates scene and panel."""
        moment = time.monotonic()
        with self.pacer.lock:
            take, plot = self.history.take(), self.history.plot()
        charts = moment - self._charts_at >= 1.0 / _CHARTS_PER_S
        with self.server.atomic():
            self.scene.set_take(take)
            self.scene.show(take.rows - 1, follow=self.panel.follow)
            if charts:
                self.panel.show(take, plot)
                self._charts_at = moment

    def run(self, stop: threading.Event) -> None:
        """Plays until `stop` is set; pauses without a browser."""
        with ThreadPoolExecutor(1) as executor:
            simulation = executor.submit(self.pacer.run, stop, self.history.add, self.history.every, self.watched)
            simulation.add_done_callback(lambda _: stop.set())
            try:
                while not stop.wait(1.0 / FRAMES_PER_S if self.watched() else _IDLE_S):
                    if self.watched():
                        self.draw()
                    else:
                        with self.pacer.lock:
                            self.session.library.prepare(self.session.motion)
            finally:
                stop.set()
        simulation.result()
