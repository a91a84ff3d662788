"""CycloneDDS through its C interface: messages of a fixed layout, by the names that robots know them by.

Why not through the library's Python binding: since version 11 it describes its types to every peer in a form that ends
a process with CycloneDDS 0.10.2, which is what robots and Unitree's SDK run, with a segmentation fault; and it builds
each message field by field in Python. The C interface may leave the description out, as DDS without the XTypes
extension does: peers then match by the type's name. The library serialises straight from memory in C's layout, which
is also what NumPy sees and what checksums are made over.

A message is a `ctypes.Structure`, in the order of the vendor's IDL. Both 0.10.2 and 11 are supported.
"""

import ctypes
import functools
import socket
import threading
from collections.abc import Callable
from types import TracebackType
from typing import Any, ClassVar, Final, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from fastmimic.errors import DriverError

T = TypeVar("T")

LOOPBACK: Final = "lo"
MAX_DOMAIN: Final = 230  # above, the UDP ports that a domain's number stands for run out
MAX_PARTICIPANTS: Final = 10  # of a domain on one computer; those of 0.10.2 look for no more

_CODES: Final = {
    ctypes.c_uint8: (1, 0),
    ctypes.c_bool: (14, 0),
    ctypes.c_uint16: (2, 0),
    ctypes.c_int16: (2, 8),
    ctypes.c_uint32: (3, 0),
    ctypes.c_int32: (3, 8),
    ctypes.c_float: (3, 4),
    ctypes.c_int64: (4, 8),
    ctypes.c_char_p: (5, 0),
}
"""Type codes and flags (signed 8, floating point 4) in a type's program; dds/ddsc/dds_opcodes.h."""
_ADR, _SEQUENCE, _ARRAY, _END = 1 << 24, 7 << 16, 8 << 16, 0
_FIXED_SIZE: Final = 1 << 4

_KEEP_LAST, _BEST_EFFORT, _RELIABLE, _XCDR1 = 0, 0, 1, 0
_ANY_STATE: Final = 0x7F
_NOT_NOW: Final = -4  # DDS_RETCODE_PRECONDITION_NOT_MET
_PUBLICATIONS: Final = 0x7FFF0000 + 3  # the built-in topic of everybody's writers


class Message(ctypes.Structure):
    """A DDS type. Subclasses that are sent have its name on the wire."""

    typename: ClassVar[str] = ""


class Octets(ctypes.Structure):
    """An unbounded sequence of bytes."""

    _fields_ = [
        ("maximum", ctypes.c_uint32),
        ("length", ctypes.c_uint32),
        ("buffer", ctypes.c_void_p),
        ("release", ctypes.c_bool),
    ]


def program(message: Any, offset: int = 0) -> list[int]:
    """What to serialise of a structure and in which order, in CycloneDDS's instructions; nested ones are unrolled.

    Args:
        message: a subclass of `ctypes.Structure`.
        offset: of its first byte, in bytes.
    """
    instructions: list[int] = []
    for name, kind in message._fields_:
        at = offset + getattr(message, name).offset
        if kind in _CODES:
            code, flags = _CODES[kind]
            instructions += [_ADR | code << 16 | flags, at]
        elif kind is Octets:
            instructions += [_ADR | _SEQUENCE | 1 << 8, at]
        elif issubclass(kind, ctypes.Structure):
            instructions += program(kind, at)
        elif kind._type_ in _CODES:
            code, flags = _CODES[kind._type_]
            instructions += [_ADR | _ARRAY | code << 8 | flags, at, kind._length_]
        else:
            size = ctypes.sizeof(kind._type_)
            for i in range(kind._length_):
                instructions += program(kind._type_, at + i * size)
    return instructions


def _fixed_size(message: Any) -> bool:
    kinds = [getattr(kind, "_type_", kind) if hasattr(kind, "_length_") else kind for _, kind in message._fields_]
    nested = [kind for kind in kinds if isinstance(kind, type) and issubclass(kind, ctypes.Structure)]
    return ctypes.c_char_p not in kinds and Octets not in nested and all(_fixed_size(kind) for kind in nested)


class _Blob(ctypes.Structure):
    _fields_ = [("data", ctypes.c_void_p), ("size", ctypes.c_uint32)]


class _Descriptor(ctypes.Structure):
    """dds_topic_descriptor_t, the same in 0.10 and 11. Without a description of the type for peers."""

    _fields_ = [
        ("size", ctypes.c_uint32),
        ("alignment", ctypes.c_uint32),
        ("flags", ctypes.c_uint32),
        ("keys", ctypes.c_uint32),
        ("typename", ctypes.c_char_p),
        ("key_descriptors", ctypes.c_void_p),
        ("program_length", ctypes.c_uint32),
        ("program", ctypes.POINTER(ctypes.c_uint32)),
        ("meta", ctypes.c_char_p),
        ("type_information", _Blob),
        ("type_mapping", _Blob),
        ("representations", ctypes.c_uint32),
    ]


class _Info(ctypes.Structure):
    """dds_sample_info_t."""

    _fields_ = [
        ("states", ctypes.c_int * 3),
        ("valid", ctypes.c_bool),
        ("source_timestamp", ctypes.c_int64),
        ("instance", ctypes.c_uint64),
        ("publication", ctypes.c_uint64),
        ("ranks", ctypes.c_uint32 * 5),
    ]


class _Matched(ctypes.Structure):
    """dds_publication_matched_status_t and dds_subscription_matched_status_t."""

    _fields_ = [
        ("total", ctypes.c_uint32),
        ("total_change", ctypes.c_int32),
        ("current", ctypes.c_uint32),
        ("current_change", ctypes.c_int32),
        ("last", ctypes.c_uint64),
    ]


class _Endpoint(ctypes.Structure):
    """dds_builtintopic_endpoint_t."""

    _fields_ = [
        ("key", ctypes.c_uint8 * 16),
        ("participant_key", ctypes.c_uint8 * 16),
        ("participant", ctypes.c_uint64),
        ("topic_name", ctypes.c_char_p),
        ("type_name", ctypes.c_char_p),
        ("qos", ctypes.c_void_p),
    ]


_PROTOTYPES: Final[dict[str, tuple[Any, ...]]] = {
    # name: result, arguments
    "dds_create_domain": (ctypes.c_int32, ctypes.c_uint32, ctypes.c_char_p),
    "dds_create_participant": (ctypes.c_int32, ctypes.c_uint32, ctypes.c_void_p, ctypes.c_void_p),
    "dds_create_topic": (
        ctypes.c_int32,
        ctypes.c_int32,
        ctypes.c_void_p,
        ctypes.c_char_p,
        ctypes.c_void_p,
        ctypes.c_void_p,
    ),
    "dds_create_reader": (ctypes.c_int32, ctypes.c_int32, ctypes.c_int32, ctypes.c_void_p, ctypes.c_void_p),
    "dds_create_writer": (ctypes.c_int32, ctypes.c_int32, ctypes.c_int32, ctypes.c_void_p, ctypes.c_void_p),
    "dds_create_readcondition": (ctypes.c_int32, ctypes.c_int32, ctypes.c_uint32),
    "dds_create_waitset": (ctypes.c_int32, ctypes.c_int32),
    "dds_waitset_attach": (ctypes.c_int32, ctypes.c_int32, ctypes.c_int32, ctypes.c_ssize_t),
    "dds_waitset_wait": (ctypes.c_int32, ctypes.c_int32, ctypes.c_void_p, ctypes.c_size_t, ctypes.c_int64),
    "dds_take": (
        ctypes.c_int32,
        ctypes.c_int32,
        ctypes.c_void_p,
        ctypes.c_void_p,
        ctypes.c_size_t,
        ctypes.c_uint32,
    ),
    "dds_return_loan": (ctypes.c_int32, ctypes.c_int32, ctypes.c_void_p, ctypes.c_int32),
    "dds_write": (ctypes.c_int32, ctypes.c_int32, ctypes.c_void_p),
    "dds_get_publication_matched_status": (ctypes.c_int32, ctypes.c_int32, ctypes.c_void_p),
    "dds_get_subscription_matched_status": (ctypes.c_int32, ctypes.c_int32, ctypes.c_void_p),
    "dds_delete": (ctypes.c_int32, ctypes.c_int32),
    "dds_create_qos": (ctypes.c_void_p,),
    "dds_delete_qos": (None, ctypes.c_void_p),
    "dds_qset_reliability": (None, ctypes.c_void_p, ctypes.c_int, ctypes.c_int64),
    "dds_qset_history": (None, ctypes.c_void_p, ctypes.c_int, ctypes.c_int32),
    "dds_qset_data_representation": (None, ctypes.c_void_p, ctypes.c_uint32, ctypes.c_void_p),
    "dds_strretcode": (ctypes.c_char_p, ctypes.c_int32),
    "dds_set_log_mask": (None, ctypes.c_uint32),
}


@functools.cache
def _library() -> ctypes.CDLL:
    """The library that the package `cyclonedds` brings or was built against."""
    try:
        from cyclonedds.internal import CycloneDDSLoaderException, load_cyclonedds
    except ImportError:
        raise DriverError(
            "the Go2's wire needs CycloneDDS, which is not installed: pip install 'fastmimic[go2]'"
        ) from None
    try:
        library = load_cyclonedds()
    except CycloneDDSLoaderException as error:
        raise DriverError(f"the package cyclonedds does not find its library: {error}") from None
    for name, (result, *arguments) in _PROTOTYPES.items():
        function = getattr(library, name)
        function.restype, function.argtypes = result, arguments
    library.dds_set_log_mask(0)  # what goes wrong is said in one line, by whoever asked for it
    return library


def _checked(code: int, what: str) -> int:
    if code < 0:
        raise DriverError(f"{what}: CycloneDDS says '{_library().dds_strretcode(code).decode()}'")
    return code


def configuration(interface: str) -> str:
    """CycloneDDS's configuration for one network interface: on loopback, which has no multicast, peers on this computer
    are looked for at their ports; elsewhere by multicast, as Unitree's SDK does."""
    if interface != LOOPBACK:
        general = f'<Interfaces><NetworkInterface name="{interface}"/></Interfaces>'
        discovery = ""
    else:
        general = (
            f'<Interfaces><NetworkInterface name="{LOOPBACK}"/></Interfaces><AllowMulticast>false</AllowMulticast>'
        )
        discovery = (
            "<Discovery><ParticipantIndex>auto</ParticipantIndex>"
            f"<MaxAutoParticipantIndex>{MAX_PARTICIPANTS - 1}</MaxAutoParticipantIndex>"
            '<Peers><Peer address="127.0.0.1"/></Peers></Discovery>'
        )
    return f'<CycloneDDS><Domain Id="any"><General>{general}</General>{discovery}</Domain></CycloneDDS>'


def check_interface(interface: str) -> None:
    """Raises `DriverError` if this computer has no network interface of that name."""
    names = [name for _, name in socket.if_nameindex()]
    if interface not in names:
        raise DriverError(f"no network interface '{interface}' on this computer: there are {', '.join(names)}")


class _OpenDomain:
    """A domain of this process: CycloneDDS allows one configuration for each."""

    def __init__(self, handle: int, interface: str) -> None:
        self.handle, self.interface, self.users = handle, interface, 0


_domains: Final[dict[int, _OpenDomain]] = {}
_domains_lock: Final = threading.Lock()


def _enter_domain(domain: int, interface: str) -> None:
    library = _library()
    with _domains_lock:
        found = _domains.get(domain)
        if found is None:
            handle = library.dds_create_domain(domain, configuration(interface).encode())
            if handle < 0:
                raise DriverError(_why_not(handle, domain, interface))
            found = _domains[domain] = _OpenDomain(handle, interface)
        elif found.interface != interface:
            raise DriverError(
                f"DDS domain {domain} is already open on '{found.interface}' in this process, not on '{interface}'"
            )
        found.users += 1


def _why_not(code: int, domain: int, interface: str) -> str:
    """Why a domain cannot be opened."""
    if code == _NOT_NOW:
        return f"DDS domain {domain} has been opened by something else in this process"
    if interface == LOOPBACK and not any(_free(port) for port in _ports(domain)):
        return (
            f"no place left in DDS domain {domain} on '{interface}': {MAX_PARTICIPANTS} programs of this computer are"
            " in it; end some, or take another domain"
        )
    reason = _library().dds_strretcode(code).decode()
    return f"DDS cannot use '{interface}' ({reason}): is it up, and has it an IPv4 address?"


def _ports(domain: int) -> range:
    """The UDP ports for what is sent to one program alone, of all that can be in a domain; RTPS 2.5, section 9.6.2."""
    first = 7400 + 250 * domain + 10
    return range(first, first + 2 * MAX_PARTICIPANTS, 2)


def _free(port: int) -> bool:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.bind(("127.0.0.1", port))
        except OSError:
            return False
    return True


def _leave_domain(domain: int) -> None:
    with _domains_lock:
        found = _domains[domain]
        found.users -= 1
        if found.users == 0:
            del _domains[domain]
            _library().dds_delete(found.handle)


class Participant:
    """One partaker in a DDS domain, and what it reads and writes. A context manager; not for several threads at once.

    Args:
        domain: 0 … `MAX_DOMAIN`; robots are in 0.
        interface: name of the network interface, such as `lo` or `eth0`.

    Raises:
        DriverError: no CycloneDDS, no such interface or domain, or no place left in it.
    """

    def __init__(self, domain: int, interface: str = LOOPBACK) -> None:
        if not 0 <= domain <= MAX_DOMAIN:
            raise DriverError(f"a DDS domain is a number from 0 to {MAX_DOMAIN}, found {domain}")
        check_interface(interface)
        library = _library()
        _enter_domain(domain, interface)
        self.domain, self.interface = domain, interface
        self._topics: dict[str, tuple[type[Message], int]] = {}
        self._kept: list[Any] = []
        self._handle = library.dds_create_participant(domain, None, None)
        if self._handle < 0:
            _leave_domain(domain)
            raise DriverError(_why_not(self._handle, domain, interface))

    def topic(self, name: str, message: type[Message]) -> int:
        """The handle of a topic, created when first asked for."""
        known = self._topics.get(name)
        if known is None:
            instructions = [*program(message), _END]
            array = (ctypes.c_uint32 * len(instructions))(*instructions)
            descriptor = _Descriptor(
                size=ctypes.sizeof(message),
                alignment=ctypes.alignment(message),
                flags=_FIXED_SIZE if _fixed_size(message) else 0,
                typename=message.typename.encode(),
                program_length=len(instructions),
                program=array,
                meta=b"",
            )
            self._kept += [array, descriptor]
            handle = _library().dds_create_topic(self._handle, ctypes.byref(descriptor), name.encode(), None, None)
            known = self._topics[name] = (message, _checked(handle, f"topic {name}"))
        assert known[0] is message
        return known[1]

    def publishers(self, topic: str) -> list[str]:
        """The types of all writers that are known of a topic, ours included."""
        library = _library()
        reader = _checked(library.dds_create_reader(self._handle, _PUBLICATIONS, None, None), "the built-in topic")
        found = _loaned(reader, 256, _Endpoint, lambda e: (e.topic_name.decode(), e.type_name.decode()))
        library.dds_delete(reader)
        return [kind for name, kind in found if name == topic]

    @property
    def handle(self) -> int:
        """CycloneDDS's, for readers and writers."""
        return self._handle

    def close(self) -> None:
        """Leaves the domain with all readers and writers; closing twice is allowed."""
        if self._handle > 0:
            _library().dds_delete(self._handle)
            self._handle = 0
            _leave_domain(self.domain)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


class _Qos:
    """Quality of service while an entity is created. CDR of version 1, as 0.10 writes."""

    def __init__(self, reliable: bool, depth: int) -> None:
        library = _library()
        self._qos = library.dds_create_qos()
        library.dds_qset_reliability(self._qos, _RELIABLE if reliable else _BEST_EFFORT, 0)
        library.dds_qset_history(self._qos, _KEEP_LAST, depth)
        accepted = (ctypes.c_int16 * 1)(_XCDR1)
        library.dds_qset_data_representation(self._qos, 1, accepted)

    def __enter__(self) -> Any:
        return self._qos

    def __exit__(self, *_: object) -> None:
        _library().dds_delete_qos(self._qos)


class Writer:
    """Sends messages of one topic. Reliable towards readers that ask for it, as the vendor's, but never waits.

    Attributes:
        message: what `write` sends next.
        record: (1,) the same memory as a NumPy structure.
    """

    def __init__(self, participant: Participant, topic: str, message: type[Message], depth: int = 1) -> None:
        self._participant = participant
        self.message = message()
        self.record = np.frombuffer(memoryview(self.message), np.dtype(message)) if _fixed_size(message) else None
        with _Qos(True, depth) as qos:
            handle = _library().dds_create_writer(participant.handle, participant.topic(topic, message), qos, None)
        self._handle = _checked(handle, f"a writer of {topic}")
        self._address = ctypes.addressof(self.message)
        self._write = _library().dds_write

    def write(self) -> bool:
        """Sends `message`; False if it had to be dropped."""
        return bool(self._write(self._handle, self._address) == 0)

    def matched(self) -> int:
        """How many readers there are now."""
        status = _Matched()
        _library().dds_get_publication_matched_status(self._handle, ctypes.byref(status))
        return int(status.current)


class Reader:
    """Messages of one topic and a fixed size, into memory of our own.

    Args:
        participant: whose.
        topic: its name.
        message: its type.
        depth: how many messages wait at most until they are taken; older ones are lost.

    Attributes:
        samples: (depth,) NumPy structures; those of the last `take` come first.
        words: (depth, size / 4) the same memory as 32-bit words. Padding is zero.
        valid: (depth,) whether it is a message, rather than word that its writer has gone.
        publication: (depth,) which writer it is from.
    """

    def __init__(self, participant: Participant, topic: str, message: type[Message], depth: int = 64) -> None:
        assert _fixed_size(message)
        library, size = _library(), ctypes.sizeof(message)
        self._participant, self._depth = participant, depth
        self._memory = (message * depth)()
        self._infos = (_Info * depth)()
        first = ctypes.addressof(self._memory)
        self._pointers = (ctypes.c_void_p * depth)(*(first + i * size for i in range(depth)))
        self.samples: NDArray[Any] = np.frombuffer(memoryview(self._memory), np.dtype(message))
        self.words: NDArray[np.uint32] = np.frombuffer(memoryview(self._memory), np.uint32).reshape(depth, size // 4)
        infos = np.frombuffer(memoryview(self._infos), np.dtype(_Info))
        self.valid: NDArray[np.bool_] = infos["valid"]
        self.publication: NDArray[np.uint64] = infos["publication"]
        with _Qos(False, depth) as qos:
            handle = library.dds_create_reader(participant.handle, participant.topic(topic, message), qos, None)
        self._handle = _checked(handle, f"a reader of {topic}")
        condition = _checked(library.dds_create_readcondition(self._handle, _ANY_STATE), "a read condition")
        self._waitset = _checked(library.dds_create_waitset(participant.handle), "a waitset")
        _checked(library.dds_waitset_attach(self._waitset, condition, 0), "a waitset")
        self._take, self._wait = library.dds_take, library.dds_waitset_wait
        self._arguments = (self._handle, ctypes.addressof(self._pointers), ctypes.addressof(self._infos), depth, depth)

    def take(self) -> int:
        """Takes what has arrived, oldest first; returns how many entries of `samples` and `valid` it fills."""
        return _checked(self._take(*self._arguments), "taking messages")

    def wait(self, timeout_s: float) -> bool:
        """Waits until something has arrived; False if nothing did in that time."""
        return bool(_checked(self._wait(self._waitset, None, 0, round(max(timeout_s, 0.0) * 1e9)), "waiting") > 0)

    def matched(self) -> int:
        """How many writers there are now."""
        status = _Matched()
        _library().dds_get_subscription_matched_status(self._handle, ctypes.byref(status))
        return int(status.current)

    def close(self) -> None:
        """Stops listening, before its participant does."""
        _library().dds_delete(self._waitset)
        _library().dds_delete(self._handle)


class TextReader:
    """Messages of one topic with texts or sequences in them, which the library owns."""

    def __init__(self, participant: Participant, topic: str, message: type[Message], depth: int = 16) -> None:
        self._participant, self._message, self._depth = participant, message, depth
        with _Qos(True, depth) as qos:
            handle = _library().dds_create_reader(participant.handle, participant.topic(topic, message), qos, None)
        self._handle = _checked(handle, f"a reader of {topic}")

    def take(self, convert: Callable[[Any], T]) -> list[T]:
        """What `convert` makes of each message that has arrived; the message is gone when it returns."""
        return _loaned(self._handle, self._depth, self._message, convert)


def _loaned(reader: int, depth: int, structure: Any, convert: Callable[[Any], T]) -> list[T]:
    """Takes messages in the library's memory, converts them, and hands the memory back."""
    library = _library()
    pointers, infos = (ctypes.c_void_p * depth)(), (_Info * depth)()
    taken = _checked(library.dds_take(reader, pointers, infos, depth, depth), "taking messages")
    try:
        return [convert(structure.from_address(pointers[i])) for i in range(taken) if infos[i].valid]
    finally:
        if taken > 0:
            library.dds_return_loan(reader, pointers, taken)
