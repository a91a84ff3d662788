"""Signals of the process, such as Ctrl-C."""

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any


@contextmanager
def on_signal(handler: Any, *numbers: int) -> Iterator[None]:
    """Signals are handled by `handler` within the block, as `signal.signal` takes it; in the main thread only."""
    numbers = numbers if threading.current_thread() is threading.main_thread() else ()
    before = [signal.signal(number, handler) for number in numbers]
    try:
        yield
    finally:
        for number, earlier in zip(numbers, before, strict=True):
            signal.signal(number, earlier)


def heeded() -> tuple[int, ...]:
    """SIGINT, unless the process ignores it, as one in the background of a script does."""
    return (signal.SIGINT,) if callable(signal.getsignal(signal.SIGINT)) else ()


@contextmanager
def interrupts_kept(kept: list[int]) -> Iterator[None]:
    """A Ctrl-C within the block is kept until its end, where it is handled as it would have been: for libraries that
    take it for something else."""
    handler = signal.getsignal(signal.SIGINT)
    try:
        with on_signal(lambda number, _: kept.append(number), *heeded()):
            yield
    finally:
        if kept and callable(handler):
            handler(kept[0], None)
