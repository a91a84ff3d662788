"""Output of the verbs: results on stdout."""

import json
import sys
from collections.abc import Mapping, Sequence
from typing import Any, Final

EXIT_INTERRUPTED: Final = 130  # as a shell reports SIGINT
EXIT_SOME_FAILED: Final = 3  # some sources or motions failed; everything else is done
EXIT_CUT_OFF: Final = 4  # all went as planned, but the log or the figures are not on the disk

KEPT: Final = "finished parts are kept; the same command with --resume continues"


def put(*lines: str) -> None:
    """Prints lines of the result on stdout."""
    sys.stdout.writelines(f"{line}\n" for line in lines)


def put_json(value: Mapping[str, Any]) -> None:
    """Prints one JSON object on stdout; infinite and undefined numbers become null."""
    from fastmimic.base.text import plain

    put(json.dumps(plain(value), allow_nan=False))


def put_table(rows: Sequence[Sequence[str]], *, right: Sequence[int] = ()) -> None:
    """Prints rows in aligned columns on stdout; the columns in `right` are aligned to the right."""
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    for row in rows:
        cells = zip(row, widths, strict=True)
        aligned = [cell.rjust(width) if i in right else cell.ljust(width) for i, (cell, width) in enumerate(cells)]
        put("  ".join(aligned).rstrip())
