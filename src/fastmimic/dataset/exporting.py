"""Exports a library's motions for other trainers."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final

from fastmimic.base.errors import LibraryError
from fastmimic.base.files import write_text
from fastmimic.base.text import csv_text
from fastmimic.dataset.folder import MotionDataset, Row
from fastmimic.motion.export import DEFAULT_FPS, EXPORTS, export_motion
from fastmimic.robot import load_robot

LISTED: Final = "motions.csv"
_COLUMNS: Final = (
    *("file", "name", "robot", "seed", "gait", "footfall", "grade", "reward", "period_s", "speed_m_s"),
    *("yaw_rate_rad_s", "source", "licence", "credit", "id"),
)
NEEDED: Final = (*_COLUMNS[1:], "robot_file", "motion_file", "lacks")
"""Columns of the index that an export needs."""


def export_library(
    library: MotionDataset,
    rows: Sequence[Row],
    folder: str | Path,
    form: str,
    *,
    fps: float = DEFAULT_FPS,
    progress: Callable[[int, int], None] | None = None,
) -> Path:
    """Writes motions as `fastmimic.motion.export` does, and a table of them; returns the table's file.

    Args:
        rows: of the library's index, with the columns `NEEDED`, each with a motion.
        form: one of `fastmimic.motion.export.EXPORTS`.
        progress: called with (files done, files in all).

    Raises `FastMimicError` for a folder within the library, an unknown format, a damaged motion, or a file that cannot
    be written.
    """
    if Path(folder).resolve().is_relative_to(library.path.resolve()):
        raise LibraryError(
            f"{folder}: is in the library, whose own motions would be overwritten; choose another folder"
        )
    listed = []
    for i, row in enumerate(rows):
        motion = library.motion(row)
        name = Path(row["motion_file"]).with_suffix(EXPORTS.get(form, "")).name
        export_motion(motion, load_robot(row["robot_file"] or row["robot"]), Path(folder) / name, form, fps=fps)
        listed.append({**row, "file": name})
        if progress is not None:
            progress(i + 1, len(rows))
    path = Path(folder) / LISTED
    write_text(path, csv_text(_COLUMNS, listed))
    return path
