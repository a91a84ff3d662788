"""Readers and writers of topics."""

import ctypes
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, Final, TypeVar

import numpy as np
from numpy.typing import NDArray

from fastmimic.deploy.dds.cyclone import Matched, SampleInfo, checked, cyclone, loaned
from fastmimic.deploy.dds.domain import Participant
from fastmimic.deploy.dds.types import Message, fixed_size

T = TypeVar("T")

_KEEP_LAST, _BEST_EFFORT, _RELIABLE, _XCDR1 = 0, 0, 1, 0
_ANY_STATE: Final = 0x7F


@contextmanager
def _qos(reliable: bool, depth: int) -> Iterator[Any]:
    """Quality of service of an entity, with CDR version 1, as 0.10 writes."""
    dds = cyclone()
    qos = dds.dds_create_qos()
    dds.dds_qset_reliability(qos, _RELIABLE if reliable else _BEST_EFFORT, 0)
    dds.dds_qset_history(qos, _KEEP_LAST, depth)
    dds.dds_qset_data_representation(qos, 1, (ctypes.c_int16 * 1)(_XCDR1))
    yield qos
    dds.dds_delete_qos(qos)


class Writer:
    """Sends messages of one topic; reliable for readers that request it, but never waits.

    Attributes:
        message: the message that `write` sends.
        record: (1,) the same memory as a NumPy structure.
    """

    def __init__(self, participant: Participant, topic: str, message: type[Message], depth: int = 1) -> None:
        self._participant = participant
        self.message = message()
        self.record = np.frombuffer(memoryview(self.message), np.dtype(message)) if fixed_size(message) else None
        with _qos(True, depth) as qos:
            handle = cyclone().dds_create_writer(participant.handle, participant.topic(topic, message), qos, None)
        self._handle = checked(handle, f"a writer of {topic}")
        self._address = ctypes.addressof(self.message)
        self._write = cyclone().dds_write

    def write(self) -> bool:
        """Sends `message`; False if it had to be dropped."""
        return bool(self._write(self._handle, self._address) == 0)

    def matched(self) -> int:
        """The number of readers."""
        status = Matched()
        cyclone().dds_get_publication_matched_status(self._handle, ctypes.byref(status))
        return int(status.current)


class Reader:
    """Receives messages of one topic and a fixed size, into its own memory; of a queue beyond `depth` the oldest are
    lost.

    Attributes:
        samples: (depth,) NumPy structures; those of the last `take` come first.
        words: (depth, size / 4) the same memory as 32-bit words. Padding is zero.
        valid: (depth,) True for a message, False for the notice that its writer has gone.
        publication: (depth,) its writer.
    """

    def __init__(self, participant: Participant, topic: str, message: type[Message], depth: int = 64) -> None:
        assert fixed_size(message)
        dds, size = cyclone(), ctypes.sizeof(message)
        self._participant, self._depth = participant, depth
        self._memory = (message * depth)()
        self._infos = (SampleInfo * depth)()
        first = ctypes.addressof(self._memory)
        self._pointers = (ctypes.c_void_p * depth)(*(first + i * size for i in range(depth)))
        self.samples: NDArray[Any] = np.frombuffer(memoryview(self._memory), np.dtype(message))
        self.words: NDArray[np.uint32] = np.frombuffer(memoryview(self._memory), np.uint32).reshape(depth, size // 4)
        infos = np.frombuffer(memoryview(self._infos), np.dtype(SampleInfo))
        self.valid: NDArray[np.bool_] = infos["valid"]
        self.publication: NDArray[np.uint64] = infos["publication"]
        with _qos(False, depth) as qos:
            handle = dds.dds_create_reader(participant.handle, participant.topic(topic, message), qos, None)
        self._handle = checked(handle, f"a reader of {topic}")
        condition = checked(dds.dds_create_readcondition(self._handle, _ANY_STATE), "a read condition")
        self._waitset = checked(dds.dds_create_waitset(participant.handle), "a waitset")
        checked(dds.dds_waitset_attach(self._waitset, condition, 0), "a waitset")
        self._take, self._wait = dds.dds_take, dds.dds_waitset_wait
        self._arguments = (self._handle, ctypes.addressof(self._pointers), ctypes.addressof(self._infos), depth, depth)

    def take(self) -> int:
        """Takes what has arrived, oldest first; returns the number of entries of `samples` and `valid` filled."""
        return checked(self._take(*self._arguments), "taking messages")

    def wait(self, timeout_s: float) -> bool:
        """Waits for a message; returns whether one arrived."""
        return bool(checked(self._wait(self._waitset, None, 0, round(max(timeout_s, 0.0) * 1e9)), "waiting") > 0)

    def matched(self) -> int:
        """The number of writers."""
        status = Matched()
        cyclone().dds_get_subscription_matched_status(self._handle, ctypes.byref(status))
        return int(status.current)

    def close(self) -> None:
        """Stops listening."""
        cyclone().dds_delete(self._waitset)
        cyclone().dds_delete(self._handle)


class TextReader:
    """Receives messages with strings or sequences, in the library's memory."""

    def __init__(self, participant: Participant, topic: str, message: type[Message], depth: int = 16) -> None:
        self._participant, self._message, self._depth = participant, message, depth
        with _qos(True, depth) as qos:
            handle = cyclone().dds_create_reader(participant.handle, participant.topic(topic, message), qos, None)
        self._handle = checked(handle, f"a reader of {topic}")

    def take(self, convert: Callable[[Any], T]) -> list[T]:
        """Applies `convert` to each message that has arrived; the message is freed afterwards."""
        return loaned(self._handle, self._depth, self._message, convert)
