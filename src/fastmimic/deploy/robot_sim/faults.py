"""What goes wrong on a wire, on purpose."""

import math
from collections import deque
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fastmimic.base.errors import ConfigError


@dataclass(frozen=True, kw_only=True)
class Faults:
    """Of one direction of the wire. None by default.

    Attributes:
        loss, corrupt, duplicate, reorder: share of the messages that are lost, arrive with a bit flipped, arrive twice,
            or arrive after the next one.
        latency_s: until a message arrives, besides what the wire itself needs.
    """

    loss: float = 0.0
    corrupt: float = 0.0
    duplicate: float = 0.0
    reorder: float = 0.0
    latency_s: float = 0.0

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if not (math.isfinite(value) and 0.0 <= value <= 1.0):
                raise ConfigError(f"faults: {field.name} must be from 0 to 1, found {value:g}")


class FaultyLine:
    """Messages on their way, with faults.

    Args:
        faults: which.
        rng: what the faults are drawn from.

    Attributes:
        lost, corrupted: how many messages were.
    """

    def __init__(self, faults: Faults, rng: np.random.Generator) -> None:
        self._faults, self._rng = faults, rng
        self._queue: deque[tuple[float, NDArray[Any]]] = deque()
        self._late: NDArray[Any] | None = None
        self.lost = self.corrupted = 0

    def push(self, message: NDArray[Any], now: float) -> None:
        """Sends a message (1,), which is copied, at a time in s."""
        faults = self._faults
        loss, corrupt, duplicate, reorder = self._rng.random(4)
        if loss < faults.loss:
            self.lost += 1
            return
        message = message.copy()
        if corrupt < faults.corrupt:
            self.corrupted += 1
            octets = message.view(np.uint8)
            octets[self._rng.integers(4, len(octets))] ^= np.uint8(1 << self._rng.integers(8))
        if self._late is None and reorder < faults.reorder:
            self._late = message
            return
        due = now + faults.latency_s
        self._queue.append((due, message))
        if self._late is not None:
            self._queue.append((due, self._late))
            self._late = None
        if duplicate < faults.duplicate:
            self._queue.append((due, message))

    def pop(self, now: float) -> list[NDArray[Any]]:
        """What has arrived by a time in s, each (1,)."""
        arrived = []
        while self._queue and self._queue[0][0] <= now:
            arrived.append(self._queue.popleft()[1])
        return arrived
