"""Nobody puts a library in order while others build it, wherever they are."""

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from cli.running import Run
from fastmimic.base.errors import LibraryError
from fastmimic.dataset.lock import BUILDING, MENDING, SILENT_S, working

QUICK = ["--iterations", "3", "--population", "4", "--duration", "0.6", "--trial", "0.6", "--perturbed", "1"]


def test_many_build_and_one_mends(tmp_path: Path) -> None:
    with working(tmp_path, BUILDING), working(tmp_path, BUILDING):
        assert len(list(tmp_path.glob("building-*.lock"))) == 2
        with (
            pytest.raises(LibraryError, match=f"is being built now .process {os.getpid()} on "),
            working(tmp_path, MENDING),
        ):
            pass
    with working(tmp_path, MENDING):
        with pytest.raises(LibraryError, match="is being mended now"), working(tmp_path, BUILDING):
            pass
        with pytest.raises(LibraryError, match="is being mended now"), working(tmp_path, MENDING):
            pass
    assert list(tmp_path.iterdir()) == []


def test_who_was_killed_here_is_not_waited_for(tmp_path: Path) -> None:
    text = "import os, sys; from pathlib import Path; from fastmimic.dataset.lock import working\n"
    text += "with working(Path(sys.argv[1]), 'building'): os._exit(9)"
    assert subprocess.run([sys.executable, "-c", text, str(tmp_path)], check=False).returncode == 9
    assert len(list(tmp_path.iterdir())) == 1
    with working(tmp_path, MENDING):
        assert len(list(tmp_path.iterdir())) == 1


def test_who_was_killed_elsewhere_is_waited_for_until_it_has_been_silent(tmp_path: Path) -> None:
    there = tmp_path / "building-node-7.cluster-1-abcdef.lock"
    there.write_text("another machine")
    with pytest.raises(LibraryError, match=r"process 1 on node-7\.cluster"), working(tmp_path, MENDING):
        pass
    then = there.stat().st_mtime - SILENT_S - 1
    os.utime(there, (then, then))
    with working(tmp_path, MENDING):
        assert not there.exists()


def test_a_sign_of_life_is_given_again_and_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("fastmimic.dataset.lock.BEAT_S", 0.01)
    with working(tmp_path, BUILDING):
        (sign,) = tmp_path.iterdir()
        os.utime(sign, (0, 0))
        while sign.stat().st_mtime == 0:
            pass


def test_mending_beside_a_build_is_refused_and_removes_nothing(
    start: Callable[..., subprocess.Popen[str]], run: Run, in_folder: Path
) -> None:
    pytest.importorskip("pyarrow")
    builder = start("library", "build", "trot", "pace", "--out", "lib", *QUICK, "--others", "2", "--workers", "1")
    assert builder.stderr is not None
    for line in builder.stderr:
        if line.startswith("1/2 "):
            break
    unfinished = in_folder / "lib" / "motions" / ".begun.npz.x"
    unfinished.write_bytes(b"by the builder")
    assert "is being built now" in run("library", "verify", "lib", "--mend").error
    assert unfinished.exists()
    assert builder.communicate(timeout=240)
    assert builder.returncode == 0
    assert "removed 1 files; index of 2 records" in run("library", "verify", "lib", "--mend").out
    assert not unfinished.exists()
