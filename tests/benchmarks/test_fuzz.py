"""The fuzzer finds what is wrong and nothing else, and makes the same input again from its seed and number."""

import json
import random
import re
import subprocess
import sys
import zipfile
from io import BytesIO
from pathlib import Path
from typing import Any

import fuzz_cases
import fuzz_files
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

PROGRAM = Path(__file__).parents[2] / "benchmarks" / "fuzz.py"


@pytest.mark.slow
def test_what_is_planted_is_found() -> None:
    command = [sys.executable, str(PROGRAM), "--planted", "--hang", "2", "--inputs", "5", "--seed", "4"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert done.returncode == 1, done.stderr
    assert "seed 4\n" in done.stdout
    verdicts = dict(re.findall(r"input \d+, planted (\w+): (\w+)", done.stdout))
    assert verdicts == {"traceback": "traceback", "hang": "hang", "memory": "memory", "death": "died"}
    assert re.search(r"refused in one line [1-9]", done.stdout)


def changed(name: str, content: bytes, source: bytes) -> bytes:
    found = b""

    @settings(database=None)
    @given(st.data())
    def make(data: Any) -> None:
        nonlocal found
        found = fuzz_files.changed_file(data.draw, name, content)

    make.hypothesis.fuzz_one_input(source)  # type: ignore[attr-defined]
    return found


def arrays() -> bytes:
    stream = BytesIO()
    np.savez(stream, rows=np.arange(12.0).reshape(4, 3), meta_json=np.str_('{"a": [1, 2]}'))
    return stream.getvalue()


VALID = {
    "a.json": json.dumps({"a": [1, {"b": 2.5}], "c": "d"}).encode(),
    "a.toml": b"a = 1\nb = 2.5\n",
    "a.csv": b"x,y,z\n1,2,3\n4,5,6\n",
    "a.xml": b'<robot name="a"><link name="b"><mass value="1"/></link></robot>',
    "a.npz": arrays(),
    "a.c3d": bytes(range(200)),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", VALID)
def test_a_file_is_changed_the_same_way_again(name: str) -> None:
    sources = [random.Random(i).randbytes(4096) for i in range(30)]
    once, again = ([changed(name, VALID[name], source) for source in sources] for _ in range(2))
    if name != "a.npz":  # in which the time is written
        assert once == again
    assert len(set(once)) > 20
    assert VALID[name] not in once[:1]


def test_the_files_of_a_worker_before_are_no_obstacle(tmp_path: Path) -> None:
    for _ in range(2):
        assert fuzz_cases._logs(tmp_path)


@pytest.mark.parametrize("kind", ["f8", "i4", "?"])
def test_numbers_are_changed_in_place_or_cut_off(kind: str) -> None:
    found: list[np.ndarray] = []

    @settings(database=None, max_examples=50)
    @given(st.data())
    def make(data: Any) -> None:
        found.append(fuzz_files.changed_numbers(data.draw, np.ones((6, 3), kind)))

    make()
    assert {array.dtype for array in found} == {np.dtype(kind)}
    assert all(array.shape[1:] == (3,) for array in found)


@pytest.mark.slow
def test_some_archives_are_bombs() -> None:
    with zipfile.ZipFile(BytesIO(fuzz_files._bomb("x"))) as archive:
        member = archive.getinfo("x.npy")
    assert member.file_size > 5e8
    assert member.compress_size < 1e6
