"""The executors by name."""

from typing import Final

from fastmimic.base.errors import ConfigError, did_you_mean
from fastmimic.executors.base import Executor

EXECUTORS: Final = {"local": "processes on this machine", "ray": "a Ray cluster"}


def make_executor(name: str, *, workers: int | None = None, address: str | None = None) -> Executor:
    """The executor of that name, one of `EXECUTORS`, for `workers` jobs at a time (one per core if None); `address` is
    of a running Ray cluster. Raises `ConfigError` for a wrong argument, or if Ray is needed and not installed."""
    if name not in EXECUTORS:
        raise ConfigError(f"unknown executor '{name}'; there are {', '.join(EXECUTORS)}{did_you_mean(name, EXECUTORS)}")
    if name == "local":
        from fastmimic.executors.local import LocalExecutor

        if address is not None:
            raise ConfigError("an address is of a Ray cluster; the executor 'local' has none")
        return LocalExecutor(workers)
    from fastmimic.executors.ray_cluster import RayExecutor

    return RayExecutor(address, workers)
