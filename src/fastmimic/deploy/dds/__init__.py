"""CycloneDDS through its C interface: messages of a fixed layout, by the names that robots know them by.

Why not through the library's Python binding: since version 11 it describes its types to every peer in a form that ends
a process with CycloneDDS 0.10.2, which is what robots and Unitree's SDK run, with a segmentation fault; and it builds
each message field by field in Python. The C interface may leave the description out, as DDS without the XTypes
extension does: peers then match by the type's name. The library serialises straight from memory in C's layout, which
is also what NumPy sees and what checksums are made over.

A message is a `ctypes.Structure`, in the order of the vendor's IDL. Both 0.10.2 and 11 are supported.
"""

from fastmimic.deploy.dds.domain import (
    LOOPBACK,
    MAX_DOMAIN,
    MAX_PARTICIPANTS,
    Participant,
    check_interface,
    configuration,
)
from fastmimic.deploy.dds.endpoints import Reader, TextReader, Writer
from fastmimic.deploy.dds.types import Message, messages_of, program

__all__ = [
    "LOOPBACK",
    "MAX_DOMAIN",
    "MAX_PARTICIPANTS",
    "Message",
    "Participant",
    "Reader",
    "TextReader",
    "Writer",
    "check_interface",
    "configuration",
    "messages_of",
    "program",
]
