"""CycloneDDS's C library: its functions, and the structures that they fill in."""

import ctypes
import functools
from collections.abc import Callable
from typing import Any, Final, TypeVar

from fastmimic.base.errors import DriverError

T = TypeVar("T")


class SampleInfo(ctypes.Structure):
    """dds_sample_info_t."""

    _fields_ = [
        ("states", ctypes.c_int * 3),
        ("valid", ctypes.c_bool),
        ("source_timestamp", ctypes.c_int64),
        ("instance", ctypes.c_uint64),
        ("publication", ctypes.c_uint64),
        ("ranks", ctypes.c_uint32 * 5),
    ]


class Matched(ctypes.Structure):
    """dds_publication_matched_status_t and dds_subscription_matched_status_t."""

    _fields_ = [
        ("total", ctypes.c_uint32),
        ("total_change", ctypes.c_int32),
        ("current", ctypes.c_uint32),
        ("current_change", ctypes.c_int32),
        ("last", ctypes.c_uint64),
    ]


_I, _U, _LONG, _SIZE = ctypes.c_int32, ctypes.c_uint32, ctypes.c_int64, ctypes.c_size_t
_TEXT, _POINTER = ctypes.c_char_p, ctypes.c_void_p
_PROTOTYPES: Final[dict[str, tuple[Any, ...]]] = {
    # name: result, arguments
    "dds_create_domain": (_I, _U, _TEXT),
    "dds_create_participant": (_I, _U, _POINTER, _POINTER),
    "dds_create_topic": (_I, _I, _POINTER, _TEXT, _POINTER, _POINTER),
    "dds_create_reader": (_I, _I, _I, _POINTER, _POINTER),
    "dds_create_writer": (_I, _I, _I, _POINTER, _POINTER),
    "dds_create_readcondition": (_I, _I, _U),
    "dds_create_waitset": (_I, _I),
    "dds_waitset_attach": (_I, _I, _I, ctypes.c_ssize_t),
    "dds_waitset_wait": (_I, _I, _POINTER, _SIZE, _LONG),
    "dds_take": (_I, _I, _POINTER, _POINTER, _SIZE, _U),
    "dds_return_loan": (_I, _I, _POINTER, _I),
    "dds_write": (_I, _I, _POINTER),
    "dds_get_publication_matched_status": (_I, _I, _POINTER),
    "dds_get_subscription_matched_status": (_I, _I, _POINTER),
    "dds_delete": (_I, _I),
    "dds_create_qos": (_POINTER,),
    "dds_delete_qos": (None, _POINTER),
    "dds_qset_reliability": (None, _POINTER, _I, _LONG),
    "dds_qset_history": (None, _POINTER, _I, _I),
    "dds_qset_data_representation": (None, _POINTER, _U, _POINTER),
    "dds_strretcode": (_TEXT, _I),
    "dds_set_log_mask": (None, _U),
}


@functools.cache
def cyclone() -> ctypes.CDLL:
    try:
        from cyclonedds.internal import CycloneDDSLoaderException, load_cyclonedds
    except ImportError:
        raise DriverError(
            "the Go2's wire needs CycloneDDS, which is not installed: pip install 'fastmimic[go2]'"
        ) from None
    try:
        dds: ctypes.CDLL = load_cyclonedds()
    except CycloneDDSLoaderException as error:
        raise DriverError(f"the package cyclonedds cannot find its library: {error}") from None
    for name, (result, *arguments) in _PROTOTYPES.items():
        function = getattr(dds, name)
        function.restype, function.argtypes = result, arguments
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
