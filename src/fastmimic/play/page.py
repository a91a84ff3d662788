"""The page of a live session: simulation in real time in one thread, drawing of its recent past in another."""

import threading
import time
from collections import deque
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from fastmimic.base.arrays import Array
from fastmimic.base.rotations import rotate_planar, yaw_from_quat
from fastmimic.play.live_panel import PlayPanel
from fastmimic.play.session import LiveSession, Snapshot
from fastmimic.steering.commands import Commands
from fastmimic.viewer.bodies import Puppet
from fastmimic.viewer.scene import RobotScene
from fastmimic.viewer.take import TRAIL_POINTS, TRAIL_S, Take
from fastmimic.viewer.viewer import FRAMES_PER_S, IDLE_S, Cameras, WebPage

if TYPE_CHECKING:
    import viser

CHUNK_S: Final = 0.01  # between checks of the clock, at least
MOST_BEHIND_S: Final = 0.05  # delay that is caught up; the real-time factor shows the rest
WINDOW_S: Final = 1.0  # of the real-time factor
RATE_HZ: Final = 100.0  # of the history
KEPT_S: Final = 2.0
PLOT_S: Final = 15.0
MEAN_S: Final = 0.5
_PLOT_HZ: Final = 12.5
_FOLLOW_S: Final = 0.6
_LEASH_M: Final = 0.25
_PUSH_RGB: Final = (230, 120, 0)
_PUSH_S: Final = 0.6  # time that a push is shown
_LEAST_ARROW: Final = 0.5  # of the leg's length
_CLEAR_M: Final = 0.14  # the tip's distance from the trunk's middle
_CHARTS_PER_S: Final = 6.0


class Pacer:
    """Runs a session in real time in the calling thread, unless `paused`. Take `lock`, held while it steps, to use the
    session elsewhere. `pace` is simulated time per second, ≤ 1; `realtime_factor` the share reached in `WINDOW_S`. The
    velocities that come to `commands` steer the session."""

    def __init__(self, session: LiveSession, commands: Commands | None = None) -> None:
        self.session, self._commands = session, commands
        self.lock = threading.RLock()
        self.paused = False
        self.pace = 1.0
        self.realtime_factor = 1.0
        self._debt_s = 0.0
        self._window: deque[tuple[float, float, float]] = deque()

    def run(self, stop: threading.Event, record: Callable[[], None], every: int, awake: Callable[[], bool]) -> None:
        """Runs until `stop` is set, while `awake()`; `record` is called under the lock, each `every` control steps."""
        before = time.monotonic()
        while not stop.wait(CHUNK_S):
            now = time.monotonic()
            passed, before = now - before, now
            if not awake() or self.paused:
                self._window.clear()
                continue
            with self.lock:
                self.advance(passed, record, every)

    def advance(self, passed_s: float, record: Callable[[], None] | None = None, every: int = 1) -> int:
        """Takes the steps due after this much more real time; returns their number."""
        dt = self.session.dt
        if self._commands is not None and (velocity := self._commands.velocity(self.session.time_s)) is not None:
            self.session.steer(velocity)
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


class LiveHistory:
    """Collects snapshots of a session at `RATE_HZ`; not thread-safe."""

    def __init__(self, session: LiveSession) -> None:
        self._session = session
        self.every = max(1, round(session.rate_hz / RATE_HZ))  # control steps between two snapshots
        self.rate_hz = session.rate_hz / self.every
        # so that the dashes of the trails, which go by number, lie still: four of their steps at once
        self._drop = 4 * max(1, round(TRAIL_S * self.rate_hz / TRAIL_POINTS))
        self._keep = round(KEPT_S * self.rate_hz)
        self._rows: list[Snapshot] = []
        self._plot: deque[tuple[float, ...]] = deque(maxlen=round(PLOT_S * _PLOT_HZ))
        self._plot_every = max(1, round(self.rate_hz / _PLOT_HZ))
        self._count = 0
        self.followed = np.zeros(2)  # m, the robot's place without sway, for the view
        self.add()

    def add(self) -> None:
        now = self._session.snapshot()
        if not self._rows:
            self.followed = now.pose[:2].copy()
        self._rows.append(now)
        if len(self._rows) > self._keep + self._drop:
            del self._rows[: self._drop]
        velocity = rotate_planar(float(yaw_from_quat(now.pose[3:7])), now.velocity_b[:2])
        ahead = now.pose[:2] - self.followed
        self.followed = self.followed + velocity / self.rate_hz + ahead / (_FOLLOW_S * self.rate_hz)
        far = float(np.linalg.norm(now.pose[:2] - self.followed))
        if far > _LEASH_M:
            self.followed = now.pose[:2] + (self.followed - now.pose[:2]) * _LEASH_M / far
        if self._count % self._plot_every == 0:
            self._plot.append((now.time_s, *now.terms, now.reward))
        self._count += 1

    @property
    def now(self) -> Snapshot:
        return self._rows[-1]

    def push(self, within_s: float) -> Array | None:
        """The last pushing force (3,) in this time, world, N; None without one."""
        return next((row.push for row in reversed(self._last(within_s)) if row.push.any()), None)

    def mean(self) -> tuple[float, float, float, float]:
        """Velocity forwards and to the left, m/s, turn rate, rad/s, and reward, over the last `MEAN_S`."""
        values = [(*row.velocity_b[:2], row.turn_rate, row.reward) for row in self._last(MEAN_S)]
        on, left, turning, reward = np.mean(values, axis=0).tolist()
        return on, left, turning, reward

    def _last(self, seconds: float) -> list[Snapshot]:
        return self._rows[-max(1, round(seconds * self.rate_hz)) :]

    def take(self) -> Take:
        """The last `KEPT_S`, with the present in the last row."""
        session, rows = self._session, self._rows
        names = ("pose", "wanted", "reference", "measured", "stance", "force", "asked", "terms", "reward")
        stacked: dict[str, Any] = {name: np.stack([getattr(row, name) for row in rows]) for name in names}
        return Take(
            session.robot,
            session.state,
            self.rate_hz,
            samples=np.zeros(len(rows), np.int64),
            cycle_starts=np.zeros(1, np.int64),
            **stacked,
            friction=session.controller.config.stance.friction,
            terrain=session.terrain,
        )

    def plot(self) -> tuple[Array, ...]:
        """The reward's plot: time before now, s, the five terms, the reward; (k,) each."""
        values = np.array(self._plot)
        values[:, 0] -= values[-1, 0]
        return tuple(np.ascontiguousarray(column) for column in values.T)


class LiveScene(RobotScene):
    """Follows a history instead of a take."""

    def __init__(self, server: "viser.ViserServer", history: LiveHistory) -> None:
        self._history = history
        take = history.take()
        super().__init__(server, "/live", Puppet(take.robot), take)
        self._push_arrow = self._arrows("/live/push", _PUSH_RGB, 0.012)

    def _followed(self, take: Take) -> Array:
        return np.broadcast_to(self._history.followed, (take.rows, 2))

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
    """Plays a live session in this machine's browsers, on the first free port from `port` on, steered by `commands`,
    too, if there are any; raises as `WebPage`."""

    def __init__(self, session: LiveSession, heading: str, port: int, commands: Commands | None = None) -> None:
        super().__init__(port)
        self.session = session
        self.pacer = Pacer(session, commands)
        self.history = LiveHistory(session)
        self.scene = LiveScene(self.server, self.history)
        self.panel = PlayPanel(self, Cameras(self.server, session.robot, [0.0], 0.0), heading)
        self._charts_at = 0.0
        self.draw()

    def draw(self) -> None:
        moment = time.monotonic()
        with self.pacer.lock:
            take, plot = self.history.take(), self.history.plot()
        with self.server.atomic():
            self.scene.set_take(take)
            self.scene.show(take.rows - 1, follow=self.panel.follow)
            if moment - self._charts_at >= 1.0 / _CHARTS_PER_S:
                self.panel.show(take, plot)
                self._charts_at = moment

    def run(self, stop: threading.Event) -> None:
        """Plays until `stop` is set; pauses without a browser."""
        with ThreadPoolExecutor(1) as executor:
            try:  # from the first moment on: Ctrl-C may come at any
                simulation = executor.submit(self.pacer.run, stop, self.history.add, self.history.every, self.watched)
                simulation.add_done_callback(lambda _: stop.set())
                while not stop.wait(1.0 / FRAMES_PER_S if self.watched() else IDLE_S):
                    if self.watched():
                        self.draw()
                    else:
                        with self.pacer.lock:
                            self.session.prepare()
            finally:
                stop.set()
        simulation.result()
