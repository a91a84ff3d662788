"""A participant receives by the network interface that it was given, and no other."""

import contextlib
import itertools
import os
import socket
import sys
import time
from collections.abc import Callable, Iterator
from typing import Any, Final

import pytest

pytest.importorskip("cyclonedds", reason="CycloneDDS is not installed")
if sys.platform != "linux":
    pytest.skip("the filter is one of Linux's", allow_module_level=True)

import fcntl
import struct

from deploy.dds_domains import free_domain, unicast_ports
from fastmimic.base.errors import DriverError
from fastmimic.deploy.dds import cyclone
from fastmimic.deploy.dds.cyclone import LOOPBACK, Participant, open_sockets, receive_by

GROUP: Final = "239.255.77.1"
SENT: Final = 5
_SIOCGIFADDR: Final = 0x8915


@contextlib.contextmanager
def udp(address: str = "0.0.0.0") -> Iterator[socket.socket]:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as opened:
        opened.bind((address, 0))
        opened.settimeout(0.3)
        yield opened


def address_of(interface: str) -> str | None:
    """The IPv4 address of an interface, if it has one."""
    with udp() as asked, contextlib.suppress(OSError):
        reply = fcntl.ioctl(asked, _SIOCGIFADDR, struct.pack("256s", interface.encode()))
        return socket.inet_ntoa(reply[20:24])
    return None


@pytest.fixture
def elsewhere() -> Iterator[tuple[str, Callable[[int], None]]]:
    """Another interface than loopback, and what has datagrams come by it to a port of this computer: multicast that
    does not leave it (TTL 0), which Linux gives to every socket at all addresses once one has joined the group."""
    for _, name in socket.if_nameindex():
        address = address_of(name)
        if name == LOOPBACK or address is None:
            continue
        with udp() as member, udp() as sender, contextlib.suppress(OSError):
            local = socket.inet_aton(address)
            member.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, socket.inet_aton(GROUP) + local)
            sender.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, local)
            sender.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL, 0)
            sender.sendto(b"here?", (GROUP, member.getsockname()[1]))
            if member.recv(16) == b"here?":

                def send(port: int) -> None:
                    for _ in range(SENT):
                        sender.sendto(b"elsewhere", (GROUP, port))

                yield name, send
                return
    pytest.skip("this computer has no second interface with IPv4 and multicast")


def dropped(port: int) -> int:
    """Datagrams that the kernel dropped before this process's socket at all addresses and this port."""
    own = {name.partition("[")[2].removesuffix("]") for name in open_sockets()}
    with open("/proc/net/udp") as table:
        rows = [row.split() for row in itertools.islice(table, 1, None)]
    (found,) = (row for row in rows if row[9] in own and row[1] == f"00000000:{port:04X}")
    return int(found[12])


def within(true: Callable[[], bool]) -> bool:
    end = time.monotonic() + 10.0
    while not true() and time.monotonic() < end:
        time.sleep(0.01)
    return true()


def test_without_a_filter_the_other_interface_is_heard(elsewhere: tuple[str, Callable[[int], None]]) -> None:
    name, send = elsewhere
    with udp() as open_to_all:
        send(open_to_all.getsockname()[1])
        assert open_to_all.recv(16) == b"elsewhere"
        with udp() as kept:  # to the same interface
            receive_by(name, [kept.fileno()])
            send(kept.getsockname()[1])
            assert kept.recv(16) == b"elsewhere"


def test_a_participant_on_loopback_does_not_hear_another_interface(
    elsewhere: tuple[str, Callable[[int], None]],
) -> None:
    _, send = elsewhere
    domain = free_domain()
    with contextlib.closing(Participant(domain)), udp() as sender:
        for port in unicast_ports(domain)[:2]:  # discovery, and data
            before = dropped(port)
            sender.sendto(b"by loopback", ("127.0.0.1", port))
            send(port)
            assert within(lambda port=port, before=before: dropped(port) >= before + SENT)
            assert dropped(port) == before + SENT


def test_a_participant_on_another_interface_hears_it_and_its_own_computer(
    elsewhere: tuple[str, Callable[[int], None]],
) -> None:
    name, send = elsewhere
    domain = free_domain()
    address = address_of(name)
    assert address is not None
    with contextlib.closing(Participant(domain, name)), udp() as sender:
        port = 7400 + 250 * domain  # of discovery by multicast; RTPS 2.5, section 9.6.2
        send(port)
        sender.sendto(b"its own", (address, port))
        time.sleep(0.1)
        assert dropped(port) == 0
        found = open_sockets()
        receive_by(LOOPBACK, found.values())  # so that this test can fail
        send(port)
        assert within(lambda: dropped(port) == SENT)


def test_other_sockets_of_the_process_are_left_alone(elsewhere: tuple[str, Callable[[int], None]]) -> None:
    with udp() as before, contextlib.closing(Participant(free_domain())), udp() as after:
        for other in (before, after):
            elsewhere[1](other.getsockname()[1])
            assert other.recv(16) == b"elsewhere"


def test_a_system_without_filters_is_an_error_and_opens_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: Any) -> None:
        raise OSError(92, os.strerror(92))

    domain = free_domain()
    monkeypatch.setattr(cyclone, "receive_by", refuse)
    with pytest.raises(DriverError, match="cannot be kept to 'lo': Protocol not available"):
        Participant(domain)
    monkeypatch.undo()
    Participant(domain).close()
