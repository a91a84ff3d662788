"""The recent past of a live session, as a take for the viewer's scene and charts."""

from collections import deque
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from fastmimic.base.arrays import Array
from fastmimic.base.rotations import rotate_planar, yaw_from_quat
from fastmimic.viewer.marks import TRAIL_POINTS, TRAIL_S
from fastmimic.viewer.take import Take

if TYPE_CHECKING:
    from fastmimic.play.session import LiveSession, Snapshot


RATE_HZ: Final = 100.0
KEPT_S: Final = 2.0
PLOT_S: Final = 15.0
MEAN_S: Final = 0.5
_PLOT_HZ: Final = 12.5
_FOLLOW_S: Final = 0.6
_LEASH_M: Final = 0.25


class LiveHistory:
    """Collects snapshots of a session at `RATE_HZ`; not thread-safe."""

    def __init__(self, session: "LiveSession") -> None:
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
        """Adds the present moment."""
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
    def now(self) -> "Snapshot":
        """The last moment."""
        return self._rows[-1]

    def push(self, within_s: float) -> Array | None:
        """The last pushing force (3,) in this time, world, N; None without one."""
        rows = self._rows[-max(1, round(within_s * self.rate_hz)) :]
        return next((row.push for row in reversed(rows) if row.push.any()), None)

    def mean(self) -> tuple[float, float, float, float]:
        """Velocity forwards and to the left, m/s, turn rate, rad/s, and reward, over the last `MEAN_S`."""
        rows = self._rows[-max(1, round(MEAN_S * self.rate_hz)) :]
        found = np.mean([(*row.velocity_b[:2], row.turn_rate, row.reward) for row in rows], axis=0)
        return float(found[0]), float(found[1]), float(found[2]), float(found[3])

    def take(self) -> Take:
        """The last `KEPT_S`, with the present in the last row."""
        session, rows = self._session, self._rows

        def stacked(name: str) -> Any:
            return np.stack([getattr(row, name) for row in rows])

        return Take(
            session.robot,
            session.state,
            self.rate_hz,
            stacked("pose"),
            stacked("wanted"),
            np.zeros(len(rows), np.int64),
            np.zeros(1, np.int64),
            stacked("reference"),
            **{name: stacked(name) for name in ("measured", "stance", "force", "asked", "terms", "reward")},
            friction=session.controller.config.stance.friction,
        )

    def plot(self) -> tuple[Array, ...]:
        """The reward's plot: time before now, s, the five terms, the reward; (k,) each."""
        values = np.array(self._plot)
        values[:, 0] -= values[-1, 0]
        return tuple(np.ascontiguousarray(column) for column in values.T)
