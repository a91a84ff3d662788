"""The folder of `stress` and `transfer`: rows of finished parts, each with the digest of its content."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from fastmimic.base.errors import OutputError
from fastmimic.base.files import check_folder, write_json, write_text
from fastmimic.base.machine import versions
from fastmimic.experiments.comparison_run import Row
from fastmimic.runs.work_folder import ENVIRONMENT, MOTIONS, WorkFolder


def open_results(
    path: Path,
    experiment: str,
    parts: str,
    written: Sequence[str],
    settings: Mapping[str, Any],
    *,
    resume: bool,
    overwrite: bool,
) -> WorkFolder:
    """Checks a folder before long work begins, and writes its `environment.json`.

    Args:
        experiment: its name, such as "stress".
        parts: name of the subfolder with the finished parts.
        written: names of the files made from the parts.
        settings: must equal the earlier ones to resume.

    Raises `ConfigError` for both `resume` and `overwrite`, `OutputError` if the folder holds other files or cannot be
    written.
    """
    files = (*written, f"{parts}/*.json", f"{MOTIONS}/*.npz")
    folder = WorkFolder(path, "an experiment", ENVIRONMENT, "settings", files, experiment)
    folder.check(settings, resume=resume, overwrite=overwrite)
    check_folder(path)
    if overwrite:
        folder.clear()
    about = {"experiment": experiment, "settings": dict(settings), "versions": versions()}
    write_json(path / ENVIRONMENT, about)
    return folder


def save_part(path: Path, rows: Sequence[Row], digest: str) -> None:
    """Writes finished rows; raises `OutputError` if it cannot."""
    write_text(path, json.dumps({"digest": digest, "rows": list(rows)}, indent=1, allow_nan=False))


def load_part(path: Path, digest: str) -> list[Row] | None:
    """Finished rows, or None; raises `OutputError` if they are damaged or of another content."""
    if not path.is_file():
        return None
    of, rows = _read(path)
    if of != digest:
        raise OutputError(f"{path} is of another motion or controller; choose another --out, or give --overwrite")
    return rows


def all_parts(folder: Path) -> list[Row]:
    """The rows of all parts in a folder; raises `OutputError` for a damaged one."""
    return [row for path in sorted(folder.glob("*.json")) for row in _read(path)[1]]


def _read(path: Path) -> tuple[str, list[Row]]:
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
        return str(found["digest"]), [dict(row) for row in found["rows"]]
    except (OSError, ValueError, TypeError, KeyError) as error:
        raise OutputError(f"{path}: cannot be read ({error}); remove it, and --resume makes it anew") from None
