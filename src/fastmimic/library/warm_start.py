"""Where a search begins: like the motion of a library that was made of the most similar piece.

Similar is what a controller meets alike: about the same period, speed and turning, and the same footfall, on the same
robot. What is taken over is how that motion was modulated (`fastmimic.optimize.parameters.moved_by`), not its style.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from fastmimic.library.folder import Library, Row, robot_of
from fastmimic.library.jobs import WarmStart
from fastmimic.library.pieces import Piece

TEMPO: Final = 0.2
SPEED_M_S: Final = 0.4
YAW_RAD_S: Final = 0.6
OTHER_FOOTFALL: Final = 1.0
"""By which two pieces are one apart: the logarithm of the period, speed, turning; and what another footfall counts."""
FARTHEST: Final = 6.0
"""From which the nearest piece is no help."""


def distance(a: Piece, b: Piece) -> float:
    """How different two pieces are, 0 for the same."""
    apart = math.hypot(
        math.log(a.period_s / b.period_s) / TEMPO,
        (a.speed_m_s - b.speed_m_s) / SPEED_M_S,
        (a.yaw_rate_rad_s - b.yaw_rate_rad_s) / YAW_RAD_S,
    )
    other = a.footfall is not None and b.footfall is not None and a.footfall != b.footfall
    return apart + (OTHER_FOOTFALL if other else 0.0)


@dataclass(frozen=True, eq=False)
class Neighbours:
    """What a library knows.

    Attributes:
        library: the folder.
        pieces: by digest.
        best: by robot, name or file, the best row of each piece, of those that are kept.
    """

    library: Path
    pieces: Mapping[str, Piece]
    best: Mapping[str, Sequence[Row]]

    @classmethod
    def of(cls, library: Library) -> "Neighbours":
        """Of a library as its index is now; raises `LibraryError`."""
        pieces = {piece.digest: piece for survey in library.surveys() for piece in survey.pieces}
        best: dict[str, list[Row]] = {}
        for row in library.index():
            if row["best"] and row["repeats"] and row["parameters"] and row["piece"] in pieces:
                best.setdefault(robot_of(row), []).append(row)
        return cls(library.path.resolve(), pieces, best)

    def nearest(self, piece: Piece, robot: str) -> WarmStart | None:
        """What a search for a piece begins like; None if nothing of the robot's is near.

        Args:
            piece: the piece.
            robot: its name, or the path of its MJCF.
        """
        rows = self.best.get(robot, ()) if piece.repeats else ()
        near = min(rows, key=lambda row: (distance(piece, self.pieces[row["piece"]]), row["id"]), default=None)
        if near is None or distance(piece, self.pieces[near["piece"]]) > FARTHEST:
            return None
        return WarmStart(near["id"], self.library / near["motion_file"])
