"""Folders of long work and of single runs: their files, and the rules to replace or resume them."""

import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path, PurePath
from typing import Any, Final

from fastmimic.base.errors import CheckpointError, ConfigError, OutputError
from fastmimic.base.files import check_folder, read_json, remove_file, write_json, write_text
from fastmimic.motion.motion import Motion

CHECKPOINT: Final = "checkpoint.npz"
MOTION: Final = "motion.npz"
METRICS: Final = "metrics.json"
CONFIG: Final = "config.json"
ENVIRONMENT: Final = "environment.json"
RESULTS_CSV: Final = "results.csv"
TABLE: Final = "table.md"
MOTIONS: Final = "motions"
PART_CHECKPOINT: Final = "checkpoint-{}.npz"  # of one motion of a stitched run, by number
CHECKPOINTS: Final = "checkpoint*.npz"
CONVERGENCE: Final = "convergence.png"
TRACKING: Final = "tracking.png"
VIDEO: Final = "video.mp4"
RESULTS: Final = (METRICS, MOTION, CONVERGENCE, TRACKING, VIDEO)
"""`metrics.json` is written last and removed first: if it exists, the others belong to it."""


@dataclass(frozen=True)
class WorkFolder:
    """A folder of long work, which is begun, resumed or replaced."""

    path: Path
    what: str  # the kind of work with its article, such as "a training"
    record: str  # name of the JSON file with the settings of the work
    section: str  # the object in `record` that must be the same to resume
    files: tuple[str, ...]  # patterns of the other files of the work, relative to the folder
    experiment: str | None = None  # name of the experiment in `record`; None for other work

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
        """Checks the folder before long work begins or resumes; writes nothing. `same` are settings that must equal the
        earlier ones to resume; `begun` says whether earlier work would lose anything. Raises `ConfigError` for both
        `resume` and `overwrite`, `OutputError` if the folder holds other files or work, or nothing to resume."""
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
            ways = "--resume goes on with it, --overwrite replaces it, or choose another --out"
            raise OutputError(f"{path} holds {what}; {ways}")
        if resume and (old := differences(same, earlier)):
            said = f"{path} holds {what} of other settings ({old})"
            raise OutputError(f"{said}; --resume it with these, or choose another --out")

    def clear(self) -> None:
        """Removes the work's files, and subfolders that are empty afterwards; raises `OutputError`."""
        for pattern in (self.record, *self.files):
            for file in self.path.glob(pattern):
                remove_file(file)
            for parent in list(PurePath(pattern).parents)[:-1]:
                for folder in self.path.glob(str(parent)):
                    with suppress(OSError):  # it holds something else
                        folder.rmdir()

    def write(self, name: str, text: str) -> None:
        """Replaces one of the files; raises `OutputError`."""
        write_text(self.path / name, text)

    def read(self, *names: str) -> str:
        """The texts of the existing ones of these files, joined."""
        files = [self.path / name for name in names]
        return "\n".join(file.read_text(encoding="utf-8") for file in files if file.is_file())


@dataclass(frozen=True)
class RunFolder(WorkFolder):
    """The folder of one run. Other than longer work, a finished one of the same arguments is replaced."""

    @classmethod
    def at(cls, path: Path) -> "RunFolder":
        return cls(path, "a run", CONFIG, "arguments", (*RESULTS, CHECKPOINT))

    @property
    def checkpoint(self) -> Path:
        return self.path / CHECKPOINT

    @property
    def checkpoints(self) -> list[Path]:
        """Existing checkpoints, including those of a stitched run's motions."""
        return sorted(self.path.glob(CHECKPOINTS))

    @property
    def finished(self) -> bool:
        return (self.path / METRICS).is_file()

    def write_run(
        self, motion: Motion, config: Mapping[str, Any], metrics: Mapping[str, Any], *, searched: bool
    ) -> None:
        """Writes the motion, `config.json` and `metrics.json`; raises `OutputError` if it cannot. Unless `searched`,
        the run has no checkpoint, and an earlier run's is removed."""
        motion.save(self.path / MOTION)
        write_json(self.path / CONFIG, config)
        if not searched:
            remove_file(self.checkpoint)
        self.write_metrics(metrics, None)

    def write_metrics(self, metrics: Mapping[str, Any], video_s: float | None) -> None:
        """Writes `metrics.json` with the video's rendering time, s; raises `OutputError`."""
        write_json(self.path / METRICS, {**metrics, "video_s": video_s})

    def check_run(self, same: Mapping[str, Any], *, resume: bool, overwrite: bool) -> None:
        """Checks the folder before a run begins; writes nothing. Raises as `open_run`."""
        if resume and overwrite:
            raise ConfigError("--resume goes on with a run and --overwrite replaces it: give one of them")
        if resume and not self.checkpoints:
            raise CheckpointError(f"{self.checkpoint}: no checkpoint to resume from; leave out --resume to start anew")
        if resume or overwrite:
            return
        arguments = self.earlier()
        if arguments is None and (found := self.found()):
            said = f"{self.path} holds {', '.join(found)} of something else"
            raise OutputError(f"{said}; choose another --out, or --overwrite them")
        if arguments is not None and (old := differences(same, arguments)):
            ways = "choose another --out, or --overwrite it, or --resume it with its own arguments"
            raise OutputError(f"{self.path} holds another run ({old}); {ways}")
        interrupted = not self.finished or bool(read_json(self.path / METRICS).get("interrupted"))
        if self.checkpoints and interrupted:
            ways = "go on with it by --resume, or start it anew by --overwrite"
            raise OutputError(f"{self.path} holds this run, unfinished; {ways}")


@contextmanager
def open_run(
    path: Path, config: Mapping[str, Any], same: Mapping[str, Any], *, resume: bool, overwrite: bool
) -> Iterator[RunFolder]:
    """Prepares a folder for a run before long work begins; unchanged if the run fails. One of other arguments, or an
    unfinished or interrupted one, is refused unless `overwrite` or `resume`; a finished one of the same arguments is
    replaced. Until there are results, `config.json` holds `config`; `same` are the arguments that make a run the same.
    Raises `ConfigError` for both `resume` and `overwrite`, `CheckpointError` if there is nothing to resume from, and
    `OutputError` if the folder holds another run, or cannot be written to."""
    folder = RunFolder.at(path)
    with created(path):
        folder.check_run(same, resume=resume, overwrite=overwrite)
        started = not resume and not folder.finished
        had_config = (path / CONFIG).is_file()
        if started:
            write_json(path / CONFIG, config)
        try:
            yield folder
        except BaseException:
            if started and not had_config and not folder.checkpoints and not folder.finished:
                (path / CONFIG).unlink(missing_ok=True)
            raise


def default_folder(root: Path, name: str, *, resume: bool) -> Path:
    """`root/name`, or with -2, -3, … appended: the first free one; to resume, the last with a checkpoint."""
    path, taken = root / name, []
    while path.is_file() or (path.is_dir() and any(path.iterdir())):
        taken.append(path)
        path = root / f"{name}-{len(taken) + 1}"
    if not resume:
        return path
    unfinished = [p for p in taken if RunFolder.at(p).checkpoints]
    return unfinished[-1] if unfinished else root / name


def differences(same: Mapping[str, Any], earlier: Mapping[str, Any]) -> str:
    """The earlier values of the settings that differ, in words; empty if none differs."""
    names = [name for name, value in same.items() if earlier.get(name) != value]
    return ", ".join(f"{name.replace('_', '-')} {earlier.get(name)}" for name in names)


@contextmanager
def created(path: Path) -> Iterator[None]:
    """Makes a folder with its parents, for this process alone; if that fails, removes empty ones; or `OutputError`."""
    new = [folder for folder in (path, *path.parents) if not folder.exists()]
    check_folder(path)
    handle = os.open(path, os.O_RDONLY)
    if not lock(handle):
        os.close(handle)
        raise OutputError(f"{path}: another process works in it; wait until it ends, or choose another --out")
    try:
        yield
    except BaseException:
        for folder in new:
            with suppress(OSError):  # it holds something else
                folder.rmdir()
        raise
    finally:
        os.close(handle)


@contextmanager
def of_finished(path: Path) -> Iterator[None]:
    """Makes something of the finished parts in a folder; raises `OutputError` if that does not work."""
    try:
        yield
    except (LookupError, ValueError, TypeError, ArithmeticError, AttributeError) as error:
        said = f"holds other values than were written ({type(error).__name__}: {error})"
        raise OutputError(f"{path}: a finished part {said}; remove it, and --resume makes it anew") from error


def lock(handle: int, *, shared: bool = False) -> bool:
    """Locks an open file or folder against other processes, or against those that do not share it; returns whether no
    other has it. The lock is the system's: it ends with the process, even a killed one."""
    import fcntl

    try:
        fcntl.flock(handle, (fcntl.LOCK_SH if shared else fcntl.LOCK_EX) | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:  # a file system without locks
        pass
    return True
