"""The folder of one run of `imitate` or `stitch`."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from fastmimic.base.errors import CheckpointError, ConfigError, OutputError
from fastmimic.base.files import read_json, read_section, remove_file, write_json
from fastmimic.motion.motion import Motion
from fastmimic.runs.work_folder import CHECKPOINT, CONFIG, METRICS, MOTION, created, differences

PART_CHECKPOINT: Final = "checkpoint-{}.npz"  # of one motion of a stitched run, by number
CHECKPOINTS: Final = "checkpoint*.npz"
CONVERGENCE: Final = "convergence.png"
TRACKING: Final = "tracking.png"
VIDEO: Final = "video.mp4"
RESULTS: Final = (METRICS, MOTION, CONVERGENCE, TRACKING, VIDEO)
"""`metrics.json` is written last and removed first: if it exists, the others belong to it."""


@dataclass(frozen=True)
class RunFolder:
    """The files of a run."""

    path: Path

    @property
    def checkpoint(self) -> Path:
        """The file with the state of the optimisation."""
        return self.path / CHECKPOINT

    @property
    def checkpoints(self) -> list[Path]:
        """Existing checkpoints, including those of a stitched run's motions."""
        return sorted(self.path.glob(CHECKPOINTS))

    @property
    def finished(self) -> bool:
        """Whether the folder holds results."""
        return (self.path / METRICS).is_file()

    def clear_results(self) -> None:
        """Removes the results of an earlier run; raises `OutputError`."""
        self._remove(*RESULTS)

    def write(self, motion: Motion, config: Mapping[str, Any], metrics: Mapping[str, Any], *, searched: bool) -> None:
        """Writes the motion, `config.json` and `metrics.json`; raises `OutputError` if it cannot. Unless `searched`,
        the run has no checkpoint, and an earlier run's is removed."""
        motion.save(self.path / MOTION)
        write_json(self.path / CONFIG, config)
        if not searched:
            self._remove(CHECKPOINT)
        self.write_metrics(metrics, None)

    def write_metrics(self, metrics: Mapping[str, Any], video_s: float | None) -> None:
        """Writes `metrics.json` with the video's rendering time, s; raises `OutputError`."""
        found: dict[str, Any] = {}
        for key, value in metrics.items():
            found[key] = value
            if key == "wall_s":
                found["video_s"] = video_s
        write_json(self.path / METRICS, found)

    def check(self, same: Mapping[str, Any], *, resume: bool, overwrite: bool) -> None:
        """Checks the folder before a run begins; writes nothing. Raises as `open_run`."""
        if resume and overwrite:
            raise ConfigError("--resume goes on with a run and --overwrite replaces it: give one of them")
        if resume and not self.checkpoints:
            raise CheckpointError(f"{self.checkpoint}: no checkpoint to resume from; leave out --resume to start anew")
        if resume or overwrite:
            return
        found = [name for name in (*RESULTS, CONFIG, CHECKPOINT) if (self.path / name).exists()]
        arguments = read_section(self.path / CONFIG, "arguments")
        if found and arguments is None:
            raise OutputError(
                f"{self.path} holds {', '.join(found)} of something else; choose another --out, or --overwrite them"
            )
        if arguments is not None and (old := differences(same, arguments)):
            raise OutputError(
                f"{self.path} holds another run ({old}); choose another --out, or --overwrite it,"
                " or --resume it with its own arguments"
            )
        interrupted = not self.finished or bool(read_json(self.path / METRICS).get("interrupted"))
        if self.checkpoints and interrupted:
            raise OutputError(
                f"{self.path} holds this run, unfinished; go on with it by --resume, or start it anew by --overwrite"
            )

    def _remove(self, *names: str) -> None:
        for name in names:
            remove_file(self.path / name)


@contextmanager
def open_run(
    path: Path, config: Mapping[str, Any], same: Mapping[str, Any], *, resume: bool, overwrite: bool
) -> Iterator[RunFolder]:
    """Prepares a folder for a run before long work begins. If the run fails, the folder is unchanged.

    A folder with a run of other arguments, or with an unfinished or interrupted run, is refused unless `overwrite` or
    `resume`. A finished run of the same arguments is replaced. Until there are results, `config.json` describes the run
    in progress.

    Args:
        config: the content of `config.json`; its `arguments` identify the run.
        same: the arguments that must be equal for a run to be the same.

    Raises `ConfigError` for both `resume` and `overwrite`, `CheckpointError` if there is nothing to resume from, and
    `OutputError` if the folder holds another run, or cannot be written to.
    """
    folder = RunFolder(path)
    folder.check(same, resume=resume, overwrite=overwrite)
    with created(path):
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
    unfinished = [p for p in taken if RunFolder(p).checkpoints]
    return unfinished[-1] if unfinished else root / name
