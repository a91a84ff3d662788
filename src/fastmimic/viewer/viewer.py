"""The viewer: takes, played back in a browser."""

import threading
import time
from collections.abc import Sequence
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from fastmimic.robot import Robot
from fastmimic.viewer.panel import ViewerPanel
from fastmimic.viewer.player import Player
from fastmimic.viewer.scene import animal_aside, line_up
from fastmimic.viewer.web import DEFAULT_PORT, FRAMES_PER_S, Cameras, WebPage

if TYPE_CHECKING:
    from fastmimic.render.animal import Animal
    from fastmimic.viewer.take import Take

_CHARTS_PER_S: Final = 8.0
_IDLE_S: Final = 0.05


class Viewer(WebPage):
    """Plays takes in the browsers of this machine.

    Args:
        shown: each robot's takes, left to right in the picture; one take is shown at a time.
        heading: of the panel, such as "trot on a1".
        port: the first one to try.
        animal: beside the first robot; None for none.

    Raises:
        ConfigError: viser is not installed, or no port is free.
    """

    def __init__(
        self,
        robot: Robot,
        shown: Sequence[Sequence["Take"]],
        heading: str,
        port: int = DEFAULT_PORT,
        animal: "Animal | None" = None,
    ) -> None:
        self._robot, self._shown = robot, [tuple(takes) for takes in shown]
        super().__init__(port)
        self.lock = threading.RLock()
        first = [takes[0] for takes in self._shown]
        self.player = Player(*_longest(first))
        self.robots = line_up(self.server, robot, first, animal)
        self._beside = [scene.aside for scene in self.robots]
        if animal is not None:
            self._beside.append(self._beside[0] + animal_aside(robot))
        self._cameras = Cameras(self.server, robot, self._beside, float(first[0].heading[0]))
        self.panel = ViewerPanel(
            self.server.gui,
            self.player,
            self.lock,
            self.robots,
            self._cameras.reset,
            heading,
            max(len(takes) for takes in self._shown),
            self.choose,
        )
        self._drawn: tuple[int, int] | None = None
        self._charts_at = 0.0
        self.draw(force=True)

    def choose(self, episode: int) -> None:
        """Shows another episode, from its start."""
        with self.lock:
            takes = [takes[min(episode, len(takes) - 1)] for takes in self._shown]
            for scene, take in zip(self.robots, takes, strict=True):
                scene.set_take(take)
            self.player.load(*_longest(takes))
            self.panel.set_takes()
            self.draw(force=True)

    def draw(self, *, force: bool = False) -> None:
        """Updates scene and panel if the row has changed."""
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
        while not stop.wait(_IDLE_S if not self.watched() else 0.2 / FRAMES_PER_S):
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


def _longest(takes: Sequence["Take"]) -> tuple[int, float, NDArray[np.int64]]:
    """Rows, rate and cycle starts of the longest take."""
    longest = max(takes, key=lambda take: take.rows)
    return longest.rows, longest.rate_hz, longest.cycle_starts
