"""DDS domains and their participants."""

import ctypes
import socket
import threading
from typing import Any, Final, Self

from fastmimic.base.errors import DriverError
from fastmimic.deploy.dds.cyclone import checked, cyclone, loaned
from fastmimic.deploy.dds.types import Message, described

LOOPBACK: Final = "lo"
MAX_DOMAIN: Final = 230  # above, the domain's UDP ports would exceed the range
MAX_PARTICIPANTS: Final = 10  # per computer and domain; 0.10.2 looks for no more

_NOT_NOW: Final = -4  # DDS_RETCODE_PRECONDITION_NOT_MET
_PUBLICATIONS: Final = 0x7FFF0000 + 3  # the built-in topic of everybody's writers


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


def configuration(interface: str) -> str:
    """CycloneDDS's configuration for a network interface: peers are found by port on loopback, else by multicast."""
    general, discovery = f'<Interfaces><NetworkInterface name="{interface}"/></Interfaces>', ""
    if interface == LOOPBACK:
        general += "<AllowMulticast>false</AllowMulticast>"
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
            handle = dds.dds_create_domain(domain, configuration(interface).encode())
            if handle < 0:
                raise DriverError(_why_not(handle, domain, interface))
            found = _domains[domain] = _OpenDomain(handle, interface)
        elif found.interface != interface:
            raise DriverError(
                f"DDS domain {domain} is already open on '{found.interface}' in this process, not on '{interface}'"
            )
        found.users += 1


def _why_not(code: int, domain: int, interface: str) -> str:
    if code == _NOT_NOW:
        return f"DDS domain {domain} has been opened by something else in this process"
    if interface == LOOPBACK and not any(_free(port) for port in _ports(domain)):
        return (
            f"no place left in DDS domain {domain} on '{interface}': {MAX_PARTICIPANTS} programs of this computer use"
            " it; end some, or use another domain"
        )
    reason = cyclone().dds_strretcode(code).decode()
    return f"DDS cannot use '{interface}' ({reason}): is it up, and has it an IPv4 address?"


def _ports(domain: int) -> range:
    """The unicast UDP ports of a domain's participants; RTPS 2.5, section 9.6.2."""
    first = 7400 + 250 * domain + 10
    return range(first, first + 2 * MAX_PARTICIPANTS, 2)


def _free(port: int) -> bool:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.bind(("127.0.0.1", port))
        except OSError:
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
    """A participant in a DDS domain (0 … `MAX_DOMAIN`; robots are in 0). A context manager; not thread-safe. Raises
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
        self._handle = dds.dds_create_participant(domain, None, None)
        if self._handle < 0:
            leave_domain(domain)
            raise DriverError(_why_not(self._handle, domain, interface))

    def topic(self, name: str, message: type[Message]) -> int:
        """The handle of a topic, created at the first call."""
        known = self._topics.get(name)
        if known is None:
            descriptor, memory = described(message)
            self._kept += [descriptor, memory]
            handle = cyclone().dds_create_topic(self._handle, ctypes.byref(descriptor), name.encode(), None, None)
            known = self._topics[name] = (message, checked(handle, f"topic {name}"))
        assert known[0] is message
        return known[1]

    def publishers(self, topic: str) -> list[str]:
        """The types of all known writers of a topic, including our own."""
        dds = cyclone()
        reader = checked(dds.dds_create_reader(self._handle, _PUBLICATIONS, None, None), "the built-in topic")
        found = loaned(reader, 256, _Endpoint, lambda e: (e.topic_name.decode(), e.type_name.decode()))
        dds.dds_delete(reader)
        return [kind for name, kind in found if name == topic]

    @property
    def handle(self) -> int:
        return self._handle

    def close(self) -> None:
        """Leaves the domain with all readers and writers; may be called twice."""
        if self._handle > 0:
            cyclone().dds_delete(self._handle)
            self._handle = 0
            leave_domain(self.domain)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
