"""Playback: the present row and the next."""

import math
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

Repeat = Literal["all", "cycle", "off"]
REPEATS: Final[tuple[Repeat, ...]] = ("all", "cycle", "off")


@dataclass
class Player:
    """A position in the rows of a take that advances in real time.

    Attributes:
        rate_hz: rows a second of real time.
        cycle_starts: first rows of the cycles, ascending from 0.
        speed: times real time, positive.
        repeat: at the end start again ("all"), stop ("off"), or repeat the present cycle ("cycle").
    """

    rows: int
    rate_hz: float
    cycle_starts: NDArray[np.int64]
    playing: bool = True
    speed: float = 1.0
    repeat: Repeat = "all"
    _position: float = 0.0

    def load(self, rows: int, rate_hz: float, cycle_starts: NDArray[np.int64]) -> None:
        """Starts another take, at the same speed."""
        self.rows, self.rate_hz, self.cycle_starts = rows, rate_hz, cycle_starts
        self._position = 0.0

    @property
    def row(self) -> int:
        """The row to show."""
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
        """Goes to the nearest row."""
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
