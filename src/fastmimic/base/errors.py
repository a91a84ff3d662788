"""Errors that a user can cause.

Every message says what was found, what was expected, where, and what to do. The command line prints it in one line and
exits with status 2; any other exception that reaches the user is a bug.
"""

import difflib
import math
import os
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from numbers import Real


class FastMimicError(Exception):
    """Base of all errors that a user can cause and correct."""


class RobotError(FastMimicError):
    """A robot description that this project cannot use."""


class ClipError(FastMimicError):
    """A motion file or clip that cannot be read or used."""


class MotionError(FastMimicError):
    """A robot reference motion that is malformed or does not fit."""


class ConfigError(FastMimicError):
    """A setting out of its range, or two that contradict each other."""


class DataError(FastMimicError):
    """Public data that could not be fetched or verified."""


class OutputError(FastMimicError):
    """A place that cannot be written to, or that holds something else."""


class LogError(FastMimicError):
    """The log of a run that cannot be read or does not hold enough."""


class PolicyError(FastMimicError):
    """A policy that is damaged, or made for another robot or motion."""


class DriverError(FastMimicError):
    """A robot that cannot be reached, or is not the one that was meant."""


class WorkerError(FastMimicError):
    """A job whose process or machine died at every attempt."""


class ClusterError(FastMimicError):
    """A cluster that cannot run any job any more."""


class LibraryError(FastMimicError):
    """A motion library that is damaged, or of other settings than those asked for."""


class CheckpointError(FastMimicError):
    """A checkpoint that is damaged or belongs to another problem."""


def unknown(what: str, name: str, names: Iterable[str], error: type[FastMimicError] = ConfigError) -> FastMimicError:
    """The error for an unknown name; it lists the known ones."""
    names = list(names)
    return error(f"unknown {what} '{name}'; there are {', '.join(names)}{did_you_mean(name, names)}")


def check_path(source: object, what: str, error: type[FastMimicError]) -> None:
    """Raises `error` unless a source is a name or a path."""
    if not isinstance(source, str | os.PathLike):
        raise error(f"{what}, found {'None' if source is None else type(source).__name__}")


def check_positive(
    value: float, what: str, error: type[FastMimicError] = ConfigError, shown: str | None = None
) -> None:
    """Raises `error` unless a value is positive and finite; `shown` is it with its unit, for the message."""
    if not (isinstance(value, Real) and math.isfinite(value) and value > 0):
        found = shown or (repr(value) if isinstance(value, str) else value)
        raise error(f"{what} must be positive, found {found}")


@contextmanager
def naming(where: object, error: type[FastMimicError]) -> Iterator[None]:
    """An error of this kind in the block begins with where it comes from, such as a file."""
    try:
        yield
    except error as problem:
        raise error(f"{where}: {problem}") from None


def did_you_mean(name: str, names: Iterable[str]) -> str:
    """`; did you mean 'a' or 'b'?` for the closest of `names`, or an empty string."""
    close = difflib.get_close_matches(name, list(names), n=3, cutoff=0.5)
    return f"; did you mean {' or '.join(repr(c) for c in close)}?" if close else ""
