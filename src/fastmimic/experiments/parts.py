"""The parts of an experiment: files of finished rows, each with the digest of what it is of."""

import json
from collections.abc import Sequence
from pathlib import Path

from fastmimic.base.errors import OutputError
from fastmimic.base.files import replace_file
from fastmimic.experiments.comparison_run import Row


def save_part(path: Path, rows: Sequence[Row], digest: str) -> None:
    """Writes finished rows.

    Raises:
        OutputError: they cannot be written.
    """
    text = json.dumps({"digest": digest, "rows": list(rows)}, indent=1, allow_nan=False)
    replace_file(path, lambda file: file.write(text.encode()))


def load_part(path: Path, digest: str) -> list[Row] | None:
    """Finished rows, or None if there are none.

    Raises:
        OutputError: they cannot be read, or are of something else.
    """
    if not path.is_file():
        return None
    of, rows = _read(path)
    if of != digest:
        raise OutputError(f"{path} is of another motion or controller; choose another --out, or give --overwrite")
    return rows


def all_parts(folder: Path) -> list[Row]:
    """The rows of all parts in a folder.

    Raises:
        OutputError: one cannot be read.
    """
    return [row for path in sorted(folder.glob("*.json")) for row in _read(path)[1]]


def _read(path: Path) -> tuple[str, list[Row]]:
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
        return str(found["digest"]), [dict(row) for row in found["rows"]]
    except (OSError, ValueError, TypeError, KeyError) as error:
        raise OutputError(f"{path}: cannot be read ({error}); remove it, and --resume makes it anew") from None
