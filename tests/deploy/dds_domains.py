"""DDS domains that nobody else on this machine is in."""

import itertools
import os
import socket

_BASE, _GAIN, _UNICAST = 7400, 250, 10  # UDP ports of a domain, by the RTPS specification
_next = itertools.count(os.getpid() * 17)


def unicast_ports(domain: int) -> range:
    """UDP ports of the programs in a domain on one computer, two each, the first program's first."""
    first = _BASE + _GAIN * domain + _UNICAST
    return range(first, first + 200)


def free_domain() -> int:
    """The number of a domain without a participant on this computer."""
    for _ in range(200):
        domain = 20 + next(_next) % 200
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            try:
                probe.bind(("127.0.0.1", unicast_ports(domain)[0]))
            except OSError:
                continue
        return domain
    raise AssertionError("no DDS domain is free")
