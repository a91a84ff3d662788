"""Output of the verbs: results on stdout, notes and progress on stderr."""

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
FIRST_USE: Final = "the first use compiles the controller: about a minute, once"
SLOW_START: Final = f"preparing; {FIRST_USE}"
CHOOSING: Final = "validating the best candidates in longer episodes"
KEPT: Final = "finished parts are kept; the same command with --resume continues"
PLAIN_STEPS: Final = 10  # lines in all, where there is no terminal to draw a bar on


def put(*lines: str) -> None:
    """Prints lines of the result on stdout."""
    sys.stdout.writelines(f"{line}\n" for line in lines)


def put_json(value: Mapping[str, Any]) -> None:
    """Prints one JSON object on stdout; infinite and undefined numbers become null."""
    import json

    from fastmimic.base.text import plain

    put(json.dumps(plain(value), allow_nan=False))


def put_table(rows: Sequence[Sequence[str]], *, right: Sequence[int] = ()) -> None:
    """Prints a table on stdout; the columns in `right` are aligned to the right."""
    put(*table(rows, right=right))


def note(text: str) -> None:
    """Prints a line for the reader on stderr."""
    sys.stderr.write(f"{text}\n")
    sys.stderr.flush()


def table(rows: Sequence[Sequence[str]], *, right: Sequence[int] = ()) -> list[str]:
    """Lines with aligned columns; the columns in `right` are aligned to the right."""
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    return [
        "  ".join(
            cell.rjust(width) if i in right else cell.ljust(width)
            for i, (cell, width) in enumerate(zip(row, widths, strict=True))
        ).rstrip()
        for row in rows
    ]


@contextmanager
def slow_start(text: str = SLOW_START, after_s: float = SLOW_START_S) -> Iterator[Callable[[], None]]:
    """Prints `text` if the block is still busy after a while, unless the yielded function was called before."""
    timer = threading.Timer(after_s, note, [text])
    timer.daemon = True
    timer.start()
    try:
        yield timer.cancel
    finally:
        timer.cancel()


@contextmanager
def optimisation_progress() -> "Iterator[Callable[[Progress], None]]":
    """Progress of an optimisation: a bar on a terminal, otherwise a line for each tenth."""
    with slow_start() as started, _bar() as bar:
        report = _on_bar(bar) if bar is not None else _plain_optimisation()

        def progress(step: "Progress") -> None:
            started()
            report(step)

        yield progress


@contextmanager
def count_progress(what: str) -> Iterator[Callable[[int, int], None]]:
    """Progress of a count: yields a function of (done, all). A bar on a terminal, otherwise a line for each tenth."""
    with _bar() as bar:
        if bar is None:
            shown = _Tenths()

            def plain(done: int, total: int) -> None:
                if shown.due(done, total):
                    note(f"{what} {done}/{total}")

            yield plain
        else:
            task = bar.add_task(what, total=None, visible=False, info="")
            yield lambda done, total: bar.update(task, completed=done, total=total, visible=True)


@contextmanager
def share_progress(what: str) -> Iterator[Callable[[float, str], None] | None]:
    """Progress of long work: yields a function of (share in [0, 1], text), or None where there is no terminal."""
    with _bar(counted=False) as bar:
        if bar is None:
            yield None
            return
        task = bar.add_task(what, total=1.0, info="")
        yield lambda share, text: bar.update(task, completed=share, info=text)


def _plain_optimisation() -> "Callable[[Progress], None]":
    shown = _Tenths()

    def report(step: "Progress") -> None:
        if shown.due(step.iteration, step.iterations):
            note(f"iteration {step.iteration}/{step.iterations}  {_figures(step)}")
        if step.iteration == step.iterations:
            note(CHOOSING)

    return report


def _on_bar(bar: Any) -> "Callable[[Progress], None]":
    task = bar.add_task("optimising", total=None, visible=False, info="")

    def report(step: "Progress") -> None:
        bar.update(task, completed=step.iteration, total=step.iterations, visible=True, info=_figures(step))
        if step.iteration == step.iterations:
            bar.update(task, description="validating")

    return report


def _figures(step: "Progress") -> str:
    left = f"{step.remaining_s // 60:.0f}:{step.remaining_s % 60:02.0f}"
    return f"best {step.best:.3f}  {step.evaluations_per_s:.0f} evaluations/s  {left} left"


class _Tenths:
    """Tells when another tenth of the work is done."""

    def __init__(self) -> None:
        self._shown = 0

    def due(self, done: int, total: int) -> bool:
        tenth = done * PLAIN_STEPS // max(total, 1)
        if tenth <= self._shown:
            return False
        self._shown = tenth
        return True


@contextmanager
def _bar(*, counted: bool = True) -> Iterator[Any]:
    """Rich's progress bar on stderr, or None where that is not a terminal."""
    if not sys.stderr.isatty():
        yield None
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TaskProgressColumn, TextColumn

    columns = (
        TextColumn("{task.description}"),
        BarColumn(bar_width=16),  # so that all fits a terminal of 80 columns
        MofNCompleteColumn() if counted else TaskProgressColumn(),
        TextColumn("{task.fields[info]}"),
    )
    with Progress(*columns, console=Console(stderr=True)) as bar:
        yield bar
