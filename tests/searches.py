"""How searches choose their result in tests: quickly."""

from typing import Any, Final

from fastmimic.optimize.parameters import FinalChoice

QUICK_CHOICE: Final = FinalChoice(candidates=2, episodes=2, duration_s=0.4)
QUICK_COMMAND: Final[dict[str, Any]] = {"choice": QUICK_CHOICE, "evaluation_s": 0.6}
"""The `without_option` of the command line."""
PART_DURATION_S: Final = 0.6
"""In place of `fastmimic.imitation.stitch.PART_DURATION_S`."""
