"""A folder of long work: its files, and the rules to replace or resume it."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path, PurePath
from typing import Any, Final

from fastmimic.base.errors import ConfigError, OutputError
from fastmimic.base.files import check_folder, read_json, remove_file, write_text
from fastmimic.optimize.checkpoint import FILE_NAME

CHECKPOINT: Final = FILE_NAME
MOTION: Final = "motion.npz"
METRICS: Final = "metrics.json"
CONFIG: Final = "config.json"
ENVIRONMENT: Final = "environment.json"
RESULTS_CSV: Final = "results.csv"
TABLE: Final = "table.md"
MOTIONS: Final = "motions"


@dataclass(frozen=True)
class WorkFolder:
    """A folder of long work, which is begun, resumed or replaced.

    Attributes:
        what: the kind of work with its article, such as "a training".
        record: name of the JSON file with the settings of the work.
        section: the object in `record` that must be the same to resume.
        files: patterns of the other files of the work, relative to the folder.
        experiment: name of the experiment in `record`; None for other work.
    """

    path: Path
    what: str
    record: str
    section: str
    files: tuple[str, ...]
    experiment: str | None = None

    def found(self) -> list[str]:
        """Names of the work's existing files and subfolders."""
        names = dict.fromkeys(pattern.split("/")[0] for pattern in (self.record, *self.files))
        return [name for name in names if (self.path / name).exists()]

    def earlier(self) -> dict[str, Any] | None:
        """The settings of the work in the folder; None without such work."""
        try:
            record = read_json(self.path / self.record)
        except ConfigError:
            return None
        settings = record.get(self.section)
        return settings if isinstance(settings, dict) and record.get("experiment") == self.experiment else None

    def check(self, same: Mapping[str, Any], *, resume: bool, overwrite: bool, begun: bool = True) -> None:
        """Checks the folder before long work begins or resumes; writes nothing.

        Args:
            same: settings that must equal the earlier ones to resume.
            begun: whether earlier work would lose anything.

        Raises `ConfigError` for both `resume` and `overwrite`, and `OutputError` if the folder holds other files or
        other work, or there is nothing to resume.
        """
        path, what, earlier = self.path, self.what, self.earlier()
        if resume and overwrite:
            raise ConfigError(f"--resume goes on with {what} and --overwrite replaces it: give one of them")
        if earlier is None and (found := self.found()):
            raise OutputError(f"{path} holds {', '.join(found)} of something else; choose another --out")
        if earlier is None or not begun:
            if resume:
                raise OutputError(f"{path} holds no {what.split()[-1]} to resume; leave out --resume to start one")
            return
        if not (resume or overwrite):
            raise OutputError(
                f"{path} holds {what}; --resume goes on with it, --overwrite replaces it, or choose another --out"
            )
        if resume and (old := differences(same, earlier)):
            raise OutputError(
                f"{path} holds {what} of other settings ({old}); --resume it with these, or choose another --out"
            )

    def clear(self) -> None:
        """Removes the work's files, and subfolders that are empty afterwards; raises `OutputError`."""
        for pattern in (self.record, *self.files):
            for file in self.path.glob(pattern):
                remove_file(file)
            for parent in list(PurePath(pattern).parents)[:-1]:
                for folder in self.path.glob(str(parent)):
                    remove_if_empty(folder)

    def write(self, name: str, text: str) -> None:
        """Replaces one of the files; raises `OutputError`."""
        write_text(self.path / name, text)

    def read(self, *names: str) -> str:
        """The texts of the existing ones of these files, joined."""
        files = [self.path / name for name in names]
        return "\n".join(file.read_text(encoding="utf-8") for file in files if file.is_file())


def differences(same: Mapping[str, Any], earlier: Mapping[str, Any]) -> str:
    """The earlier values of the settings that differ, in words; empty if none differs."""
    names = [name for name, value in same.items() if earlier.get(name) != value]
    return ", ".join(f"{name.replace('_', '-')} {earlier.get(name)}" for name in names)


@contextmanager
def created(path: Path) -> Iterator[None]:
    """Creates a folder with its parents; if the block fails, removes those that are empty. Raises `OutputError` if
    the folder cannot be written to."""
    new = [folder for folder in (path, *path.parents) if not folder.exists()]
    check_folder(path)
    try:
        yield
    except BaseException:
        for folder in new:
            remove_if_empty(folder)
        raise


def remove_if_empty(folder: Path) -> None:
    """Removes a folder; does nothing if it is not empty or does not exist."""
    try:
        folder.rmdir()
    except OSError:
        return
