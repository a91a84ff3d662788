"""The folder of a deployment: `log.npz`, `motion.npz`, and `deployment.json`, which is written last."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

from fastmimic.base.errors import OutputError
from fastmimic.runs.work_folder import created

LOG: Final = "log.npz"
RESULT: Final = "deployment.json"


@contextmanager
def open_deployment(folder: Path) -> Iterator[None]:
    """Prepares a folder, which may hold an earlier deployment; if the block fails, the folder is unchanged. Raises
    `OutputError` if it holds something else or cannot be written to."""
    if folder.is_dir() and any(folder.iterdir()) and not (folder / RESULT).is_file():
        raise OutputError(f"{folder} holds something else than a deployment; choose another --out")
    with created(folder):
        yield
