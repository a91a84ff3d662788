"""Running the command line: in this process, which is quick, or in one of its own, which can be killed."""

import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from cli.running import QUICK_MAIN, Outcome, Run
from made_once import made_once
from searches import quick_main

__all__ = ["made_once"]  # for all tests of the folder


@pytest.fixture
def in_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty working folder; no recordings have been fetched."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("FASTMIMIC_DATA", str(tmp_path / "no-data"))
    return tmp_path


@pytest.fixture
def run(in_folder: Path, capsys: pytest.CaptureFixture[str]) -> Run:
    """Runs a command in this process, in an empty folder."""

    def call(*arguments: str | Path) -> Outcome:
        capsys.readouterr()
        status = quick_main([str(a) for a in arguments])
        captured = capsys.readouterr()
        return Outcome(status, captured.out, captured.err)

    return call


@pytest.fixture
def start(in_folder: Path) -> Iterator[Callable[..., subprocess.Popen[str]]]:
    """Starts a command in a process of its own; what is left of it is killed at the end of the test."""
    started: list[subprocess.Popen[str]] = []

    def call(*arguments: str | Path, stderr: int = subprocess.PIPE) -> subprocess.Popen[str]:
        process = subprocess.Popen(
            [sys.executable, str(QUICK_MAIN), *map(str, arguments)],
            stdout=subprocess.PIPE,
            stderr=stderr,
            text=True,
            cwd=in_folder,
            env=os.environ | {"PYTHONUNBUFFERED": "1", "PYTHONPATH": os.pathsep.join(sys.path)},
        )
        started.append(process)
        return process

    yield call
    for process in started:
        if process.poll() is None:
            process.kill()
        process.communicate()
