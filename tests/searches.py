"""How searches choose their result in tests: quickly."""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any, Final
from unittest import mock

from fastmimic import cli
from fastmimic.optimize.parameters import FinalChoice

QUICK_CHOICE: Final = FinalChoice(candidates=2, episodes=2, duration_s=0.4)
_QUICK: Final[dict[str, Any]] = {"choice": QUICK_CHOICE, "evaluation_s": 0.6}
PART_DURATION_S: Final = 0.6
"""In place of `fastmimic.imitation.stitch.PART_DURATION_S`."""


def quick_main(arguments: Sequence[str] | None = None) -> int:
    """The command line, choosing quickly at the end of a search, and evaluating shortly: these fields of the verbs have
    no options."""
    parse = cli.parse
    with mock.patch.object(cli, "parse", lambda name, rest: _filled(parse(name, rest), _QUICK)):
        return cli.main(arguments)


def _filled(command: Any, values: Mapping[str, Any]) -> Any:
    """The command, or a part of it, with these values in place of the fields of their names."""
    own = {field.name: getattr(command, field.name) for field in dataclasses.fields(command)}
    for name, value in own.items():
        if dataclasses.is_dataclass(value) and name not in values:
            own[name] = _filled(value, values)
    return dataclasses.replace(command, **own | {name: values[name] for name in own if name in values})
