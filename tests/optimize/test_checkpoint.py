"""Checkpoints: what was written comes back, and nothing else is taken for one."""

import io
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from fastmimic.base.errors import CheckpointError, OutputError
from fastmimic.optimize.cma_es import Checkpoint
from fastmimic.runs.work_folder import CHECKPOINT

IDENTITY = "0123abcd"


def checkpoint(iterations: int = 3) -> Checkpoint:
    rng = np.random.default_rng(0)
    return Checkpoint(IDENTITY, rng.random((iterations, 4, 8)), rng.random((iterations, 4)), 12.5)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    path = tmp_path / CHECKPOINT
    checkpoint().save(path)
    return path


def test_its_name_says_what_it_is() -> None:
    assert "checkpoint" in CHECKPOINT


def test_comes_back_bit_for_bit(path: Path) -> None:
    original, found = checkpoint(), Checkpoint.load(path, IDENTITY)
    assert found.identity == IDENTITY
    assert found.candidates.tobytes() == original.candidates.tobytes()
    assert found.scores.tobytes() == original.scores.tobytes()
    assert found.elapsed_s == 12.5


def test_a_new_one_replaces_the_old_one_and_leaves_nothing_else_behind(path: Path) -> None:
    checkpoint(5).save(path)
    assert len(Checkpoint.load(path, IDENTITY).scores) == 5
    assert [p.name for p in path.parent.iterdir()] == [CHECKPOINT]


def test_of_another_problem(path: Path) -> None:
    with pytest.raises(CheckpointError, match=r"of another problem .* choose another output folder"):
        Checkpoint.load(path, "another")


def test_missing(tmp_path: Path) -> None:
    with pytest.raises(CheckpointError, match=r"none\.npz: no checkpoint to resume from; leave out --resume"):
        Checkpoint.load(tmp_path / "none.npz", IDENTITY)


def test_of_a_later_release(path: Path) -> None:
    with np.load(path) as file:
        arrays = dict(file)
    np.savez(path, **{**arrays, "version": np.int64(99)})
    with pytest.raises(CheckpointError, match="version 99; this release reads version 1"):
        Checkpoint.load(path, IDENTITY)


@pytest.mark.parametrize("name", ["version", "identity", "candidates", "scores", "elapsed_s"])
def test_incomplete(path: Path, name: str) -> None:
    with np.load(path) as file:
        arrays = dict(file)
    del arrays[name]
    np.savez(path, **arrays)
    with pytest.raises(CheckpointError, match="damaged checkpoint"):
        Checkpoint.load(path, IDENTITY)


@pytest.mark.parametrize(
    "changes",
    [
        {"scores": np.zeros((2, 4))},
        {"candidates": np.zeros((3, 4))},
        {"scores": np.zeros(3)},
    ],
)
def test_whose_parts_do_not_fit(path: Path, changes: dict[str, np.ndarray]) -> None:
    with np.load(path) as file:
        arrays = dict(file)
    np.savez(path, **{**arrays, **changes})
    with pytest.raises(CheckpointError, match="damaged checkpoint"):
        Checkpoint.load(path, IDENTITY)


def lone_array() -> bytes:
    buffer = io.BytesIO()
    np.save(buffer, np.zeros(3))
    return buffer.getvalue()


@pytest.mark.parametrize("content", [b"", b"PK\x03\x04", b"not a checkpoint at all", lone_array()])
def test_something_else(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / CHECKPOINT
    path.write_bytes(content)
    with pytest.raises(CheckpointError, match="damaged checkpoint"):
        Checkpoint.load(path, IDENTITY)


def test_a_folder(tmp_path: Path) -> None:
    with pytest.raises(CheckpointError):
        Checkpoint.load(tmp_path, IDENTITY)


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_damaged_anywhere_it_is_refused_or_unharmed(path: Path, data: st.DataObject) -> None:
    """Cut off, or with a byte changed: a clear error, or exactly what was written."""
    whole = path.read_bytes()
    damaged = bytearray(whole)
    if data.draw(st.booleans()):
        del damaged[data.draw(st.integers(0, len(whole) - 1)) :]
    else:
        damaged[data.draw(st.integers(0, len(whole) - 1))] ^= data.draw(st.integers(1, 255))
    broken = path.with_name("broken.npz")
    broken.write_bytes(damaged)
    try:
        found = Checkpoint.load(broken, IDENTITY)
    except CheckpointError:
        return
    assert found.candidates.tobytes() == checkpoint().candidates.tobytes()
    assert found.scores.tobytes() == checkpoint().scores.tobytes()


def test_where_nothing_can_be_written(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(OutputError, match="cannot be written"):
        checkpoint().save(tmp_path / "file" / CHECKPOINT)
