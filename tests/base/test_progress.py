"""What a start that takes long says."""

import time

import pytest

from fastmimic.base import progress


@pytest.mark.parametrize(("now", "said"), [([], "working\n"), (["f"], "working; the first use compiles")])
def test_a_slow_start_says_that_it_compiles_only_if_it_does(
    now: list[str], said: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    compiled = ["what was compiled before"]
    monkeypatch.setattr("fastmimic.base.jit._compiled", compiled)
    with progress.slow_start("working", after_s=0.1):
        compiled += now
        time.sleep(0.4)
    assert capsys.readouterr().err.startswith(said)


def test_a_quick_start_says_nothing(capsys: pytest.CaptureFixture[str]) -> None:
    with progress.slow_start(after_s=0.1) as started:
        started()
        time.sleep(0.3)
    assert capsys.readouterr().err == ""
