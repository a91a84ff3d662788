"""The files that `fuzz.py` gives to the readers: small valid ones, changed in their structure or in their bytes."""

import io
import json
import re
import struct
import xml.etree.ElementTree as ElementTree
import zipfile
from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path
from typing import Any, Final

import numpy as np
from hypothesis import strategies as st

Draw = Callable[[st.SearchStrategy[Any]], Any]
"""Draws an example of a strategy."""

NUMBERS: Final = (
    *("1e300", "-1e307", "1e-300", "1e16"),
    *("nan", "inf", "-inf", "1e999", "1e308", "-1e308", "1e-320", "0", "-0.0", "-1", "1", "2", "0.5", "1e6", "1e9"),
    *("9223372036854775807", "-9223372036854775808", "18446744073709551616", "9" * 30, "9" * 400, "1_0", "0x10", "²"),
)
TOKENS: Final = (
    *(b"nan", b"-inf", b"1e999", b",", b"\n", b"[", b"]", b"{", b"}", b"null", b"true", b'"', b"#", b"\0", b"\xff\xfe"),
    *(b"9" * 30, b"<", b"/>", b"&", b"<!--", b";", b"\t", b"\r", b"\xef\xbb\xbf", b"(" * 300, b"[" * 3000, b"-", b"="),
)
WORDS: Final = ("", " ", "x", "a\nb", "\0", "\ud800", "é", "name" * 2000, "no/..", "{}", "%s", "nan", "trot", "a1")
DTYPES: Final = ("<f8", "<f4", "<f2", "<i8", "|i1", "<u8", "?", "<c16", "<U5", "|S3", "<M8[s]", "|V4", ">f8")
VALUES: Final = (
    *(np.nan, np.inf, -np.inf, 1e308, -1e307, 1e300, -1e300, 1e155, 1e16, 1e-155, 1e-300, 1e-320),
    *(0.0, -1.0, 1.0, 1e9, 2**62, 2**53 + 1),
)
SCALES: Final = (1e300, 1e-300, 1e155, 1e16, 1e-9, -1.0)
_BOMB_MB: Final = 600


def pick(draw: Draw, among: Sequence[Any]) -> Any:
    return draw(st.sampled_from(among))


def chance(draw: Draw, one_in: int) -> bool:
    return bool(draw(st.integers(1, one_in)) == 1)


def changed_file(draw: Draw, name: str, content: bytes) -> bytes:
    """The file's content, changed as its kind of file may be wrong, as any file may be, or both."""
    by_structure = STRUCTURES.get(Path(name).suffix)
    how = draw(st.integers(0, 3))
    if by_structure is not None and how <= 2:
        content = by_structure(draw, content)
    if by_structure is None or how >= 2:
        content = changed_bytes(draw, content)
    return content


def changed_bytes(draw: Draw, content: bytes) -> bytes:
    """Bits flipped, parts cut out, repeated, replaced or put in, the end cut off."""
    for _ in range(draw(st.integers(1, 4))):
        start = draw(st.integers(0, len(content)))
        end = draw(st.integers(start, min(len(content), start + pick(draw, (1, 4, 40, 4000)))))
        part, how = content[start:end], draw(st.integers(0, 7))
        if how == 0:
            content = content[:start]
        elif how == 1:
            content = content[:start] + content[end:]
        elif how == 2:
            content = content[:start] + part * pick(draw, (2, 3, 50)) + content[end:]
        elif how == 3:
            content = content[:start] + draw(st.binary(max_size=20)) + content[end:]
        elif how == 4:
            content = content[:start] + pick(draw, TOKENS) + content[end:]
        elif how == 5 and part:
            flipped = bytes([part[0] ^ (1 << draw(st.integers(0, 7)))])
            content = content[:start] + flipped + content[start + 1 :]
        elif how == 6:  # a length or an offset of a binary format
            number = struct.pack("<I", pick(draw, (0, 1, 0xFF, 0xFFFF, 0x7FFFFFFF, 0xFFFFFFFF)))
            content = (
                content[:start] + number[: max(len(part), 1)] + content[start + len(number[: max(len(part), 1)]) :]
            )
        else:
            content = content + content[start:end]
    return content


def changed_text(draw: Draw, content: bytes) -> bytes:
    """Numbers and names of a table replaced; lines and columns repeated, left out or moved."""
    text = content.decode("utf-8", "replace")
    for _ in range(draw(st.integers(1, 3))):
        how = draw(st.integers(0, 7))
        words, lines = list(re.finditer(r"[\w.+-]+", text)), text.split("\n")
        if how <= 2 and words:
            word = pick(draw, words)
            text = text[: word.start()] + pick(draw, (*NUMBERS, *WORDS)) + text[word.end() :]
        elif how == 3:
            i = draw(st.integers(0, len(lines) - 1))
            lines[i : i + 1] = [lines[i]] * pick(draw, (0, 2, 30))
            text = "\n".join(lines)
        elif how == 4:
            i, j = draw(st.integers(0, len(lines) - 1)), draw(st.integers(0, len(lines) - 1))
            lines[i], lines[j] = lines[j], lines[i]
            text = "\n".join(lines)
        elif how == 5:  # one number in all lines
            column, value = draw(st.integers(0, 40)), pick(draw, NUMBERS)
            cells = [line.split(",") for line in lines]
            text = "\n".join(",".join([*c[:column], value, *c[column + 1 :]]) for c in cells)
        elif how == 6:  # all numbers of all lines but the first few, or of some in the middle
            first = draw(st.integers(0, min(4, len(lines))))
            end = pick(draw, (len(lines), min(first + 3, len(lines))))
            power = pick(draw, ("e300", "e-300", "e155", "e16", "e-9"))
            lines[first:end] = [re.sub(r"(\d\.\d+)\b", rf"\g<1>{power}", line) for line in lines[first:end]]
            text = "\n".join(lines)
        elif how == 7:  # few lines
            text = "\n".join([*lines[: draw(st.integers(1, 8))], *lines[len(lines) - pick(draw, (0, 0, 1)) :]])
    return text.encode("utf-8", "surrogatepass")


def values(draw: Draw) -> Any:
    """A value of JSON, also of what no program writes."""
    how = draw(st.integers(0, 7))
    if how <= 2:
        return pick(draw, (None, True, False, 0, -1, 1, 0.5, 10**17, 10**18, 10**30, 10**400, *VALUES))
    if how == 3:
        return pick(draw, WORDS)
    if how == 4:
        return [values(draw) for _ in range(draw(st.integers(0, 3)))]
    if how == 5:
        return {pick(draw, WORDS): values(draw) for _ in range(draw(st.integers(0, 2)))}
    return draw(st.floats() | st.integers() | st.text(max_size=4))


def changed_value(draw: Draw, value: Any) -> Any:
    """A JSON value, one of its parts replaced, left out, renamed, repeated or put elsewhere."""
    at, places = value, []
    while isinstance(at, dict | list) and at:
        key = pick(draw, list(at)) if isinstance(at, dict) else draw(st.integers(0, len(at) - 1))
        places.append((at, key))
        if chance(draw, 3):
            break
        at = at[key]
    if not places or chance(draw, 20):
        return values(draw)
    inside, key = places[-1]
    how = draw(st.integers(0, 5))
    if how <= 2:
        inside[key] = values(draw)
    elif how == 3:
        del inside[key]
    elif how == 4 and isinstance(inside, dict):
        inside[pick(draw, WORDS)] = inside.pop(key)
    elif isinstance(inside, list):
        inside.extend([inside[key]] * pick(draw, (1, 20)))
    else:
        inside[key] = [inside[key]]
    return value


def changed_json(draw: Draw, content: bytes) -> bytes:
    value = json.loads(content)
    for _ in range(draw(st.integers(1, 3))):
        value = changed_value(draw, value)
    text = json.dumps(value, ensure_ascii=draw(st.booleans()))
    if chance(draw, 30):
        depth = pick(draw, (900, 5000, 200_000))
        text = '{"a": ' + "[" * depth + "]" * depth + "}"
    return text.encode("utf-8", "surrogatepass")


def changed_toml(draw: Draw, content: bytes) -> bytes:
    """Settings with values of any kind."""
    names = [line.partition("=")[0].strip() for line in content.decode().splitlines()]
    kinds = (*NUMBERS, "true", '"a"', "[]", "[1, 2]", "{}", "2020-01-01", "'''", "[" * 3000, "1979-05-27T07:32:00Z")
    rows = [f"{pick(draw, names)} = {pick(draw, kinds)}" for _ in range(draw(st.integers(1, 3)))]
    return "\n".join(dict.fromkeys(rows) if chance(draw, 2) else rows).encode()


def changed_arrays(draw: Draw, content: bytes) -> bytes:
    """Arrays of an `.npz` of other types, shapes and values, left out, announced larger than they are, or a bomb."""
    with np.load(io.BytesIO(content), allow_pickle=True) as file:
        arrays = {name: file[name] for name in file.files}
    raw: dict[str, bytes] = {}
    few = chance(draw, 10)
    if few:
        arrays = few_rows(draw, arrays)
    for _ in range(draw(st.integers(0 if few else 1, 3))):
        name = pick(draw, [*arrays, *raw])
        array = arrays.pop(name, None)
        how = draw(st.integers(0, 9))
        if array is None or how == 0:
            continue
        if array.dtype.kind == "U" and array.ndim == 0 and how <= 7:
            arrays[name] = np.array(_changed_note(draw, str(array)))
        elif how == 1:
            raw[name] = announced(draw, array)
        elif how == 2:
            raw[name] = changed_bytes(draw, npy(array))
        else:
            arrays[name] = changed_array(draw, array)
    stream = io.BytesIO(_bomb(pick(draw, ["bomb", *arrays])) if chance(draw, 200) else b"")
    with zipfile.ZipFile(stream, "a", pick(draw, (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED))) as archive:
        for name, array in arrays.items():
            archive.writestr(f"{name}.npy", npy(array))
        for name, data in raw.items():
            archive.writestr(f"{name}.npy", data)
    return stream.getvalue()


def _changed_note(draw: Draw, text: str) -> str:
    try:
        note = json.dumps(changed_value(draw, json.loads(text)), ensure_ascii=True)
    except ValueError:
        note = pick(draw, WORDS)
    return note.replace("\0", "")


def changed_array(draw: Draw, array: Any) -> Any:
    how = draw(st.integers(0, 6))
    if how == 0:
        with np.errstate(all="ignore"):
            try:
                return array.astype(pick(draw, DTYPES))
            except (TypeError, ValueError, RuntimeError):  # RuntimeError: numbers as dates of too many years
                return np.zeros(array.shape, "f4")
    if how == 1:
        own = array.shape
        shape = pick(draw, ((), (0,), (1,), (2, 2), (1, *own[1:]), (*own, 1), own[1:], own[::-1], (3, 0, 4)))
        return np.resize(array, shape)
    if how == 2 and array.ndim:
        return array[: draw(st.integers(0, len(array)))]
    if how == 3:
        return np.zeros(array.shape, [("a", "f8"), ("b", "i4", (2,))])
    if how == 4:
        return np.array([{"a": 1}, None], dtype=object)
    if array.dtype.kind not in "fiu" or array.size == 0:
        return np.zeros(array.shape)
    return changed_numbers(draw, array)


def changed_numbers(draw: Draw, array: Any) -> Any:
    """Numbers of an array replaced: all, one, or some rows in the middle; or all scaled, or its end cut off."""
    out, how = np.array(array), draw(st.integers(0, 4))
    if out.size == 0:
        return out
    with np.errstate(all="ignore"):
        value = np.asarray(pick(draw, VALUES)).astype(out.dtype)
        if how == 0:
            out[...] = value
        elif how == 1:
            out.reshape(-1)[draw(st.integers(0, out.size - 1))] = value
        elif how == 2 and out.ndim:
            first = draw(st.integers(0, len(out) - 1))
            out[first : first + pick(draw, (1, 3, len(out)))] = value
        elif how == 3 and out.ndim:
            out = out[: draw(st.integers(0, 4))]
        else:
            out = (out * np.asarray(pick(draw, SCALES))).astype(out.dtype)
    return out


def few_rows(draw: Draw, arrays: dict[str, Any]) -> dict[str, Any]:
    """All arrays with as many rows as most have, cut to a few."""
    lengths = [len(array) for array in arrays.values() if array.ndim] or [0]
    rows, left = max(set(lengths), key=lengths.count), draw(st.integers(0, 4))
    return {name: array[:left] if array.ndim and len(array) == rows else array for name, array in arrays.items()}


def npy(array: Any) -> bytes:
    stream = io.BytesIO()
    np.lib.format.write_array(stream, np.asanyarray(array))
    return stream.getvalue()


def announced(draw: Draw, array: Any) -> bytes:
    """An array whose header says more or something else."""
    shape = pick(
        draw, ((10**9,), (10**12, 12), (10**30,), (-1,), (2**31, 2**31), (0, 10**30), (10**6, 10**6), "x", (1.5,))
    )
    descr = pick(draw, (array.dtype.str, "<U1000000", "<f8", "|O", "|V0", "x", [("a", "<f8")], None, {"a": []}))
    header = repr({"descr": descr, "fortran_order": pick(draw, (False, True, 0, "x")), "shape": shape})
    header = pick(
        draw, (header, header, header, header[:-3], "(" * 500, "{[]: 1}", "'''", header + "\n  x", "1" * 9000)
    )
    text = header.encode() + b"\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text)) + text + array.tobytes()


@cache
def _bomb(name: str) -> bytes:
    """An archive with an array that unpacks from less than a megabyte to some hundred."""
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        about = zipfile.ZipInfo(f"{name}.npy")
        about.compress_type = zipfile.ZIP_DEFLATED
        with archive.open(about, "w", force_zip64=True) as member:
            np.lib.format.write_array_header_1_0(
                member, {"descr": "<f8", "fortran_order": False, "shape": (_BOMB_MB * 125_000,)}
            )
            block = bytes(1_000_000)
            for _ in range(_BOMB_MB):
                member.write(block)
    return stream.getvalue()


def changed_npy(draw: Draw, content: bytes) -> bytes:
    array = np.load(io.BytesIO(content))
    return announced(draw, array) if chance(draw, 3) else npy(changed_array(draw, array))


def changed_png(draw: Draw, content: bytes) -> bytes:
    """Another size or type in the picture's header, with the right checksum."""
    import zlib

    head = bytearray(content[16:29])
    side = pick(draw, (0, 1, 2, 100, 10_000, 13_000, 100_000, 2**31 - 1, 2**32 - 1))
    start = pick(draw, (0, 4))
    head[start : start + 4] = struct.pack(">I", side)
    if chance(draw, 2):
        head[pick(draw, (8, 9, 10, 11, 12))] = draw(st.integers(0, 255))
    return content[:16] + bytes(head) + struct.pack(">I", zlib.crc32(b"IHDR" + bytes(head))) + content[33:]


_TAGS: Final = (
    *(
        "geom",
        "body",
        "joint",
        "freejoint",
        "inertial",
        "site",
        "replicate",
        "composite",
        "frame",
        "include",
        "default",
    ),
    *(
        "motor",
        "position",
        "key",
        "size",
        "compiler",
        "option",
        "texture",
        "hfield",
        "mesh",
        "numeric",
        "equality",
        "flex",
    ),
    *(
        "link",
        "visual",
        "collision",
        "origin",
        "limit",
        "axis",
        "mimic",
        "tendon",
        "sensor",
        "plugin",
        "attach",
        "model",
    ),
)
_ATTRIBUTES: Final = (
    *(
        "count",
        "type",
        "size",
        "pos",
        "quat",
        "name",
        "class",
        "childclass",
        "file",
        "range",
        "axis",
        "mass",
        "density",
    ),
    *("nrow", "ncol", "width", "height", "builtin", "memory", "nuserdata", "nkey", "qpos", "data", "offset", "fromto"),
    *("diaginertia", "fullinertia", "euler", "ref", "limited", "ctrlrange", "forcerange", "gear", "angle", "timestep"),
)
_XML_VALUES: Final = (
    *NUMBERS,
    *(
        "",
        "x",
        "0 0 0",
        "1 2 3 4",
        "nan nan nan",
        "1 1",
        "-1 -1 -1",
        "1e300 1e300 1e300",
        "1e-300 1e-300 1e-300",
        "2d",
        "sphere",
        "mesh",
        "free",
    ),
    *("100000", "1000000", "10 10 10", "100G", "robot.xml", "/dev/zero", "1 0 0", "0 1 0", "slide", "hinge", "checker"),
)


def changed_xml(draw: Draw, content: bytes) -> bytes:
    """Elements and attributes of a robot left out, repeated, put in and replaced."""
    tree = ElementTree.fromstring(content)
    for _ in range(draw(st.integers(1, 4))):
        parents = [element for element in tree.iter() if len(element)]
        parent = pick(draw, parents) if parents else tree
        child = pick(draw, list(parent)) if len(parent) else parent
        how = draw(st.integers(0, 7))
        if how == 0 and child is not parent:
            parent.remove(child)
        elif how == 1:
            parent.extend([child] * pick(draw, (1, 3)) if child is not parent else [])
        elif how == 2:
            new = ElementTree.SubElement(child, pick(draw, _TAGS))
            for _ in range(draw(st.integers(0, 3))):
                new.set(pick(draw, _ATTRIBUTES), pick(draw, _XML_VALUES))
        elif how == 3:
            child.tag = pick(draw, _TAGS)
        elif child.attrib and how <= 6:
            child.set(pick(draw, list(child.attrib)), pick(draw, _XML_VALUES))
        else:
            child.set(pick(draw, _ATTRIBUTES), pick(draw, _XML_VALUES))
    if chance(draw, 100):
        parent = pick(draw, [element for element in tree.iter() if len(element)])
        for _ in range(pick(draw, (20_000, 200_000))):
            ElementTree.SubElement(parent, "geom", {"size": ".01"})
    return ElementTree.tostring(tree)


STRUCTURES: Final[dict[str, Callable[[Draw, bytes], bytes]]] = {
    ".json": changed_json,
    ".toml": changed_toml,
    ".npz": changed_arrays,
    ".npy": changed_npy,
    ".png": changed_png,
    ".xml": changed_xml,
    ".urdf": changed_xml,
    **dict.fromkeys((".txt", ".csv", ".bvh", ".list", ".md"), changed_text),
}
