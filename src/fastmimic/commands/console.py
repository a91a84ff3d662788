"""Output of the verbs: results on stdout, notes and progress on stderr."""

import json
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:  # loads the compiler
    from fastmimic.optimize.cma_es import Progress

EXIT_INTERRUPTED: Final = 130
"""As a shell reports SIGINT."""
EXIT_SOME_FAILED: Final = 3
"""Some sources or motions failed; everything else is done."""

SLOW_START_S: Final = 3.0
FIRST_USE: Final = "the first use compiles the controller: about half a minute, once"
SLOW_START: Final = f"preparing; {FIRST_USE}"
CHOOSING: Final = "validating the best candidates in longer episodes"
KEPT: Final = "finished parts are kept; the same command with --resume continues"
PLAIN_STEPS: Final = 10  # lines in all, where there is no terminal to draw a bar on


def put(*lines: str) -> None:
    """Prints lines of the result on stdout."""
    sys.stdout.writelines(f"{line}\n" for line in lines)


def put_json(value: Mapping[str, Any]) -> None:
    """Prints one JSON object on stdout; infinite and undefined numbers become null."""
    from fastmimic.base.text import plain

    put(json.dumps(plain(value), allow_nan=False))


def put_table(rows: Sequence[Sequence[str]], *, right: Sequence[int] = ()) -> None:
    """Prints rows in aligned columns on stdout; the columns in `right` are aligned to the right."""
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    for row in rows:
        cells = zip(row, widths, strict=True)
        aligned = [cell.rjust(width) if i in right else cell.ljust(width) for i, (cell, width) in enumerate(cells)]
        put("  ".join(aligned).rstrip())


def note(text: str) -> None:
    """Prints a line for the reader on stderr."""
    sys.stderr.write(f"{text}\n")
    sys.stderr.flush()


@contextmanager
def slow_start(text: str = SLOW_START) -> Iterator[Callable[[], None]]:
    """Prints `text` if the block is still busy after a while, unless the yielded function was called before."""
    timer = threading.Timer(SLOW_START_S, note, [text])
    timer.daemon = True
    timer.start()
    try:
        yield timer.cancel
    finally:
        timer.cancel()


@contextmanager
def optimisation_progress() -> "Iterator[Callable[[Progress], None]]":
    """Progress of an optimisation: a bar on a terminal, otherwise a line for each tenth."""
    with slow_start() as started, _bar("optimising") as show:
        due = tenths()

        def progress(step: "Progress") -> None:
            started()
            left = f"{step.remaining_s // 60:.0f}:{step.remaining_s % 60:02.0f}"
            figures = f"best {step.best:.3f}  {step.evaluations_per_s:.0f} evaluations/s  {left} left"
            done, total = step.iteration, step.iterations
            line = f"iteration {done}/{total}  {figures}" if due(done, total) else ""
            show(line, completed=done, total=total, info=figures)
            if done == total:
                show(CHOOSING, description="validating")

        yield progress


@contextmanager
def count_progress(what: str) -> Iterator[Callable[[int, int], None]]:
    """Progress of a count: yields a function of (done, all). A bar on a terminal, otherwise a line for each tenth."""
    with _bar(what) as show:
        due = tenths()

        def progress(done: int, total: int) -> None:
            show(f"{what} {done}/{total}" if due(done, total) else "", completed=done, total=total)

        yield progress


@contextmanager
def share_progress(what: str) -> Iterator[Callable[[float, str, str], None]]:
    """Progress of long work: yields a function of (share in [0, 1], text, line). A bar with the text on a terminal,
    otherwise the line, unless it is empty."""
    with _bar(what, total=1.0) as show:
        yield lambda share, text, line: show(line, completed=share, info=text)


@contextmanager
def on_signal(handler: Any, *numbers: int) -> Iterator[None]:
    """Signals are handled by `handler` within the block, as `signal.signal` takes it."""
    before = [signal.signal(number, handler) for number in numbers]
    try:
        yield
    finally:
        for number, earlier in zip(numbers, before, strict=True):
            signal.signal(number, earlier)


def tenths(shown: int = 0) -> Callable[[int, int], bool]:
    """A function of (done, all) that tells when another tenth of the work is done than the `shown` ones."""

    def due(done: int, total: int) -> bool:
        nonlocal shown
        before, shown = shown, max(shown, done * PLAIN_STEPS // max(total, 1))
        return shown > before

    return due


@contextmanager
def _bar(what: str, total: float | None = None) -> Iterator[Callable[..., None]]:
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
