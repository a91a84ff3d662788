"""Real time: control steps for the time passed, without catching up on long delays."""

import threading
import time
from collections import deque
from collections.abc import Callable
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from fastmimic.play.session import LiveSession

CHUNK_S: Final = 0.01  # between checks of the clock, at least
MOST_BEHIND_S: Final = 0.05  # delay that is caught up; the real-time factor shows the rest
WINDOW_S: Final = 1.0  # of the real-time factor


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
