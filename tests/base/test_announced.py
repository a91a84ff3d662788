"""Files that announce more than they hold, or unpack to more than a reader should take."""

import io
import json
import struct
import zipfile
from pathlib import Path

import numpy as np
import pytest

from fastmimic.base.errors import ConfigError, MotionError
from fastmimic.base.files import MOST_BYTES, from_json, read_arrays, read_json

HEADER = {"descr": "<f8", "fortran_order": False}


def member(shape: object, descr: str = "<f8", data: bytes = b"") -> bytes:
    text = (repr(HEADER | {"descr": descr, "shape": shape}) + "\n").encode()
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text)) + text + data


def archive(content: bytes, how: int = zipfile.ZIP_DEFLATED) -> io.BytesIO:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", how) as file:
        file.writestr("x.npy", content)
    return stream


def bomb() -> io.BytesIO:
    """Less than a megabyte that unpacks to more than may be read."""
    stream = io.BytesIO()
    about = zipfile.ZipInfo("x.npy")
    about.compress_type = zipfile.ZIP_DEFLATED
    n = MOST_BYTES // 8 + 1
    with zipfile.ZipFile(stream, "w") as file, file.open(about, "w", force_zip64=True) as data:
        np.lib.format.write_array_header_1_0(data, HEADER | {"shape": (n,)})
        block = bytes(8_000_000)
        for _ in range(n // 1_000_000 + 1):
            data.write(block)
    return stream


REFUSED = {
    "more than it holds": (archive(member((10**9,), data=bytes(80))), "announces an array of"),
    "wide texts": (archive(member((10,), "<U100000000")), "announces an array of"),
    "no size at all": (archive(member((0, 10**30))), "too large"),
    "no Python": (archive(b"\x93NUMPY\x01\x00\x03\x00'''"), "not a readable"),
    "brackets": (archive(b"\x93NUMPY\x01\x00" + struct.pack("<H", 3000) + b"(" * 3000), "not a readable"),
    "another compression": (archive(member((1,), data=bytes(8)), zipfile.ZIP_LZMA), "compressed as NumPy does not"),
}


@pytest.mark.parametrize("kind", REFUSED)
def test_an_archive_is_refused_by_what_it_announces(kind: str) -> None:
    stream, said = REFUSED[kind]
    stream.seek(0)
    with pytest.raises(MotionError, match="not a readable motion") as caught:
        read_arrays(stream, MotionError, "motion")
    assert said in str(caught.value)


@pytest.mark.slow
def test_a_bomb_is_not_unpacked() -> None:
    import tracemalloc

    stream = bomb()
    assert len(stream.getvalue()) < 1e6
    tracemalloc.start()
    with pytest.raises(MotionError, match="it unpacks to more than 500 MB"):
        read_arrays(stream, MotionError, "motion")
    assert tracemalloc.get_traced_memory()[1] < 1e7
    tracemalloc.stop()


def test_arrays_come_back() -> None:
    stream = io.BytesIO()
    given = {"empty": np.zeros((0, 12)), "text": np.str_("é"), "rows": np.zeros(3, [("a", "f8"), ("b", "i4")])}
    np.savez_compressed(stream, **given)
    found = read_arrays(stream, MotionError, "motion")
    assert all(np.array_equal(found[name], array) for name, array in given.items())


def test_json_of_more_than_python_reads_is_a_value_error(tmp_path: Path) -> None:
    (tmp_path / "deep.json").write_text("[" * 100_000)
    with pytest.raises(ConfigError, match=r"deep\.json: cannot be read \(its brackets nest too deeply\)"):
        read_json(tmp_path / "deep.json")
    assert from_json(json.dumps({"a": 10**17, "b": 10**30})) == {"a": 10**17, "b": 1e30}


@pytest.mark.parametrize("text", ["NaN", "-Infinity", "1e999", "9" * 400])
def test_json_without_a_number_is_a_value_error(text: str) -> None:
    with pytest.raises(ValueError, match=f"{text[:20]} is no finite number"):
        from_json(f'{{"a": [{text}]}}')


def test_json_with_half_a_character_is_a_value_error() -> None:
    assert from_json(r'"\ud83d\ude00"') == "\U0001f600"
    with pytest.raises(ValueError, match="surrogates not allowed"):
        from_json(r'{"a": ["\ud83d"]}')
