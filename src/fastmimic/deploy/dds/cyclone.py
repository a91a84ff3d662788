"""CycloneDDS through its C library: domains, participants, readers and writers."""

import contextlib
import ctypes
import functools
import glob
import os
import socket
import struct
import threading
from collections.abc import Callable, Iterable
from typing import Any, Final, TypeVar

import numpy as np
from numpy.typing import NDArray

from fastmimic.base.arrays import Records
from fastmimic.base.errors import DriverError
from fastmimic.deploy.dds.types import DECLARED, Message, described, fixed_size, structure

T = TypeVar("T")

LOOPBACK: Final = "lo"
MAX_DOMAIN: Final = 230  # above, the domain's UDP ports would exceed the range
MAX_PARTICIPANTS: Final = 10  # per computer and domain; 0.10.2 looks for no more

_NOT_NOW: Final = -4  # DDS_RETCODE_PRECONDITION_NOT_MET
_PUBLICATIONS: Final = 0x7FFF0000 + 3  # the built-in topic of everybody's writers
_KEEP_LAST, _BEST_EFFORT, _RELIABLE, _XCDR1 = 0, 0, 1, 0
_ANY_STATE: Final = 0x7F
_NOT_OWN: Final = 1  # DDS_IGNORELOCAL_PARTICIPANT
_SO_ATTACH_FILTER: Final = 26  # asm-generic/socket.h
_TEXTS: Final = 16  # queued messages of a `TextReader`

SampleInfo: Final = structure("dds_sample_info_t")
Matched: Final = structure("dds_publication_matched_status_t")  # also dds_subscription_matched_status_t
_Endpoint: Final = structure("dds_builtintopic_endpoint_t")


@functools.cache
def cyclone() -> ctypes.CDLL:
    try:
        from cyclonedds.internal import CycloneDDSLoaderException, load_cyclonedds
    except ImportError:
        missing = "DDS needs CycloneDDS, which is not installed: pip install 'fastmimic[go2]'"
        raise DriverError(missing) from None
    try:
        dds: ctypes.CDLL = load_cyclonedds()
    except CycloneDDSLoaderException as error:
        raise DriverError(f"the package cyclonedds cannot find its library: {error}") from None
    for name, kinds in DECLARED["functions"].items():  # a result, and arguments
        function = getattr(dds, name)
        function.restype, *function.argtypes = (kind and getattr(ctypes, kind) for kind in kinds)
    dds.dds_set_log_mask(0)  # errors are reported by `checked`
    return dds


def checked(code: int, what: str) -> int:
    """Returns the handle or count; raises `DriverError` for an error code."""
    if code < 0:
        raise DriverError(f"{what}: CycloneDDS reports '{cyclone().dds_strretcode(code).decode()}'")
    return code


def loaned(reader: int, depth: int, structure: Any, convert: Callable[[Any], T]) -> list[T]:
    """Takes messages in the library's memory, converts them, and returns the memory."""
    dds = cyclone()
    pointers, infos = (ctypes.c_void_p * depth)(), (SampleInfo * depth)()
    taken = checked(dds.dds_take(reader, pointers, infos, depth, depth), "taking messages")
    try:
        return [convert(structure.from_address(pointers[i])) for i in range(taken) if infos[i].valid]
    finally:
        if taken > 0:
            dds.dds_return_loan(reader, pointers, taken)


def configuration(interface: str) -> str:
    """CycloneDDS's configuration for an interface: peers are found by multicast, on loopback by port as well."""
    general, discovery = f'<Interfaces><NetworkInterface name="{interface}"/></Interfaces>', ""
    if interface == LOOPBACK:
        general += "<AllowMulticast>spdp</AllowMulticast>"
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
    """A domain of this process; CycloneDDS allows one configuration each."""

    def __init__(self, handle: int, interface: str) -> None:
        self.handle, self.interface, self.users = handle, interface, 0


_domains: Final[dict[int, _OpenDomain]] = {}
_domains_lock: Final = threading.Lock()


def enter_domain(domain: int, interface: str) -> None:
    dds = cyclone()
    with _domains_lock:
        found = _domains.get(domain)
        if found is None:
            before = open_sockets()
            handle = dds.dds_create_domain(domain, configuration(interface).encode())
            if handle < 0:
                raise DriverError(_why_not(handle, domain, interface))
            try:
                receive_by(interface, (number for name, number in open_sockets().items() if name not in before))
            except OSError as error:
                dds.dds_delete(handle)
                raise DriverError(f"DDS cannot be kept to '{interface}': {error.strerror}") from None
            found = _domains[domain] = _OpenDomain(handle, interface)
        elif found.interface != interface:
            said = f"DDS domain {domain} is already open on '{found.interface}' in this process"
            raise DriverError(f"{said}, not on '{interface}'")
        found.users += 1


def open_sockets() -> dict[str, int]:
    """File descriptors of this process's sockets, by the sockets' names; none where there is no Linux."""
    found = {os.path.realpath(path): int(os.path.basename(path)) for path in glob.glob("/proc/self/fd/*")}
    return {name: number for name, number in found.items() if "socket:" in name}


def receive_by(interface: str, descriptors: Iterable[int]) -> None:
    """Has the UDP sockets at all addresses among these receive what comes by this interface or from this computer only.
    CycloneDDS binds so whatever its configuration says (its issues 1923 and 2090). SO_BINDTODEVICE would also drop what
    this computer's programs send to the interface's address. Raises `OSError`."""
    for descriptor in descriptors:
        with socket.socket(fileno=os.dup(descriptor)) as opened:
            if opened.type == socket.SOCK_DGRAM and opened.getsockname()[:1] == ("0.0.0.0",):
                given, local = socket.if_nametoindex(interface), socket.if_nametoindex(LOOPBACK)
                # classic BPF: load the packet's interface; jump 2 or 1 on if it is this one; return none, or all of it
                steps = (0x20, 0, 0, 0xFFFFF008, 0x15, 2, 0, given, 0x15, 1, 0, local, 6, 0, 0, 0, 6, 0, 0, 0xFFFFFFFF)
                program = ctypes.create_string_buffer(struct.pack(5 * "HBBI", *steps))
                opened.setsockopt(socket.SOL_SOCKET, _SO_ATTACH_FILTER, struct.pack("HP", 5, ctypes.addressof(program)))


def _why_not(code: int, domain: int, interface: str) -> str:
    if code == _NOT_NOW:
        return f"DDS domain {domain} has been opened by something else in this process"
    if interface == LOOPBACK and _full(domain):
        users = f"{MAX_PARTICIPANTS} programs of this computer use it; end some, or use another domain"
        return f"no place left in DDS domain {domain} on '{interface}': {users}"
    reason = cyclone().dds_strretcode(code).decode()
    return f"DDS cannot use '{interface}' ({reason}): is it up, and has it an IPv4 address?"


def _full(domain: int) -> bool:
    """Whether all unicast UDP ports of a domain's participants are taken; RTPS 2.5, section 9.6.2."""
    for number in range(MAX_PARTICIPANTS):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe, contextlib.suppress(OSError):
            probe.bind(("127.0.0.1", 7400 + 250 * domain + 10 + 2 * number))
            return False
    return True


def leave_domain(domain: int) -> None:
    with _domains_lock:
        found = _domains[domain]
        found.users -= 1
        if found.users == 0:
            del _domains[domain]
            cyclone().dds_delete(found.handle)


class Participant:
    """A participant in a DDS domain (0 … `MAX_DOMAIN`; robots are in 0). Not thread-safe. Raises
    `DriverError` without CycloneDDS, for an unknown interface or domain, or if the domain is full."""

    def __init__(self, domain: int, interface: str = LOOPBACK) -> None:
        if not 0 <= domain <= MAX_DOMAIN:
            raise DriverError(f"a DDS domain is a number from 0 to {MAX_DOMAIN}, found {domain}")
        check_interface(interface)
        dds = cyclone()
        enter_domain(domain, interface)
        self.domain, self.interface = domain, interface
        self._topics: dict[str, tuple[type[Message], int]] = {}
        self._kept: list[Any] = []
        self.handle = dds.dds_create_participant(domain, None, None)
        if self.handle < 0:
            leave_domain(domain)
            raise DriverError(_why_not(self.handle, domain, interface))

    def topic(self, name: str, message: type[Message]) -> int:
        """The handle of a topic, created at the first call."""
        known = self._topics.get(name)
        if known is None:
            descriptor, memory = described(message)
            self._kept += [descriptor, memory]
            handle = cyclone().dds_create_topic(self.handle, ctypes.byref(descriptor), name.encode(), None, None)
            known = self._topics[name] = (message, checked(handle, f"topic {name}"))
        assert known[0] is message
        return known[1]

    def publishers(self, topic: str) -> list[str]:
        """The types of all known writers of a topic, including our own."""
        dds = cyclone()
        reader = checked(dds.dds_create_reader(self.handle, _PUBLICATIONS, None, None), "the built-in topic")
        found = loaned(reader, 256, _Endpoint, lambda e: (e.topic_name.decode(), e.type_name.decode()))
        dds.dds_delete(reader)
        return [kind for name, kind in found if name == topic]

    def close(self) -> None:
        """Leaves the domain with all readers and writers; may be called twice."""
        if self.handle > 0:
            cyclone().dds_delete(self.handle)
            self.handle = 0
            leave_domain(self.domain)


def _endpoint(
    kind: str, participant: Participant, topic: str, message: type[Message], reliable: bool, depth: int, own: bool
) -> int:
    """A new "reader" or "writer" with CDR 1, as 0.10 writes; `own`: whether it hears and serves its own participant."""
    dds = cyclone()
    qos = dds.dds_create_qos()
    dds.dds_qset_reliability(qos, _RELIABLE if reliable else _BEST_EFFORT, 0)
    dds.dds_qset_history(qos, _KEEP_LAST, depth)
    dds.dds_qset_ignorelocal(qos, 0 if own else _NOT_OWN)
    dds.dds_qset_data_representation(qos, 1, (ctypes.c_int16 * 1)(_XCDR1))
    create = getattr(dds, f"dds_create_{kind}")
    handle = create(participant.handle, participant.topic(topic, message), qos, None)
    dds.dds_delete_qos(qos)
    return checked(handle, f"a {kind} of {topic}")


def _matched(ask: Callable[..., int], handle: int) -> int:
    """Number of peers of a reader or writer."""
    status = Matched()
    ask(handle, ctypes.byref(status))
    return int(status.current)


class Writer:
    """Sends messages of one topic; reliable for readers that request it, but never waits. `write` sends `message`;
    `record` (1,) is the same memory as a NumPy structure."""

    def __init__(self, participant: Participant, topic: str, message: type[Message]) -> None:
        self._participant = participant
        self.message = message()
        self.record = np.frombuffer(memoryview(self.message), np.dtype(message)) if fixed_size(message) else None
        self._handle = _endpoint("writer", participant, topic, message, True, 1, True)
        self._address = ctypes.addressof(self.message)
        self._write = cyclone().dds_write

    def write(self) -> bool:
        """Sends `message`; False if it had to be dropped."""
        return bool(self._write(self._handle, self._address) == 0)

    def matched(self) -> int:
        return _matched(cyclone().dds_get_publication_matched_status, self._handle)


class Reader:
    """Receives messages of one topic and a fixed size, into its own memory; of a queue beyond `depth` the oldest are
    lost. `samples` (depth,) are NumPy structures, their padding zero, those of the last `take` first; `valid` is False
    for the notice that a writer has gone; `publication` is the writer."""

    def __init__(
        self, participant: Participant, topic: str, message: type[Message], depth: int = 64, *, own: bool = True
    ) -> None:
        """`own`: whether messages of this participant's own writers are received."""
        assert fixed_size(message)
        dds, size = cyclone(), ctypes.sizeof(message)
        self._participant = participant
        self._memory = (message * depth)()
        self._infos = (SampleInfo * depth)()
        first = ctypes.addressof(self._memory)
        self._pointers = (ctypes.c_void_p * depth)(*(first + i * size for i in range(depth)))
        self.samples: Records = np.frombuffer(memoryview(self._memory), np.dtype(message))
        infos = np.frombuffer(memoryview(self._infos), np.dtype(SampleInfo))
        self.valid: NDArray[np.bool_] = infos["valid"]
        self.publication: NDArray[np.uint64] = infos["publication"]
        self._handle = _endpoint("reader", participant, topic, message, False, depth, own)
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
        return _matched(cyclone().dds_get_subscription_matched_status, self._handle)


class TextReader:
    """Receives messages with strings or sequences, in the library's memory."""

    def __init__(self, participant: Participant, topic: str, message: type[Message]) -> None:
        self._participant, self._message = participant, message
        self._handle = _endpoint("reader", participant, topic, message, True, _TEXTS, True)

    def take(self, convert: Callable[[Any], T]) -> list[T]:
        """Applies `convert` to each message that has arrived; the message is freed afterwards."""
        return loaned(self._handle, _TEXTS, self._message, convert)
