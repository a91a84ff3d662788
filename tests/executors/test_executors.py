"""Every executor does the same: all jobs, whatever becomes of single ones."""

import logging
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from importlib import import_module
from pathlib import Path

import pytest

from executors.work import do
from fastmimic.base.errors import ClipError, ClusterError, ConfigError, WorkerError
from fastmimic.executors import Executor, JobOutcome, make_executor
from fastmimic.executors.local import LocalExecutor
from fastmimic.executors.ray_cluster import _result

pytestmark = pytest.mark.cluster

TESTS = str(Path(__file__).parents[1])


@pytest.fixture(params=["local", "ray"])
def executor(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Iterator[Executor]:
    if request.param == "local":
        yield make_executor("local", workers=2)
        return
    ray = pytest.importorskip("ray")  # whose processes find this file's neighbours
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([TESTS, os.environ.get("PYTHONPATH", "")]))
    ray.init("local", num_cpus=2, include_dashboard=False, logging_level=logging.ERROR, log_to_driver=False)
    yield make_executor("ray", workers=2)
    ray.shutdown()


def by_job(outcomes: Iterator[JobOutcome]) -> dict[int, JobOutcome]:
    found = [*outcomes]
    assert len({outcome.index for outcome in found}) == len(found)
    return {outcome.index: outcome for outcome in found}


def test_a_script_without_a_main_guard_is_told_so(tmp_path: Path) -> None:
    lines = "from math import sqrt", "from fastmimic.executors import make_executor"
    script = tmp_path / "unguarded.py"
    script.write_text("\n".join((*lines, "print(*make_executor('local', workers=2).run(sqrt, [4.0]))")))
    done = subprocess.run([sys.executable, script], capture_output=True, text=True, check=True)
    assert "a script must call this under if __name__ == '__main__':" in done.stdout


def test_all_jobs_are_done_whatever_becomes_of_some(
    executor: Executor, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
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
    with pytest.raises(ZeroDivisionError):  # a defect is raised
        by_job(executor.run(do, ["defect"]))
    if not isinstance(executor, LocalExecutor):  # a machine that lacks what is here
        (tmp_path / "only_here.py").write_text("def do(job, report):\n    return job\n")
        monkeypatch.syspath_prepend(tmp_path)
        with pytest.raises(ConfigError, match=r"cannot import what it is to do .*No module named 'only_here'"):
            by_job(executor.run(import_module("only_here").do, [1]))


def test_one_worker_works_in_this_process() -> None:
    told = []
    found = by_job(make_executor("local", workers=1).run(do, [1, "wrong"], lambda *said: told.append(said)))
    assert found[0].result == 2
    assert isinstance(found[1].error, ClipError)
    assert told == [(0, 0.5), (1, 0.5)]


def test_one_worker_in_a_process_of_its_own(tmp_path: Path) -> None:
    found = by_job(LocalExecutor(1, in_process=False).run(do, [1, tmp_path / "once"]))
    assert (found[0].result, found[1].result) == (2, "done the second time")


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


def _lost(name: str) -> Exception:
    """As Ray raises it."""
    from ray import exceptions

    kind = getattr(exceptions, name)
    if name in ("ObjectLostError", "OwnerDiedError"):
        return kind("ab12", None, "")  # type: ignore[no-any-return]
    return kind() if name in ("WorkerCrashedError", "LocalRayletDiedError") else kind("as Ray says\nand more")


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("WorkerCrashedError", "its process died 4 times"),
        ("OutOfMemoryError", "its machine ran out of memory"),
        ("NodeDiedError", "its machine was lost 4 times"),
        ("OutOfDiskError", "disk is full"),
        ("ObjectLostError", "its result was lost"),
        ("OwnerDiedError", "its result was lost"),
        ("TaskUnschedulableError", "no machine of the cluster can run it"),
        ("PendingCallsLimitExceeded", "Ray lost it: as Ray says"),
    ],
)
def test_a_job_that_is_lost_says_how(name: str, said: str, monkeypatch: pytest.MonkeyPatch) -> None:
    ray = pytest.importorskip("ray")
    monkeypatch.setattr(ray, "get", _raising(_lost(name)))
    result, error = _result(ray, "a job's")
    assert result is None
    assert isinstance(error, WorkerError)
    assert said in str(error)
    assert "died" not in str(error) or name == "WorkerCrashedError"
    assert "\n" not in str(error)


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("LocalRayletDiedError", "the Ray cluster is gone"),
        ("RaySystemError", "the Ray cluster is gone"),
        ("RpcError", r"gone, or fails \(as Ray says\)"),
        ("ConnectionError", r"gone, or fails \(refused\)"),
        ("RuntimeEnvSetupError", "cannot set up the environment of a job"),
    ],
)
def test_what_no_job_can_be_run_after_is_raised(name: str, said: str, monkeypatch: pytest.MonkeyPatch) -> None:
    ray = pytest.importorskip("ray")
    error = ConnectionError("refused") if name == "ConnectionError" else _lost(name)
    monkeypatch.setattr(ray, "get", _raising(error))
    with pytest.raises(ClusterError, match=said):
        _result(ray, "a job's")


def test_a_jobs_own_broken_connection_is_its_defect(monkeypatch: pytest.MonkeyPatch) -> None:
    ray = pytest.importorskip("ray")
    cause = ConnectionError("refused")
    raised = ray.exceptions.RayTaskError("do", "Traceback", cause, "ray::do", 1, "127.0.0.1")
    monkeypatch.setattr(ray, "get", _raising(raised.as_instanceof_cause()))
    with pytest.raises(ConnectionError):  # not a ClusterError
        _result(ray, "a job's")


def _raising(error: Exception) -> Callable[..., None]:
    def call(*_: object, **__: object) -> None:
        raise error

    return call


@pytest.mark.parametrize(
    ("address", "said"),
    [("127.0.0.1:9", "no Ray cluster at '127.0.0.1:9'"), ("there", "HOST:PORT"), ("localhost:99999", "no Ray cluster")],
)
def test_a_cluster_that_is_not_there(address: str, said: str) -> None:
    pytest.importorskip("ray")
    with pytest.raises(ConfigError, match=said):
        by_job(make_executor("ray", address=address).run(do, [1]))


def test_a_cluster_that_only_ray_finds_is_looked_for_before_anything_is_begun(monkeypatch: pytest.MonkeyPatch) -> None:
    ray = pytest.importorskip("ray")
    monkeypatch.setattr(ray, "is_initialized", lambda: False)
    monkeypatch.setattr(ray, "init", _raising(ConnectionError("none runs here")))
    with pytest.raises(ConfigError, match="no Ray cluster at 'auto': none runs here"):
        make_executor("ray", address="auto")


def test_without_an_address_ray_starts_one_of_its_own_beside_others(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: dict[str, object] = {}

    def init(**given: object) -> None:
        asked.update(given)
        raise ConnectionError("not here")

    monkeypatch.setattr(pytest.importorskip("ray"), "init", init)
    with pytest.raises(ConfigError, match="Ray cannot be started here: not here"):
        by_job(make_executor("ray", workers=3).run(do, [1]))
    assert (asked["address"], asked["num_cpus"]) == ("local", 3)
