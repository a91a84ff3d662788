"""Every executor does the same: all jobs, whatever becomes of single ones."""

import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from executors.work import do
from fastmimic.errors import ClipError, ConfigError, WorkerError
from fastmimic.executors import Executor, Outcome, make_executor

TESTS = str(Path(__file__).parents[1])


@pytest.fixture(params=["local", "ray"])
def executor(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Iterator[Executor]:
    if request.param == "ray":
        pytest.importorskip("ray")
        # where a cluster's processes find this file's neighbours
        monkeypatch.setenv("PYTHONPATH", os.pathsep.join([TESTS, os.environ.get("PYTHONPATH", "")]))
    return make_executor(request.param, workers=2)


def by_job(outcomes: Iterator[Outcome]) -> dict[int, Outcome]:
    found = [*outcomes]
    assert len({outcome.index for outcome in found}) == len(found)
    return {outcome.index: outcome for outcome in found}


def test_all_jobs_are_done_whatever_becomes_of_some(executor: Executor, tmp_path: Path) -> None:
    told: dict[int, float] = {}
    jobs = [1, "wrong", tmp_path / "once", "die", *range(2, 12)]
    found = by_job(executor.run(do, jobs, lambda index, share: told.update({index: share})))
    assert [found[i].result for i in range(4, 14)] == [2 * n for n in range(2, 12)]
    assert found[0].result == 2
    assert isinstance(found[1].error, ClipError)
    assert str(found[1].error) == "this job is wrong"
    assert found[2].result == "done the second time"
    assert isinstance(found[3].error, WorkerError)
    assert "died 4 times" in str(found[3].error)
    assert set(told) <= set(range(14))
    assert told


def test_a_defect_is_raised(executor: Executor) -> None:
    with pytest.raises(ZeroDivisionError):
        by_job(executor.run(do, ["defect"]))


def test_one_worker_works_in_this_process() -> None:
    told = []
    found = by_job(make_executor("local", workers=1).run(do, [1, "wrong"], lambda *said: told.append(said)))
    assert found[0].result == 2
    assert isinstance(found[1].error, ClipError)
    assert told == [(0, 0.5), (1, 0.5)]


@pytest.mark.parametrize(
    ("name", "options", "said"),
    [
        ("lokal", {}, "did you mean 'local'?"),
        ("local", {"workers": 0}, "at least 1"),
        ("local", {"address": "there:1"}, "of a Ray cluster"),
    ],
)
def test_what_there_is_not(name: str, options: dict[str, object], said: str) -> None:
    with pytest.raises(ConfigError, match=said.replace("?", r"\?")):
        make_executor(name, **options)  # type: ignore[arg-type]


def test_a_machine_that_lacks_the_package() -> None:
    pytest.importorskip("ray")  # whose processes do not find this file's neighbours of themselves
    with pytest.raises(ConfigError, match=r"cannot import what it is to do .*No module named 'executors'"):
        by_job(make_executor("ray", workers=1).run(do, [1]))


@pytest.mark.parametrize(
    ("address", "said"),
    [("127.0.0.1:9", "no Ray cluster at '127.0.0.1:9'"), ("there", "HOST:PORT"), ("localhost:99999", "no Ray cluster")],
)
def test_a_cluster_that_is_not_there(address: str, said: str) -> None:
    pytest.importorskip("ray")
    with pytest.raises(ConfigError, match=said):
        by_job(make_executor("ray", address=address).run(do, [1]))
