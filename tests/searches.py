"""How searches choose their result in tests: quickly.

python tests/searches.py EXAMPLE.py [ARGUMENTS]      runs an example, or a notebook, with short searches
"""

import inspect
import runpy
import sys
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, Final
from unittest import mock

import fastmimic as fm
from fastmimic.cli import main
from fastmimic.commands import options
from fastmimic.optimize.parameters import FinalChoice

QUICK_CHOICE: Final = FinalChoice(candidates=2, episodes=2, duration_s=0.4)
PART_DURATION_S: Final = 0.6
_QUICK: Final[dict[str, Any]] = {"choice": QUICK_CHOICE, "evaluation_s": 0.6, "part_duration_s": PART_DURATION_S}


def quick_main(arguments: Sequence[str] | None = None) -> int:
    """The command line, which chooses quickly at the end of a search, and evaluates shortly: no option says so."""
    apply = options.apply

    def quickly(function: Callable[..., Any], *groups: Any, **others: Any) -> Any:
        names = inspect.signature(function).parameters
        return apply(function, *groups, **{k: v for k, v in _QUICK.items() if k in names} | others)

    with mock.patch.object(options, "apply", quickly):
        return main(arguments)


def shorten() -> None:
    """From now on `fastmimic.imitate` and `fastmimic.stitch` search for two small iterations only."""
    fm.imitate, fm.stitch = partial(_shortly, fm.imitate), partial(_shortly, fm.stitch)


def _shortly(search: Callable[..., Any], *sources: Any, **options: Any) -> Any:
    return search(*sources, **(options | {"iterations": 2, "population": 4, "choice": QUICK_CHOICE}))


def run_notebook(file: str) -> None:
    """Executes a notebook's cells, the first one of which is this module's."""
    import nbformat
    from nbclient import NotebookClient

    notebook = nbformat.read(file, as_version=4)
    first = f"import sys\nsys.path.insert(0, {sys.path[0]!r})\nimport searches\nsearches.shorten()"
    notebook.cells.insert(0, nbformat.v4.new_code_cell(first))
    NotebookClient(notebook, timeout=None, kernel_name="python3").execute()


if __name__ == "__main__":
    del sys.argv[0]
    if sys.argv[0].endswith(".ipynb"):
        run_notebook(sys.argv[0])
    else:
        shorten()
        runpy.run_path(sys.argv[0], run_name="__main__")
