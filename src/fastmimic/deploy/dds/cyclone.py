"""The library: its functions, and what they fill in."""

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
def cyclone() -> ctypes.CDLL:
    """The one that the package `cyclonedds` brings or was built against."""
    try:
        from cyclonedds.internal import CycloneDDSLoaderException, load_cyclonedds
    except ImportError:
        raise DriverError(
            "the Go2's wire needs CycloneDDS, which is not installed: pip install 'fastmimic[go2]'"
        ) from None
    try:
        dds: ctypes.CDLL = load_cyclonedds()
    except CycloneDDSLoaderException as error:
        raise DriverError(f"the package cyclonedds does not find its library: {error}") from None
    for name, (result, *arguments) in _PROTOTYPES.items():
        function = getattr(dds, name)
        function.restype, function.argtypes = result, arguments
    dds.dds_set_log_mask(0)  # what goes wrong is said in one line, by whoever asked for it
    return dds


def checked(code: int, what: str) -> int:
    """A handle or count as it is; raises `DriverError` for an error's code."""
    if code < 0:
        raise DriverError(f"{what}: CycloneDDS says '{cyclone().dds_strretcode(code).decode()}'")
    return code


def loaned(reader: int, depth: int, structure: Any, convert: Callable[[Any], T]) -> list[T]:
    """Takes messages in the library's memory, converts them, and hands the memory back."""
    dds = cyclone()
    pointers, infos = (ctypes.c_void_p * depth)(), (SampleInfo * depth)()
    taken = checked(dds.dds_take(reader, pointers, infos, depth, depth), "taking messages")
    try:
        return [convert(structure.from_address(pointers[i])) for i in range(taken) if infos[i].valid]
    finally:
        if taken > 0:
            dds.dds_return_loan(reader, pointers, taken)
