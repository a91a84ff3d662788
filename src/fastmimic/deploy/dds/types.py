"""Message types: read from IDL, laid out as C structures, and described to CycloneDDS for serialisation."""

import ctypes
import re
from functools import cache
from typing import Any, ClassVar, Final

from fastmimic.base.files import packaged

DECLARED: Final = packaged("fastmimic.deploy.dds", "cyclone.json", dict[str, dict[str, Any]])
"""CycloneDDS's functions, each with a result and its arguments, and structures; and IDL's types in C, with type codes
and flags (signed 8, floating point 4): dds/ddsc/dds_opcodes.h."""
_PRIMITIVES: Final = {name: getattr(ctypes, kind) for name, (kind, *_) in DECLARED["primitives"].items()}
_CODES: Final = {getattr(ctypes, kind): (code, flags) for kind, code, flags in DECLARED["primitives"].values()}
_ADR, _SEQUENCE, _ARRAY, _STRUCTURE, _END = 1 << 24, 7 << 16, 8 << 16, 10, 0
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


@cache
def sequence_of(element: Any) -> Any:
    """The structure of an unbounded sequence."""
    return type("Sequence", (structure("dds_sequence_t"),), {"element": element})


_Descriptor: Final = structure("dds_topic_descriptor_t")
"""That of 0.10 and 11, without a description of the type for peers."""

_TOKEN: Final = re.compile(r"module (\w+) {|struct (\w+) {([^}]*)}|}")
_MEMBER: Final = re.compile(r"(sequence<)?(\w[\w ]*?)>?\s+(\w+)(?:\[(\d+)\])?;")


def messages_of(idl: str) -> dict[str, Any]:
    """The structures of an IDL as `Message` classes by their full names. It may contain modules, structures, comments,
    `_PRIMITIVES`, unbounded sequences and arrays of one dimension."""
    known: dict[str, Any] = dict(_PRIMITIVES)
    found, modules = {}, []
    for module, struct, body in _TOKEN.findall(re.sub(r"//.*", "", idl)):
        if module:
            modules.append(module)
        elif struct:
            fields = []
            for sequence, kind, name, length in _MEMBER.findall(body):
                element = sequence_of(known[kind]) if sequence else known[kind]
                fields.append((name, element * int(length) if length else element))
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
        elif hasattr(kind, "element"):
            code, flags = _CODES.get(kind.element, (_STRUCTURE, 0))
            instructions += [_ADR | _SEQUENCE | code << 8 | flags, at]
            if code == _STRUCTURE:
                inner = [*program(kind.element), _END]
                instructions += [ctypes.sizeof(kind.element), 4 + len(inner) << 16 | 4, *inner]
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
    if ctypes.c_char_p in kinds or any(hasattr(kind, "element") for kind in kinds):
        return False
    return all(fixed_size(kind) for kind in kinds if issubclass(kind, ctypes.Structure))


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
