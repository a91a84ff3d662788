"""A simulated network link, which delays, loses, doubles, swaps and damages messages, and its receiver."""

import heapq
import zlib
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fastmimic.base.configuration import check, documented, parameter
from fastmimic.deploy.driver import Packets, StateMessage


@documented
@dataclass(frozen=True, kw_only=True)
class LinkFaults:
    """Faults of a link in one direction; none by default."""

    latency_s: float = parameter(0.0, high=1.0, unit="s", about="latency of every message")
    loss: float = parameter(0.0, high=1.0, about="share of the messages that never arrive")
    duplicate: float = parameter(0.0, high=1.0, about="share of the messages that arrive twice")
    reorder: float = parameter(0.0, high=1.0, about="share of the messages that arrive after the next one")
    corrupt: float = parameter(0.0, high=1.0, about="share of the messages that arrive with a bit flipped")
    not_finite: float = parameter(0.0, high=1.0, about="share of the records sent as NaN")
    seed: int = parameter(0, low=None, about="seed of the faults")

    def __post_init__(self) -> None:
        check(self, "link: ")

    @property
    def perfect(self) -> bool:
        """Whether messages are at most delayed."""
        return self == LinkFaults(latency_s=self.latency_s, seed=self.seed)


@dataclass(frozen=True, order=True)
class Packet:
    """A message under way.

    Attributes:
        arrival: s.
        order: of packets with the same arrival.
        sequence: the sender's count.
        content: the record's bytes.
        checksum: CRC-32 of sequence and content as sent.
    """

    arrival: float
    order: int
    sequence: int
    content: bytes
    checksum: int


class SimulatedLink:
    """One direction of a link; counts the messages `lost` and `corrupted`."""

    def __init__(self, faults: LinkFaults, period_s: float, stream: int) -> None:
        """`period_s` is the time between two messages, s; `stream` the number of its random stream."""
        self.faults, self._period_s = faults, period_s
        self._rng = np.random.default_rng(np.random.SeedSequence([faults.seed, stream]))
        self._under_way: list[Packet] = []
        self._sent = self.lost = self.corrupted = 0

    def send(self, now: float, sequence: int, record: NDArray[Any]) -> None:
        """Sends a record (1,) at a time in s."""
        faults = self.faults
        lost = doubled = late = flipped = nan = 1.0
        if not faults.perfect:
            lost, doubled, late, flipped, nan = self._rng.random(5)
        if nan < faults.not_finite:
            record = record.copy()
            record.view(np.float64)[:] = np.nan
        content = record.tobytes()
        checksum = _checksum(sequence, content)
        if lost < faults.loss:
            self.lost += 1
            return
        if flipped < faults.corrupt:
            self.corrupted += 1
            at = int(self._rng.integers(len(content)))
            content = content[:at] + bytes([content[at] ^ 0x10]) + content[at + 1 :]
        arrival = now + faults.latency_s + (1.5 * self._period_s if late < faults.reorder else 0.0)
        for _ in range(2 if doubled < faults.duplicate else 1):
            self._sent += 1
            heapq.heappush(self._under_way, Packet(arrival, self._sent, sequence, content, checksum))

    def arrived(self, now: float) -> list[Packet]:
        """The packets that have arrived by a time in s, in order."""
        found = []
        while self._under_way and self._under_way[0].arrival <= now + 1e-9:
            found.append(heapq.heappop(self._under_way))
        return found


class Receiver:
    """Accepts packets that are intact and newer than the last one; `packets` counts all, with `sent` the sender's."""

    def __init__(self, dtype: np.dtype[Any], packets: Packets | None = None) -> None:
        self._dtype = dtype
        self.packets = packets if packets is not None else Packets()
        self._last: int | None = None

    def take(self, packet: Packet) -> StateMessage | None:
        """The record of a packet; None if it is rejected."""
        record = np.frombuffer(bytearray(packet.content), self._dtype)
        intact = packet.checksum == _checksum(packet.sequence, packet.content)
        newer = self._last is None or packet.sequence > self._last
        if not (intact and newer and np.isfinite(record.view(np.float64)).all()):
            self.packets.rejected += 1
            return None
        if self._last is not None:
            self.packets.lost += packet.sequence - self._last - 1
        self._last = packet.sequence
        self.packets.received += 1
        return StateMessage(record, packet.sequence, packet.arrival)


def _checksum(sequence: int, content: bytes) -> int:
    return zlib.crc32(content, zlib.crc32(sequence.to_bytes(8, "little", signed=True)))
