"""Warm starts: a search begins from the library's motion of the most similar excerpt.

Similar excerpts have about the same period, speed and turning, and the same footfall, on the same robot. The search
takes over the motion's modulation (`fastmimic.optimize.parameters.moved_by`), not its style.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Final

from scipy.spatial import KDTree

from fastmimic.base.errors import LibraryError
from fastmimic.dataset.excerpts import Excerpt
from fastmimic.dataset.folder import MotionDataset, Row
from fastmimic.dataset.index import robot_of
from fastmimic.dataset.jobs import WarmStart

TEMPO: Final = 0.2
SPEED_M_S: Final = 0.4
YAW_RAD_S: Final = 0.6
OTHER_FOOTFALL: Final = 1.0
"""Distances of one unit: of the logarithm of the period, speed, turning; and the distance for another footfall."""
FARTHEST: Final = 6.0  # greatest distance of a useful excerpt
_ROUNDING: Final = 1e-9
_COLUMNS: Final = ("id", "piece", "robot", "robot_file", "best", "repeats", "parameters", "motion_file")


def distance(a: Excerpt, b: Excerpt) -> float:
    """Difference of two excerpts, 0 for the same."""
    apart = math.hypot(
        math.log(a.period_s / b.period_s) / TEMPO,
        (a.speed_m_s - b.speed_m_s) / SPEED_M_S,
        (a.yaw_rate_rad_s - b.yaw_rate_rad_s) / YAW_RAD_S,
    )
    return apart + _other(a.footfall, b.footfall)


@dataclass(frozen=True, eq=False)
class Neighbours:
    """Excerpts of a library by digest, and for each robot (name or file) the best kept row of each excerpt."""

    library: Path
    pieces: Mapping[str, Excerpt]
    best: Mapping[str, Sequence[Row]]

    @classmethod
    def of(cls, library: MotionDataset) -> "Neighbours":
        """From a library's present index; raises `LibraryError` if that or a source's file is damaged."""
        plan = library.plan()
        if plan.unreadable:
            raise LibraryError(f"{library.path}: {plan.unreadable[0]}")
        pieces = {digest: there[-1] for digest, there in plan.pieces.items()}
        best: dict[str, list[Row]] = {}
        for row in library.index(_COLUMNS):
            if row["best"] and row["repeats"] and row["parameters"] and row["piece"] in pieces:
                best.setdefault(robot_of(row), []).append(row)
        return cls(library.path.resolve(), pieces, best)

    def nearest(self, piece: Excerpt, robot: str) -> WarmStart | None:
        """The start of a search for an excerpt on a robot (name or MJCF); None if no excerpt on that robot is near."""
        rows = self._near(piece, robot) if piece.repeats else []
        near = min(rows, key=lambda row: (distance(piece, self.pieces[row["piece"]]), row["id"]), default=None)
        if near is None or distance(piece, self.pieces[near["piece"]]) > FARTHEST:
            return None
        return WarmStart(near["id"], self.library / near["motion_file"])

    def _near(self, piece: Excerpt, robot: str) -> list[Row]:
        """A few rows that include the nearest."""
        groups = {footfall: group for (name, footfall), group in self._groups.items() if name == robot}
        at = _place(piece)
        apart = {footfall: _other(piece.footfall, footfall) for footfall in groups}
        least = min((tree.query(at)[0] + apart[f] for f, (tree, _) in groups.items()), default=math.inf)
        if least > FARTHEST + _ROUNDING:
            return []
        return [
            rows[i]
            for footfall, (tree, rows) in groups.items()
            if least >= apart[footfall]
            for i in tree.query_ball_point(at, least - apart[footfall] + _ROUNDING)
        ]

    @cached_property
    def _groups(self) -> dict[tuple[str, str | None], tuple[KDTree, list[Row]]]:
        """The rows of each robot and footfall, with a tree of their places."""
        found: dict[tuple[str, str | None], list[Row]] = {}
        for robot, rows in self.best.items():
            for row in rows:
                found.setdefault((robot, self.pieces[row["piece"]].footfall), []).append(row)
        return {key: (KDTree([_place(self.pieces[row["piece"]]) for row in rows]), rows) for key, rows in found.items()}


def _place(piece: Excerpt) -> tuple[float, float, float]:
    """Coordinates of an excerpt; their distance is `distance` without the footfall."""
    return math.log(piece.period_s) / TEMPO, piece.speed_m_s / SPEED_M_S, piece.yaw_rate_rad_s / YAW_RAD_S


def _other(a: str | None, b: str | None) -> float:
    return OTHER_FOOTFALL if a is not None and b is not None and a != b else 0.0
