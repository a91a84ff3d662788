"""A Ray cluster: an existing one by its address, or one started on this machine.

Ray places the jobs, one core each, and begins those again whose process or machine died; what its machines must have
in common is the installed package and, for jobs that read and write files, those files' place.
"""

import logging
import os
import socket
from collections.abc import Callable, Generator, Iterable
from typing import Any, Final

from fastmimic.errors import ConfigError, FastMimicError, WorkerError
from fastmimic.executors.base import ATTEMPTS, Outcome, Work, attempt
from fastmimic.machine import available_cores

_AHEAD: Final = 2  # jobs handed out for each core, so that none waits for the next
_POLL_S: Final = 1.0
_REACHED_S: Final = 5.0
_NOT_IMPORTED: Final = "failed to import on the worker"  # as Ray says it
_NO_MODULE: Final = "No module named"


def require_ray() -> Any:
    """Ray's module; raises `ConfigError` with what to do if it is not installed."""
    os.environ.setdefault("RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO", "0")  # leaves a job's view of the GPUs alone
    try:
        import ray
    except ImportError:
        raise ConfigError("the executor 'ray' needs Ray: pip install 'fastmimic[ray]'") from None
    return ray


class RayExecutor:
    """One-core tasks on a Ray cluster."""

    def __init__(self, address: str | None = None, workers: int | None = None) -> None:
        """
        Args:
            address: of a running cluster, HOST:PORT, ray://HOST:PORT, or 'auto' for the one on this machine; None
                starts one here, for the time of a run.
            workers: cores of the one started here, all if None; of a running cluster, how many jobs at a time at most.

        Raises:
            ConfigError: fewer than one worker, or Ray is not installed.
        """
        if workers is not None and workers < 1:
            raise ConfigError(f"workers must be at least 1, found {workers}")
        require_ray()
        self._address, self._limit = address, workers

    @property
    def workers(self) -> int:
        """Cores of the cluster now, at most those asked for; before a run begins, those of this machine."""
        ray = require_ray()
        cores = int(ray.cluster_resources().get("CPU", 1)) if ray.is_initialized() else available_cores()
        return cores if self._limit is None else min(cores, self._limit)

    def run(
        self, work: Work, jobs: Iterable[Any], progress: Callable[[int, float], None] | None = None
    ) -> Generator[Outcome, None, None]:
        """As `Executor.run`; a job is told of as done only when it is."""
        ray = require_ray()
        own = not ray.is_initialized()
        if own:
            self._connect(ray)
        task = ray.remote(num_cpus=1, max_retries=ATTEMPTS - 1, retry_exceptions=False)(_work)
        waiting = enumerate(jobs)
        running: dict[Any, int] = {}
        try:
            while True:
                # asked for each time: machines come and go
                while len(running) < _AHEAD * max(1, self.workers) and (following := next(waiting, None)) is not None:
                    running[task.remote(work, following[1])] = following[0]
                if not running:
                    return
                done, _ = ray.wait(list(running), timeout=_POLL_S)
                for reference in done:
                    index = running.pop(reference)
                    outcome = Outcome(index, *_result(ray, reference))
                    if progress is not None:
                        progress(index, 1.0)
                    yield outcome
        finally:
            for reference in running:
                ray.cancel(reference, force=True)
            if own:
                ray.shutdown()

    def _connect(self, ray: Any) -> None:
        if self._address is not None:
            _check_reachable(self._address)
        quiet: dict[str, Any] = {"logging_level": logging.ERROR, "log_to_driver": False}
        try:
            if self._address is None:
                cores = self._limit if self._limit is not None else available_cores()
                ray.init(num_cpus=cores, include_dashboard=False, **quiet)
            else:
                ray.init(address=self._address, **quiet)
        except (ConnectionError, ValueError, RuntimeError, OSError, AssertionError) as error:
            where = (
                f"no Ray cluster at '{self._address}'" if self._address is not None else "Ray cannot be started here"
            )
            said = str(error).strip().splitlines()
            raise ConfigError(
                f"{where}: {said[0] if said else type(error).__name__}; 'ray status' shows a running one"
            ) from None


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


def _work(work: Work, job: Any) -> tuple[Any, FastMimicError | None]:
    return attempt(work, job, lambda share: None)


def _result(ray: Any, reference: Any) -> tuple[Any, FastMimicError | None]:
    try:
        result, error = ray.get(reference)
    except ray.exceptions.RayTaskError as raised:
        cause = str(raised.cause)
        if _NOT_IMPORTED in cause or _NO_MODULE in cause:
            why = next((line.strip() for line in cause.splitlines() if _NO_MODULE in line), "ImportError")
            raise ConfigError(
                f"a machine of the cluster cannot import what it is to do ({why}); install the same FastMimic on all"
            ) from None
        raise raised.as_instanceof_cause() from None
    except ray.exceptions.RayError as died:
        said = str(died).strip().splitlines()
        return None, WorkerError(f"its process died {ATTEMPTS} times: {said[0] if said else type(died).__name__}")
    return result, error
