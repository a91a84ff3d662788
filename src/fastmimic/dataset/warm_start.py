"""Where a search begins: like the motion of a library that was made of the most similar piece.

Similar is what a controller meets alike: about the same period, speed and turning, and the same footfall, on the same
robot. What is taken over is how that motion was modulated (`fastmimic.optimize.parameters.moved_by`), not its style.
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
from fastmimic.dataset.jobs import WarmStart
from fastmimic.dataset.membership import robot_of

TEMPO: Final = 0.2
SPEED_M_S: Final = 0.4
YAW_RAD_S: Final = 0.6
OTHER_FOOTFALL: Final = 1.0
"""By which two pieces are one apart: the logarithm of the period, speed, turning; and what another footfall counts."""
FARTHEST: Final = 6.0
"""From which the nearest piece is no help."""
_ROUNDING: Final = 1e-9
_COLUMNS: Final = ("id", "piece", "robot", "robot_file", "best", "repeats", "parameters", "motion_file")


def distance(a: Excerpt, b: Excerpt) -> float:
    """How different two pieces are, 0 for the same."""
    apart = math.hypot(
        math.log(a.period_s / b.period_s) / TEMPO,
        (a.speed_m_s - b.speed_m_s) / SPEED_M_S,
        (a.yaw_rate_rad_s - b.yaw_rate_rad_s) / YAW_RAD_S,
    )
    return apart + _other(a.footfall, b.footfall)


@dataclass(frozen=True, eq=False)
class Neighbours:
    """What a library knows.

    Attributes:
        library: the folder.
        pieces: by digest.
        best: by robot, name or file, the best row of each piece, of those that are kept.
    """

    library: Path
    pieces: Mapping[str, Excerpt]
    best: Mapping[str, Sequence[Row]]

    @classmethod
    def of(cls, library: MotionDataset) -> "Neighbours":
        """Of a library as its index is now; raises `LibraryError` if that, or what it is made of, is damaged."""
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
        """What a search for a piece begins like; None if nothing of the robot's is near.

        Args:
            piece: the piece.
            robot: its name, or the path of its MJCF.
        """
        rows = self._near(piece, robot) if piece.repeats else []
        near = min(rows, key=lambda row: (distance(piece, self.pieces[row["piece"]]), row["id"]), default=None)
        if near is None or distance(piece, self.pieces[near["piece"]]) > FARTHEST:
            return None
        return WarmStart(near["id"], self.library / near["motion_file"])

    def _near(self, piece: Excerpt, robot: str) -> list[Row]:
        """A few rows among which the nearest is."""
        groups = self._groups.get(robot, {})
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
    def _groups(self) -> dict[str, dict[str | None, tuple[KDTree, list[Row]]]]:
        """The rows of each robot by footfall, with a tree of where they are."""
        sorted_rows: dict[str, dict[str | None, list[Row]]] = {}
        for robot, rows in self.best.items():
            for row in rows:
                sorted_rows.setdefault(robot, {}).setdefault(self.pieces[row["piece"]].footfall, []).append(row)
        return {
            robot: {f: (KDTree([_place(self.pieces[r["piece"]]) for r in rows]), rows) for f, rows in groups.items()}
            for robot, groups in sorted_rows.items()
        }


def _place(piece: Excerpt) -> tuple[float, float, float]:
    """Of a piece among all: as far from another as `distance` says, but for the footfall."""
    return math.log(piece.period_s) / TEMPO, piece.speed_m_s / SPEED_M_S, piece.yaw_rate_rad_s / YAW_RAD_S


def _other(a: str | None, b: str | None) -> float:
    return OTHER_FOOTFALL if a is not None and b is not None and a != b else 0.0
