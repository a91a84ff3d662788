"""Compiled kernels: what the cache on disk may and may not keep."""

import os
import subprocess
import sys
import textwrap
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fastmimic.base.jit import floats, integers, kernel, record_dtype

CALLEE = """
from fastmimic.base.jit import inlined

@inlined
def factor(x):
    return {number}.0 * x
"""
CALLER = """
from fastmimic.base.jit import kernel
from callee import factor

@kernel
def between(x):
    return factor(x)
"""
TOP = """
from fastmimic.base.jit import kernel
from caller import between

@kernel
def top(x):
    return below(x) + 1.0

@kernel
def below(x):
    return between(x)

print(top(1.0), sum(top.stats.cache_hits.values()) if hasattr(top, "stats") else 0)
"""


def run(folder: Path, cache: Path | None = None) -> tuple[float, int]:
    """The result of the kernel at the top, and whether its code came from the cache, in a process of its own."""
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(cache or folder / "cache"), "NUMBA_DISABLE_JIT": "0"}
    output = subprocess.run(
        [sys.executable, "top.py"], cwd=folder, env=environment, capture_output=True, text=True, check=True
    ).stdout.split()
    return float(output[0]), int(output[1])


@pytest.mark.slow
def test_a_cached_kernel_is_compiled_anew_when_a_function_that_it_calls_changes(tmp_path: Path) -> None:
    """Over two files and not its own: after an update, old and new code must never run mixed."""
    for name, text in (("callee", CALLEE.format(number=2)), ("caller", CALLER), ("top", TOP)):
        (tmp_path / f"{name}.py").write_text(textwrap.dedent(text))
    assert run(tmp_path) == (3.0, 0)
    assert run(tmp_path) == (3.0, 1), "the second process finds the first one's code"
    (tmp_path / "callee.py").write_text(CALLEE.format(number=10))
    assert run(tmp_path) == (11.0, 0)


CONSTANT = """
from fastmimic.base.jit import kernel
from known import NUMBER

@kernel
def top(x):
    return below(x)

@kernel
def below(x):
    return NUMBER * x

print(top(1.0), sum(top.stats.cache_hits.values()))
"""


@pytest.mark.slow
def test_another_installation_of_the_same_code_finds_what_the_first_compiled(tmp_path: Path) -> None:
    """And one in which a constant differs, in a file without any kernel, does not."""
    for name, number in (("one", 2), ("same", 2), ("other", 3)):
        (tmp_path / name).mkdir()
        (tmp_path / name / "known.py").write_text(f"NUMBER = {number}.0")
        (tmp_path / name / "top.py").write_text(CONSTANT)
    cache = tmp_path / "cache"
    assert run(tmp_path / "one", cache) == (2.0, 0)
    assert run(tmp_path / "same", cache) == (2.0, 1)
    assert run(tmp_path / "other", cache) == (3.0, 0)
    assert run(tmp_path / "one", cache) == (2.0, 1), "both are kept"


PAIR = """
from typing import NamedTuple

class Pair(NamedTuple):
    a: float
    b: float
"""
OF_A_PAIR = """
from fastmimic.base.jit import kernel
from {module} import Pair

@kernel
def top(pair):
    return pair.a + pair.b

print(top(Pair(1.0, 2.0)), sum(top.stats.cache_hits.values()))
"""


@pytest.mark.slow
def test_a_cached_kernel_whose_argument_has_moved_is_compiled_anew(tmp_path: Path) -> None:
    """Its index on disk names a module that an update removed."""
    (tmp_path / "old.py").write_text(PAIR)
    (tmp_path / "top.py").write_text(OF_A_PAIR.format(module="old"))
    assert run(tmp_path) == (3.0, 0)
    (tmp_path / "old.py").rename(tmp_path / "new.py")
    (tmp_path / "top.py").write_text(OF_A_PAIR.format(module="new"))
    assert run(tmp_path) == (3.0, 0)
    assert run(tmp_path) == (3.0, 1)


@pytest.mark.nojit
def test_records_have_their_fields_as_attributes_with_and_without_the_compiler() -> None:
    @kernel
    def fill(records: np.ndarray) -> None:
        for i in range(records.shape[0]):
            records[i].count += i
            records[i].vector[1] = 2.5

    records = np.zeros(3, record_dtype([("count", "i8"), ("vector", "f8", (3,))]))
    fill(records)
    np.testing.assert_array_equal(records["count"], [0, 1, 2])
    np.testing.assert_array_equal(records["vector"][:, 1], 2.5)


def test_fields_of_a_record_by_name_and_shape() -> None:
    found = record_dtype([*floats(one=(), three=3, matrix=(2, 4)), *integers(count=(), feet=4)])
    explicit = [("one", "f8"), ("three", "f8", (3,)), ("matrix", "f8", (2, 4)), ("count", "i8"), ("feet", "i8", (4,))]
    assert found == record_dtype(explicit)


def test_kernels_are_compiled_and_not_kept_where_no_folder_can_be_written(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """As Numba says it where neither the user's folder nor the package's can be written."""
    import numba

    njit = numba.njit

    def without_folder(**options: Any) -> Any:
        if options["cache"]:
            raise RuntimeError("cannot cache function 'doubled': no locator available for file")
        return njit(**options)

    monkeypatch.setattr(numba, "njit", without_folder)

    @kernel
    def doubled(value: float) -> float:
        return 2.0 * value

    assert doubled(3.0) == 6.0
