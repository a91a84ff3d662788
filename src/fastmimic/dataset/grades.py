"""Grades of motions, by one table for all of them.

Records keep only figures; grades are computed on demand, so that other thresholds need no new run.
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
        figure: of the record; ignored if the record lacks it, because it was not evaluated.
        least, most: inclusive bounds; None for no bound.
    """

    figure: str
    least: float | None = None
    most: float | None = None
    says: str = ""

    def unmet(self, record: Mapping[str, Any]) -> str | None:
        """The violation in words; None if the record meets the demand."""
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
"""From the best grade to the lowest; a grade includes the demands of those below it."""
KEPT: Final = tuple(GRADES)


def grade(record: Mapping[str, Any]) -> tuple[str, str]:
    """The grade of a record (`GRADES`, `REJECTED` or `FAILURE`), and why it is not better; empty for the best."""
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
    """Sort key; the greatest is the best of several seeds."""
    names = [FAILURE, REJECTED, *reversed(KEPT)]
    return names.index(grade(record)[0]), record["reward_perturbed"] or 0.0
