"""What lies in the folder of a deployment."""

from pathlib import Path
from typing import Final

from fastmimic.errors import OutputError
from fastmimic.files import check_folder

LOG: Final = "log.npz"
MOTION: Final = "motion.npz"
RESULT: Final = "deployment.json"
"""Written last."""


def check_deployment_folder(folder: str | Path) -> None:
    """Makes sure that a deployment can be written there, in place of an earlier one and of nothing else.

    Raises:
        OutputError: it holds something else, or cannot be written to.
    """
    folder = Path(folder)
    if folder.is_dir() and any(folder.iterdir()) and not (folder / RESULT).is_file():
        raise OutputError(f"{folder} holds something else than a deployment; choose another --out")
    check_folder(folder)
