"""Message types: read from IDL, laid out as C structures, and described to CycloneDDS for serialisation."""

import ctypes
import re
from typing import Any, ClassVar, Final

from fastmimic.base.files import packaged

DECLARED: Final = packaged("fastmimic.deploy.dds", "cyclone.json", dict[str, dict[str, Any]])
"""CycloneDDS's functions, each with a result and its arguments, and structures; and IDL's types in C, with type codes
and flags (signed 8, floating point 4): dds/ddsc/dds_opcodes.h."""
_PRIMITIVES: Final = {name: getattr(ctypes, kind) for name, (kind, *_) in DECLARED["primitives"].items()}
_CODES: Final = {getattr(ctypes, kind): (code, flags) for kind, code, flags in DECLARED["primitives"].values()}
_ADR, _SEQUENCE, _ARRAY, _END = 1 << 24, 7 << 16, 8 << 16, 0
_FIXED_SIZE: Final = 1 << 4


class Message(ctypes.Structure):
    """A DDS type; peers match it by `typename`."""

    typename: ClassVar[str] = ""


def structure(name: str) -> Any:
    """A structure of CycloneDDS, by its name there; a member has a type, and an array a length."""
    fields = []
    for member, (kind, *length) in DECLARED["structures"][name].items():
        fields.append((member, getattr(ctypes, kind) * length[0] if length else getattr(ctypes, kind)))
    return type(name, (ctypes.Structure,), {"_fields_": fields})


Octets: Final = structure("dds_sequence_octet")
"""An unbounded sequence of bytes."""
_Descriptor: Final = structure("dds_topic_descriptor_t")
"""That of 0.10 and 11, without a description of the type for peers."""

_TOKEN: Final = re.compile(r"module (\w+) {|struct (\w+) {([^}]*)}|}")
_MEMBER: Final = re.compile(r"(\w[\w<> ]*?)\s+(\w+)(?:\[(\d+)\])?;")


def messages_of(idl: str) -> dict[str, Any]:
    """The structures of an IDL as `Message` classes by their full names. It may contain modules, structures, comments,
    `_PRIMITIVES`, `sequence<octet>` and arrays of one dimension."""
    known: dict[str, Any] = {**_PRIMITIVES, "sequence<octet>": Octets}
    found, modules = {}, []
    for module, struct, body in _TOKEN.findall(re.sub(r"//.*", "", idl)):
        if module:
            modules.append(module)
        elif struct:
            fields = []
            for kind, name, length in _MEMBER.findall(body):
                fields.append((name, known[kind] * int(length) if length else known[kind]))
            typename = "::".join([*modules, struct])
            known[struct] = found[typename] = type(struct, (Message,), {"_fields_": fields, "typename": typename})
        else:
            modules.pop()
    return found


def program(message: Any, offset: int = 0) -> list[int]:
    """CycloneDDS's instructions to serialise a structure, at an offset in bytes; nested structures are unrolled."""
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


def fixed_size(message: Any) -> bool:
    """Whether the message has neither strings nor sequences."""
    kinds = [getattr(kind, "_type_", kind) if hasattr(kind, "_length_") else kind for _, kind in message._fields_]
    nested = [kind for kind in kinds if isinstance(kind, type) and issubclass(kind, ctypes.Structure)]
    return ctypes.c_char_p not in kinds and Octets not in nested and all(fixed_size(kind) for kind in nested)


def described(message: type[Message]) -> tuple[Any, Any]:
    """The descriptor of a topic's type, and the memory that it refers to."""
    instructions = [*program(message), _END]
    array = (ctypes.c_uint32 * len(instructions))(*instructions)
    descriptor = _Descriptor(
        size=ctypes.sizeof(message),
        alignment=ctypes.alignment(message),
        flags=_FIXED_SIZE if fixed_size(message) else 0,
        typename=message.typename.encode(),
        program_length=len(instructions),
        program=ctypes.addressof(array),
        meta=b"",
    )
    return descriptor, array
