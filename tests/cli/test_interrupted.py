"""Ctrl-C wherever it comes, also within a library that would swallow it."""

import signal
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from fastmimic import cli
from fastmimic.base.signals import interrupts_kept, on_signal
from fastmimic.trajectory import ipopt


@pytest.fixture(autouse=True)
def in_the_foreground() -> Iterator[None]:
    """Processes in the background of a script ignore Ctrl-C."""
    with on_signal(signal.default_int_handler, signal.SIGINT):
        yield


def test_while_the_solver_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture) -> None:
    """CasADi takes it for a solver that has stopped: other margins would be tried, and the motion be another."""
    on_nodes, calls = ipopt.on_nodes, []

    def interrupting(*of: Any) -> Callable[..., Any]:
        function = on_nodes(*of)

        def run(*values: Any) -> Any:
            calls.append(1)
            if len(calls) == 5:
                signal.raise_signal(signal.SIGINT)
            return function(*values)

        return run

    monkeypatch.setattr(ipopt, "on_nodes", interrupting)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    assert cli.main(["retarget", "trot", "--speed", "0.931", "--out", str(tmp_path / "motion.npz")]) == 130
    assert 5 <= len(calls) < 20
    assert not (tmp_path / "motion.npz").exists()
    assert capsys.readouterr().err.splitlines()[-1] == "fastmimic: interrupted"


def test_what_a_library_makes_of_it(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    """Another error after a Ctrl-C is no traceback; without one it is."""

    def dispatch(arguments: list[str]) -> int:
        try:
            if arguments:
                signal.raise_signal(signal.SIGINT)
        except KeyboardInterrupt:
            pass
        raise RuntimeError("half compiled")

    monkeypatch.setattr(cli, "_dispatch", dispatch)
    assert cli.main(["trot"]) == 130
    assert capsys.readouterr().err == "fastmimic: interrupted\n"
    with pytest.raises(RuntimeError, match="half compiled"):
        cli.main([])


def test_it_is_kept_until_the_end_of_the_block() -> None:
    kept, done = list[int](), []

    def block() -> None:
        with interrupts_kept(kept):
            signal.raise_signal(signal.SIGINT)
            done.append("all")

    with pytest.raises(KeyboardInterrupt):
        block()
    assert (kept, done) == ([signal.SIGINT], ["all"])
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_in_the_background_it_stays_ignored() -> None:
    kept: list[int] = []
    with on_signal(signal.SIG_IGN, signal.SIGINT), interrupts_kept(kept):
        signal.raise_signal(signal.SIGINT)
    assert not kept


def test_an_error_of_the_block_does_not_lose_it() -> None:
    def block() -> None:
        with interrupts_kept([]):
            signal.raise_signal(signal.SIGINT)
            raise RuntimeError("the library's")

    with pytest.raises(KeyboardInterrupt):
        block()
