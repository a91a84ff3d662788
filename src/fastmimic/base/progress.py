"""Notes and progress, on stderr."""

import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Final

from fastmimic.base.jit import kernels_compiled

SLOW_START_S: Final = 3.0
_FIRST_USE: Final = "the first use compiles the controller: about half a minute, once"
_PLAIN_STEPS: Final = 10  # lines in all, where there is no terminal to draw a bar on


def note(text: str) -> None:
    """Prints a line for the reader on stderr."""
    sys.stderr.write(f"{text}\n")
    sys.stderr.flush()


def is_watched() -> bool:
    """Whether somebody waits at a terminal, which shows a bar, or a notebook, which shows lines."""
    return sys.stderr.isatty() or "ipykernel" in sys.modules


@contextmanager
def slow_start(text: str = "preparing", after_s: float = SLOW_START_S) -> Iterator[Callable[[], None]]:
    """Prints `text`, and whether it compiles, if within `after_s` the block has not called the yielded function."""
    started, known = threading.Event(), kernels_compiled()

    def watch() -> None:
        if started.wait(after_s):
            return
        compiles = kernels_compiled() > known
        note(f"{text}; {_FIRST_USE}" if compiles else text)
        while not compiles and not started.wait(0.5):
            if compiles := kernels_compiled() > known:
                note(_FIRST_USE)

    threading.Thread(target=watch, daemon=True).start()
    try:
        yield started.set
    finally:
        started.set()


@contextmanager
def count_progress(what: str) -> Iterator[Callable[[int, int], None]]:
    """Progress of a count: yields a function of (done, all). A bar on a terminal, otherwise a line for each tenth."""
    with progress_bar(what) as show:
        due = tenths()

        def progress(done: int, total: int) -> None:
            show(f"{what} {done}/{total}" if due(done, total) else "", completed=done, total=total)

        yield progress


@contextmanager
def share_progress(what: str) -> Iterator[Callable[[float, str, str], None]]:
    """Yields a function of (share in [0, 1], text, line): a bar with the text on a terminal, else the line, if any."""
    with progress_bar(what, total=1.0) as show:
        yield lambda share, text, line: show(line, completed=share, info=text)


def tenths(shown: int = 0) -> Callable[[int, int], bool]:
    """A function of (done, all) that tells when another tenth of the work is done than the `shown` ones."""

    def due(done: int, total: int) -> bool:
        nonlocal shown
        before, shown = shown, max(shown, done * _PLAIN_STEPS // max(total, 1))
        return shown > before

    return due


@contextmanager
def progress_bar(what: str, total: float | None = None) -> Iterator[Callable[..., None]]:
    """Rich's progress bar on stderr: yields a function of (line, **changes) that updates it; where that is no terminal,
    it prints the line, unless it is empty. Without a total it counts, and is hidden until the first update."""
    if not sys.stderr.isatty():
        yield lambda line, **_: note(line) if line else None
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TaskProgressColumn, TextColumn

    columns = (
        TextColumn("{task.description}"),
        BarColumn(bar_width=16),  # so that all fits a terminal of 80 columns
        MofNCompleteColumn() if total is None else TaskProgressColumn(),
        TextColumn("{task.fields[info]}"),
    )
    with Progress(*columns, console=Console(stderr=True)) as bar:
        task = bar.add_task(what, total=total, visible=total is not None, info="")
        yield lambda _, **new: bar.update(task, visible=True, **new)
