"""Nobody puts a library in order while others build it."""

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from cli.running import Run
from fastmimic.base.errors import LibraryError
from fastmimic.dataset.folder import working

QUICK = ["--iterations", "3", "--population", "4", "--duration", "0.6", "--trial", "0.6", "--perturbed", "1"]


def test_many_build_and_one_mends(tmp_path: Path) -> None:
    with (
        working(tmp_path, alone=False),
        working(tmp_path, alone=False),
        pytest.raises(LibraryError, match="is being built now, and would lose what that has begun"),
        working(tmp_path, alone=True),
    ):
        pass
    with working(tmp_path, alone=True):
        for alone in (False, True):
            with pytest.raises(LibraryError, match="is being repaired now"), working(tmp_path, alone=alone):
                pass


@pytest.mark.slow
def test_who_was_killed_is_not_waited_for(tmp_path: Path) -> None:
    text = "import os, sys; from pathlib import Path; from fastmimic.dataset.folder import working\n"
    text += "with working(Path(sys.argv[1]), alone=False): os._exit(9)"
    assert subprocess.run([sys.executable, "-c", text, str(tmp_path)], check=False).returncode == 9
    with working(tmp_path, alone=True):
        pass


@pytest.mark.slow
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
