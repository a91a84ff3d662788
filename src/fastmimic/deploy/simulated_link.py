"""What a wire does to messages: delays, loses, doubles, swaps and damages them; and what the receiver makes of it."""

import dataclasses
import heapq
import math
import zlib
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fastmimic.base.errors import ConfigError
from fastmimic.deploy.driver import Packets, StateMessage


@dataclass(frozen=True)
class LinkFaults:
    """A wire's faults, the same in both directions. The default has none.

    Attributes:
        latency_s: of every message, s.
        loss: share of the messages that never arrive.
        duplicated: share that arrives twice.
        reordered: share that arrives a period late, after the one that was sent next.
        corrupted: share with a bit that has flipped.
        not_finite: share of the states that are NaN, rightly transmitted.
        seed: of all that.
    """

    latency_s: float = 0.0
    loss: float = 0.0
    duplicated: float = 0.0
    reordered: float = 0.0
    corrupted: float = 0.0
    not_finite: float = 0.0
    seed: int = 0

    def __post_init__(self) -> None:
        if not (math.isfinite(self.latency_s) and 0.0 <= self.latency_s <= 1.0):
            raise ConfigError(f"link: latency_s must be 0 to 1, found {self.latency_s}")
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            if field.name not in ("latency_s", "seed") and not 0.0 <= value <= 1.0:
                raise ConfigError(f"link: {field.name} must be a share from 0 to 1, found {value}")

    @property
    def perfect(self) -> bool:
        """Whether nothing ever goes wrong."""
        return self == LinkFaults(latency_s=self.latency_s, seed=self.seed)


@dataclass(frozen=True, order=True)
class Packet:
    """Bytes on their way.

    Attributes:
        arrival: s.
        order: of the messages that arrive at one moment.
        sequence: the sender's count.
        content: the record.
        checksum: CRC-32 of sequence and content, as they were sent.
    """

    arrival: float
    order: int
    sequence: int
    content: bytes
    checksum: int


class SimulatedLink:
    """One direction of a wire."""

    def __init__(self, config: LinkFaults, period_s: float, stream: int) -> None:
        """
        Args:
            config: its faults.
            period_s: between two messages, s.
            stream: number of its random stream.
        """
        self.config, self._period_s = config, period_s
        self._rng = np.random.default_rng(np.random.SeedSequence([config.seed, stream]))
        self._under_way: list[Packet] = []
        self._sent = 0

    def send(self, now: float, sequence: int, record: NDArray[Any]) -> None:
        """Puts a record (1,) on the wire."""
        config = self.config
        lost = doubled = late = flipped = nan = 1.0
        if not config.perfect:
            lost, doubled, late, flipped, nan = self._rng.random(5)
        if nan < config.not_finite:
            record = record.copy()
            record.view(np.float64)[:] = np.nan
        content = record.tobytes()
        checksum = _checksum(sequence, content)
        if lost < config.loss:
            return
        if flipped < config.corrupted:
            at = int(self._rng.integers(len(content)))
            content = content[:at] + bytes([content[at] ^ 0x10]) + content[at + 1 :]
        arrival = now + config.latency_s + (1.5 * self._period_s if late < config.reordered else 0.0)
        for _ in range(2 if doubled < config.duplicated else 1):
            self._sent += 1
            heapq.heappush(self._under_way, Packet(arrival, self._sent, sequence, content, checksum))

    def arrived(self, now: float) -> list[Packet]:
        """What has arrived by now, in its order."""
        found = []
        while self._under_way and self._under_way[0].arrival <= now + 1e-9:
            found.append(heapq.heappop(self._under_way))
        return found


class Receiver:
    """Takes messages that are whole and newer than the last one, and counts the others.

    Attributes:
        packets: what it counts; `sent` is the sender's.
    """

    def __init__(self, dtype: np.dtype[Any], packets: Packets | None = None) -> None:
        self._dtype = dtype
        self.packets = packets if packets is not None else Packets()
        self._last: int | None = None

    def take(self, message: Packet) -> StateMessage | None:
        """The record of a message; None if it is rejected."""
        record = np.frombuffer(bytearray(message.content), self._dtype)
        whole = message.checksum == _checksum(message.sequence, message.content)
        newer = self._last is None or message.sequence > self._last
        if not (whole and newer and np.isfinite(record.view(np.float64)).all()):
            self.packets.rejected += 1
            return None
        if self._last is not None:
            self.packets.lost += message.sequence - self._last - 1
        self._last = message.sequence
        self.packets.received += 1
        return StateMessage(record, message.sequence, message.arrival)


def _checksum(sequence: int, content: bytes) -> int:
    return zlib.crc32(content, zlib.crc32(sequence.to_bytes(8, "little", signed=True)))
