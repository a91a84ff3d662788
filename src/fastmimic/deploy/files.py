"""What lies in the folder of a deployment."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

from fastmimic.base.errors import OutputError
from fastmimic.base.files import check_folder

LOG: Final = "log.npz"
MOTION: Final = "motion.npz"
RESULT: Final = "deployment.json"
"""Written last."""


@contextmanager
def open_deployment(folder: Path) -> Iterator[None]:
    """Makes sure that a deployment can be written to a folder, in place of an earlier one and of nothing else. If the
    block fails before anything is written, there are no more folders than before.

    Raises:
        OutputError: it holds something else, or cannot be written to.
    """
    if folder.is_dir() and any(folder.iterdir()) and not (folder / RESULT).is_file():
        raise OutputError(f"{folder} holds something else than a deployment; choose another --out")
    created = [path for path in (folder, *folder.parents) if not path.exists()]
    check_folder(folder)
    try:
        yield
    except BaseException:
        for path in created:
            try:
                path.rmdir()
            except OSError:  # not empty, or gone
                break
        raise
