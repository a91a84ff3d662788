"""What a motion's evidence is worth: grades, by one table for all of them.

A record keeps the figures, and the grade is told from them when it is asked for, so that other thresholds need nothing
to be run again.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

from fastmimic.dataset.records import FAILED

REJECTED: Final = "rejected"
FAILURE: Final = "failed"


@dataclass(frozen=True)
class Demand:
    """A bound on a figure.

    Attributes:
        figure: of the record; one that a record does not have, because it was not tried, is not asked for.
        least, most: what it must not be below, or above; None for no bound.
        says: the figure in words.
    """

    figure: str
    least: float | None = None
    most: float | None = None
    says: str = ""

    def unmet(self, record: Mapping[str, Any]) -> str | None:
        """What is wrong, in words; None if nothing is."""
        value = record[self.figure]
        if value is None:
            return None
        if self.least is not None and value < self.least:
            return f"{self.says} {float(value):.3g}, below {self.least:g}"
        if self.most is not None and value > self.most:
            return (
                self.says
                if self.most == 0 and isinstance(value, bool)
                else f"{self.says} {float(value):.3g}, above {self.most:g}"
            )
        return None


_FELL = "share of {} that end in a fall"

GRADES: Final[dict[str, tuple[Demand, ...]]] = {
    "A": (
        Demand("reward", least=0.9, says="reward"),
        Demand("reward_perturbed", least=0.85, says="reward from perturbed starts"),
        Demand("reward_robots", least=0.8, says="reward on other robots"),
        Demand("reward_second_simulator", least=0.75, says="reward in the second simulator"),
        Demand("fell_perturbed", most=0.0, says=_FELL.format("perturbed starts")),
        Demand("fell_robots", most=0.0, says=_FELL.format("other robots")),
        Demand("fell_second_simulator", most=0.0, says=_FELL.format("trials in the second simulator")),
    ),
    "B": (
        Demand("reward", least=0.8, says="reward"),
        Demand("fell_perturbed", most=0.0, says=_FELL.format("perturbed starts")),
        Demand("fell_robots", most=0.2, says=_FELL.format("other robots")),
    ),
    "C": (
        Demand("fell", most=0.0, says="falls"),
        Demand("reward", least=0.6, says="reward"),
        Demand("style_distance", most=0.5, says="distance from the demonstration's style"),
        Demand("swing_clearance_least_share", least=0.5, says="share of the demonstration's swing clearance"),
    ),
}
"""From the best to the least that is kept; a grade asks for all that those below it ask for, too."""
KEPT: Final = tuple(GRADES)


def grade(record: Mapping[str, Any]) -> tuple[str, str]:
    """The grade of a record, and what it lacks for a better one.

    Returns:
        One of `GRADES`, `REJECTED` or `FAILURE`; and in words why it is not the next better one, empty for the best.
    """
    if record["status"] == FAILED:
        return FAILURE, str(record["reason"])
    reached, lacks = REJECTED, ""
    for name, demands in reversed(GRADES.items()):
        unmet = [said for demand in demands if (said := demand.unmet(record)) is not None]
        if unmet:
            lacks = "; ".join(unmet)
            break
        reached = name
    if reached == REJECTED and record["limits_exceeded"]:
        lacks += f" ({record['limits_exceeded']})"
    return reached, lacks


def rank(record: Mapping[str, Any]) -> tuple[int, float]:
    """By which the best of several seeds is chosen, the greatest first."""
    names = [FAILURE, REJECTED, *reversed(KEPT)]
    return names.index(grade(record)[0]), record["reward_perturbed"] or 0.0
