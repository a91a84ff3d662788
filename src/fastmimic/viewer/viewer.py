"""The viewer: takes, played back in a browser, or recorded as one HTML page."""

import math
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, Literal

import numpy as np
from numpy.typing import NDArray

from fastmimic.robot import Robot
from fastmimic.viewer.panel import ViewerPanel
from fastmimic.viewer.scene import LAYERS, animal_aside, line_up
from fastmimic.viewer.web import DEFAULT_PORT, FRAMES_PER_S, Cameras, WebPage

if TYPE_CHECKING:
    from fastmimic.render.tracks import Animal
    from fastmimic.viewer.take import Take

SHOWN: Final = ("ghost", "contacts", "paths")  # layers of a recording at first; its scene tree switches others on
LONGEST_S: Final = 10.0
Repeat = Literal["all", "cycle", "off"]
_CHARTS_PER_S: Final = 8.0
_IDLE_S: Final = 0.05


@dataclass
class Player:
    """A position in the rows of a take that advances in real time. At the end it starts again (`repeat` "all"), stops
    ("off"), or repeats the present cycle ("cycle")."""

    rows: int
    rate_hz: float  # rows a second of real time
    cycle_starts: NDArray[np.int64]  # first rows of the cycles, ascending from 0
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
        self,
        robot: Robot,
        shown: Sequence[Sequence["Take"]],
        heading: str,
        port: int = DEFAULT_PORT,
        animal: "Animal | None" = None,
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
        self.panel = ViewerPanel(
            self.server.gui,
            self.player,
            self.lock,
            self.robots,
            cameras,
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


def recorded_page(robot: Robot, takes: Sequence["Take"], names: Sequence[str]) -> str:
    """One self-contained page, viser's client and a recording of its scene, with robots side by side that repeat their
    takes (of one rate), up to `LONGEST_S`; the shorter ones stay at their ends. `names` are those in the scene tree,
    without slashes. While recording, a server runs on loopback. Raises `ConfigError` as `WebPage`."""
    with WebPage() as page:
        server = page.server
        robots = line_up(server, takes, names=names)
        for name, scene in zip(names, robots, strict=True):
            for layer in LAYERS:
                scene.set_layer(layer, layer in SHOWN)
            # the robot stays in its place: its title need not move, which labels do late on a slow machine
            above = (0.0, scene.aside, robot.home_height + 0.6 * robot.leg_length)
            server.scene.add_label(f"/title/{name}", scene.take.title, position=above, anchor="bottom-center")
        Cameras(server, robot, [scene.aside for scene in robots], float(takes[0].heading[0]))
        rate_hz = takes[0].rate_hz
        last = min(max(take.rows for take in takes), round(LONGEST_S * rate_hz))
        stride = max(1, round(rate_hz / FRAMES_PER_S))
        serializer = server.get_scene_serializer()
        for row in range(0, last, stride):
            for scene in robots:
                scene.show(row, follow=True)
            serializer.insert_sleep(stride / rate_hz)
        return str(serializer.as_html())
