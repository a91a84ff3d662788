"""The record of a motion: description, source, figures, and the motion's file."""

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from fastmimic.base.files import write_text

Record = dict[str, Any]

RECORDS: Final = "records"
MOTIONS: Final = "motions"

DONE: Final = "done"
FAILED: Final = "failed"

IDENTITY: Final = {
    "id": str,
    "name": str,
    "source": str,
    "first_frame": int,
    "end_frame": int,
    "piece": str,
    "gait": str,
    "footfall": str,
    "confidence": float,
    "robot": str,
    "robot_file": str,
    "robot_digest": str,
    "method": str,
    "seed": int,
    "recipe": str,
    "licence": str,
    "credit": str,
    "status": str,
    "reason": str,
}
"""Columns of every record; `source` is its place, `piece` the digest of the excerpt's content, `robot_file` a user's
MJCF, `robot_digest` that of the robot's description, `reason` that of a failure."""

FIGURES: Final = {
    "period_s": float,
    "speed_m_s": float,
    "yaw_rate_rad_s": float,
    "duty_factor": float,
    "repeats": bool,
    "reward": float,
    "reward_before": float,
    "reward_perturbed": float,
    "reward_std": float,
    "reward_robots": float,
    "reward_robots_worst": float,
    "reward_second_simulator": float,
    "fell": bool,
    "fell_before": bool,
    "fell_perturbed": float,
    "fell_robots": float,
    "fell_second_simulator": float,
    "style_distance": float,
    "style_distance_realised": float,
    "swing_clearance_m": float,
    "swing_clearance_least_share": float,
    "early_contacts_per_s": float,
    "stance_slip_m": float,
    "drift_m_per_s": float,
    "joint_speed_share": float,
    "torque_share": float,
    "friction_needed": float,
    "flight_share": float,
    "limits_exceeded": str,
    "warm_start": str,
    "parameters": str,
    "iterations": int,
    "evaluations": int,
    "simulated_s": float,
    "motion_file": str,
    "motion_sha256": str,
    **{f"{name}_version": str for name in ("fastmimic", "python", "mujoco", "daqp", "cma", "numba", "numpy")},
}
"""Further columns of a finished motion. `limits_exceeded` is from `fastmimic.episode.feasibility.reasons`; `warm_start`
is the record that the search began from."""
COSTS: Final = {"wall_s": float, "cpu_s": float, "finished": str}  # differ between repetitions

COLUMNS: Final = {**IDENTITY, **FIGURES, **COSTS}
"""Name → type. A record has a value or None in each."""
_KINDS: Final[dict[type, Any]] = {str: str, int: int, float: (int, float), bool: (bool, int, float)}  # as JSON has them
_NEEDED: Final = ("name", "piece", "robot", "robot_digest", "seed", "recipe", "status")


def empty() -> Record:
    return dict.fromkeys(COLUMNS)


def sha256(path: Path) -> str:
    """Digest of a file's content; raises `OSError`."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def record_file(folder: Path, identity: str) -> Path:
    """A record's file in a library."""
    return folder / RECORDS / f"{identity}.json"


def save_record(folder: Path, record: Mapping[str, Any]) -> None:
    """Writes a record, after its motion; raises `OutputError` if it cannot."""
    text = json.dumps(record, indent=1, allow_nan=False)
    write_text(record_file(folder, record["id"]), text)


def load_record(folder: Path, identity: str) -> Record | None:
    """A record, or None unless it and its motion are intact. A new build repairs damaged or changed ones."""
    return None if (found := read_record(record_file(folder, identity))) is None or damage(folder, found) else found


def read_record(path: Path) -> Record | None:
    """The record in a file; None if there is none."""
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    if not isinstance(found, dict) or found.keys() != COLUMNS.keys() or found["id"] != path.stem:
        return None
    whole = all(value is None or isinstance(value, _KINDS[COLUMNS[name]]) for name, value in found.items())
    return found if whole and all(found[name] is not None for name in _NEEDED) else None


def damage(folder: Path, record: Mapping[str, Any]) -> str | None:
    """The defect of a record's motion; None if it is intact."""
    name = record["motion_file"]
    if name is None:
        return None if record["status"] == FAILED else "it names no motion"
    try:
        return None if sha256(folder / name) == record["motion_sha256"] else f"{name} is not what was written"
    except OSError as error:
        return f"{name}: {error.strerror or error}"
