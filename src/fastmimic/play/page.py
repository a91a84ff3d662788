"""The page of a live session: simulation in real time in one thread, drawing in another."""

import threading
import time
from collections import deque
from collections.abc import Callable
from typing import TYPE_CHECKING, Final

import numpy as np

from fastmimic.play.history import LiveHistory
from fastmimic.play.live_panel import PlayPanel
from fastmimic.robot import Robot
from fastmimic.viewer.bodies import Puppet
from fastmimic.viewer.scene import RobotScene
from fastmimic.viewer.web import DEFAULT_PORT, FRAMES_PER_S, Cameras, WebPage

if TYPE_CHECKING:
    import viser

    from fastmimic.play.session import LiveSession
    from fastmimic.viewer.take import Take

CHUNK_S: Final = 0.01  # between checks of the clock, at least
MOST_BEHIND_S: Final = 0.05  # delay that is caught up; the real-time factor shows the rest
WINDOW_S: Final = 1.0  # of the real-time factor
_GROUND: Final = (24.0, 24.0)
_PUSH_RGB: Final = (230, 120, 0)
_PUSH_S: Final = 0.6  # time that a push is shown
_LEAST_ARROW: Final = 0.5  # of the leg's length
_CLEAR_M: Final = 0.14  # the tip's distance from the trunk's middle
_CHARTS_PER_S: Final = 6.0
_IDLE_S: Final = 0.05


class Pacer:
    """Runs a session in real time in the calling thread.

    Attributes:
        lock: held while the session steps; take it to use the session elsewhere.
        paused: whether the session pauses.
        pace: simulated time per second, in (0, 1]: slow motion below 1.
        realtime_factor: simulated time per second over the last `WINDOW_S`, as a share of `pace`.
    """

    def __init__(self, session: "LiveSession", clock: Callable[[], float] = time.monotonic) -> None:
        self.session = session
        self.lock = threading.RLock()
        self.paused = False
        self.pace = 1.0
        self.realtime_factor = 1.0
        self._clock = clock
        self._debt_s = 0.0
        self._window: deque[tuple[float, float, float]] = deque()

    def run(self, stop: threading.Event, record: Callable[[], None], every: int, awake: Callable[[], bool]) -> None:
        """Runs until `stop` is set, while `awake` returns True. Calls `record`, with the lock held, after each `every`
        control steps."""
        before = self._clock()
        while not stop.wait(CHUNK_S):
            now = self._clock()
            passed, before = now - before, now
            if not awake() or self.paused:
                self._window.clear()
                continue
            with self.lock:
                self.advance(passed, record, every)

    def advance(self, passed_s: float, record: Callable[[], None] | None = None, every: int = 1) -> int:
        """Takes the steps due after this much more real time; returns their number."""
        dt = self.session.dt
        self._debt_s = min(self._debt_s + passed_s * self.pace, MOST_BEHIND_S)
        steps = int(self._debt_s / dt + 1e-9)
        for _ in range(steps):
            self.session.step()
            if record is not None and self.session.steps % every == 0:
                record()
        self._debt_s -= steps * dt
        self._measure(passed_s, steps * dt)
        return steps

    def _measure(self, passed_s: float, simulated_s: float) -> None:
        window = self._window
        window.append((passed_s, simulated_s, passed_s * self.pace))
        while len(window) > 1 and sum(entry[0] for entry in window) - window[0][0] > WINDOW_S:
            window.popleft()
        due = sum(entry[2] for entry in window)
        if sum(entry[0] for entry in window) > 0.2 * WINDOW_S:
            self.realtime_factor = sum(entry[1] for entry in window) / due if due > 0 else 1.0


class LiveScene(RobotScene):
    """Follows a history instead of a take."""

    def __init__(self, server: "viser.ViserServer", robot: Robot, history: "LiveHistory") -> None:
        self._history = history
        super().__init__(server, "/live", robot, Puppet(robot), history.take(), 0.0, _GROUND)
        self._push_arrow = self._arrows("/live/push", _PUSH_RGB, 0.012)

    def set_take(self, take: "Take") -> None:
        """Shows another take, at the place that the history follows."""
        if not hasattr(self, "take") or take.title != self.take.title:
            self._title.text = take.title
        self.take = take
        self._path = np.broadcast_to(self._history.followed, (take.rows, 2))

    def show(self, row: int, *, follow: bool) -> None:
        """As `RobotScene.show`, with the push."""
        super().show(row, follow=follow)
        force = self._history.push(_PUSH_S)
        if force is not None:
            size = float(np.linalg.norm(force))
            arm = force / size * self._robot.leg_length * max(_LEAST_ARROW, size / self.take.weight)
            tip = self._history.now.pose[:3] - _CLEAR_M * force / size
            self._push_arrow.points = np.stack([tip - arm, tip])[None].astype(np.float32)
        self._push_arrow.visible = force is not None


class PlayPage(WebPage):
    """Plays a live session in the browsers of this machine, on the first free port from `port` on. Raises `ConfigError`
    if viser is not installed or no port is free."""

    def __init__(self, session: "LiveSession", heading: str, port: int = DEFAULT_PORT) -> None:
        super().__init__(port)
        self.session = session
        self.pacer = Pacer(session)
        self.history = LiveHistory(session)
        self.scene = LiveScene(self.server, session.robot, self.history)
        self.cameras = Cameras(self.server, session.robot, [0.0], 0.0)
        self.panel = PlayPanel(self.server.gui, self.pacer, self.history, self.scene, self.cameras, heading)
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
        failure: list[BaseException] = []

        def simulate() -> None:
            try:
                self.pacer.run(stop, self.history.add, self.history.every, self.watched)
            except BaseException as error:  # noqa: BLE001 - handed to the caller's thread
                failure.append(error)
                stop.set()

        simulation = threading.Thread(target=simulate, daemon=True)
        simulation.start()
        try:
            while not stop.wait(1.0 / FRAMES_PER_S if self.watched() else _IDLE_S):
                if self.watched():
                    self.draw()
                else:
                    with self.pacer.lock:
                        self.session.library.prepare(self.session.motion)
        finally:
            stop.set()
            simulation.join()
        if failure:
            raise failure[0]
