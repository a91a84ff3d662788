"""How searches choose their result in tests: quickly."""

import inspect
from collections.abc import Callable, Sequence
from typing import Any, Final
from unittest import mock

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
