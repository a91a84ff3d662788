"""A Ray cluster: an existing one by its address, or one started on this machine.

Ray places the jobs, one core each, and restarts those that lost their process or machine; its machines must share the
installed package and the place of the files that jobs use.
"""

import logging
import os
import socket
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from itertools import islice
from typing import Any, Final

from fastmimic.base.errors import ClusterError, ConfigError, FastMimicError, WorkerError
from fastmimic.base.files import packaged
from fastmimic.base.machine import available_cores, optional
from fastmimic.executors import ATTEMPTS, JobOutcome, Outcomes, Told, Work, attempt, check_workers

_AHEAD: Final = 2  # jobs handed out for each core, so that none waits for the next
_POLL_S: Final = 1.0
_REACHED_S: Final = 5.0
_NOT_IMPORTED: Final = "failed to import on the worker"  # as Ray says it
_NO_MODULE: Final = "No module named"
_LOST: Final = packaged("fastmimic.executors", "lost.json", dict[str, str])
"""What is said of a job that used all its attempts, by Ray's exceptions."""


def require_ray() -> Any:
    """Ray's module; raises `ConfigError`, with what to do, if it is not installed."""
    os.environ.setdefault("RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO", "0")  # leaves a job's view of the GPUs alone
    return optional("ray", ConfigError("the executor 'ray' needs Ray: pip install 'fastmimic[ray]'"))


class RayExecutor:
    """One-core tasks on a Ray cluster."""

    def __init__(self, address: str | None = None, workers: int | None = None) -> None:
        """`address` is HOST:PORT or ray://HOST:PORT of a running cluster, or 'auto' for the one on this machine; None
        starts one here during a run. `workers` are the cores of that one, all if None, or the most jobs at a time on a
        running one. Raises `ConfigError` if fewer than one, nobody answers, or Ray is not installed."""
        check_workers(workers)
        ray = require_ray()
        if address is not None:
            _check_reachable(address)
        self._address, self._limit = address, workers
        if address == "auto" and not ray.is_initialized():  # which only Ray can tell: now, before work is begun
            self._connect(ray)
            ray.shutdown()

    @property
    def workers(self) -> int:
        """Cores of the cluster now, at most those asked for; before a run begins, those of this machine."""
        ray = require_ray()
        cores = int(ray.cluster_resources().get("CPU", 1)) if ray.is_initialized() else available_cores()
        return cores if self._limit is None else min(cores, self._limit)

    def run(self, work: Work, jobs: Iterable[Any], progress: Told | None = None) -> Outcomes:
        """As `Executor.run`; progress is reported only when a job is done."""
        ray = require_ray()
        own = not ray.is_initialized()
        if own:
            self._connect(ray)
        task = ray.remote(num_cpus=1, max_retries=ATTEMPTS - 1, retry_exceptions=False)(attempt)
        waiting = enumerate(jobs)
        running: dict[Any, int] = {}
        try:
            while True:
                with _cluster_there(ray):
                    wanted = _AHEAD * max(1, self.workers) - len(running)  # asked each time: machines come and go
                    for index, job in islice(waiting, max(0, wanted)):
                        running[task.remote(work, job)] = index
                    if not running:
                        return
                    done, _ = ray.wait(list(running), timeout=_POLL_S)
                for reference in done:
                    index = running.pop(reference)
                    outcome = JobOutcome(index, *_result(ray, reference))
                    if progress is not None:
                        progress(index, 1.0)
                    yield outcome
        finally:
            with suppress(ray.exceptions.RayError, ConnectionError):  # there may be no cluster any more
                for reference in running:
                    ray.cancel(reference, force=True)
            if own:
                ray.shutdown()

    def _connect(self, ray: Any) -> None:
        place: dict[str, Any] = {"address": self._address}
        failed = f"no Ray cluster at '{self._address}'"
        if self._address is None:
            place = {"address": "local", "num_cpus": self._limit or available_cores(), "include_dashboard": False}
            failed = "Ray cannot be started here"
        try:
            ray.init(**place, logging_level=logging.ERROR, log_to_driver=False)
        except (ConnectionError, ValueError, RuntimeError, OSError, AssertionError) as error:
            raise ConfigError(f"{failed}: {_first_line(error)}; 'ray status' shows a running one") from None


def _check_reachable(address: str) -> None:
    """Raises `ConfigError` if nobody answers there: Ray itself would try for two minutes."""
    host, _, port = address.removeprefix("ray://").rpartition(":")
    if not host or not port.isdigit():
        if address in ("auto", "local"):
            return
        raise ConfigError(f"the address of a Ray cluster is HOST:PORT, ray://HOST:PORT or auto, found '{address}'")
    try:
        socket.create_connection((host.strip("[]"), int(port)), timeout=_REACHED_S).close()
    except (OSError, OverflowError) as error:
        raise ConfigError(f"no Ray cluster at '{address}': {error}; 'ray status' shows a running one") from None


def _result(ray: Any, reference: Any) -> tuple[Any, FastMimicError | None]:
    try:
        with _cluster_there(ray):
            result, error = ray.get(reference)
    except ray.exceptions.RayTaskError as raised:
        cause = str(raised.cause)
        if _NOT_IMPORTED in cause or _NO_MODULE in cause:
            why = next((line.strip() for line in cause.splitlines() if _NO_MODULE in line), "ImportError")
            said = f"a machine of the cluster cannot import what it is to do ({why})"
            raise ConfigError(f"{said}; install the same FastMimic on all") from None
        raise raised.as_instanceof_cause() from None
    except ray.exceptions.RayError as lost:
        known = (said.format(attempts=ATTEMPTS) for name, said in _LOST.items() if isinstance(lost, _kinds(ray, name)))
        return None, WorkerError(next(known, f"Ray lost it: {_first_line(lost)}"))
    return result, error


@contextmanager
def _cluster_there(ray: Any) -> Iterator[None]:
    """Raises `ClusterError` for failures that are not a single job's."""
    gone: tuple[type[Exception], ...] = (
        *_kinds(ray, "LocalRayletDiedError", "RaySystemError", "RpcError"),
        ConnectionError,
    )
    try:
        yield
    except ray.exceptions.RuntimeEnvSetupError as error:
        said = "a machine of the cluster cannot set up the environment of a job"
        raise ClusterError(f"{said}: {_first_line(error)}") from None
    except _kinds(ray, "AuthenticationError") as error:
        raise ClusterError(f"the Ray cluster does not let us in: {_first_line(error)}") from None
    except gone as error:
        if isinstance(error, ray.exceptions.RayTaskError):  # a job's own ConnectionError
            raise
        said = f"the Ray cluster is gone, or fails ({_first_line(error)})"
        raise ClusterError(f"{said}; 'ray status' shows a running one") from None


def _kinds(ray: Any, *names: str) -> tuple[type[Exception], ...]:
    """Ray's exceptions of those names; not every release has all."""
    return tuple(getattr(ray.exceptions, name) for name in names if hasattr(ray.exceptions, name))


def _first_line(error: Exception) -> str:
    lines = str(error).strip().splitlines()
    return lines[0].strip().rstrip(".") if lines else type(error).__name__
