"""The folder of one imitation: what lies in it, and what may be written over."""

import json
import math
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from fastmimic.base.errors import CheckpointError, ConfigError, OutputError
from fastmimic.base.files import check_folder, remove_file, replace_file
from fastmimic.optimize.checkpoint import FILE_NAME as CHECKPOINT

if TYPE_CHECKING:
    from fastmimic.episode.rollout import Rollout
    from fastmimic.imitation.imitate import Imitation
    from fastmimic.render.tracks import Track

CHECKPOINTS: Final = "checkpoint*.npz"
MOTION: Final = "motion.npz"
METRICS: Final = "metrics.json"
CONFIG: Final = "config.json"
CONVERGENCE: Final = "convergence.png"
TRACKING: Final = "tracking.png"
VIDEO: Final = "video.mp4"
RESULTS: Final = (METRICS, MOTION, CONVERGENCE, TRACKING, VIDEO)
"""`metrics.json` is written last and removed first: where it is, the others belong to it."""

TRACKING_CYCLES: Final = 2  # shown in the figure
TRANSITION_S: Final = 2.0  # of a stitched motion, shown instead


@dataclass(frozen=True)
class RunFolder:
    """Where one imitation keeps its files."""

    path: Path

    @property
    def checkpoint(self) -> Path:
        """Where the optimisation keeps its course."""
        return self.path / CHECKPOINT

    @property
    def checkpoints(self) -> list[Path]:
        """Those that are there, a stitched motion's parts' included."""
        return sorted(self.path.glob(CHECKPOINTS))

    @property
    def finished(self) -> bool:
        """Whether the folder holds results."""
        return (self.path / METRICS).is_file()

    def write(self, result: "Imitation", config: Mapping[str, Any]) -> None:
        """Writes everything but the video, in place of an earlier run's files.

        Raises:
            OutputError: something cannot be written.
        """
        self._remove(*RESULTS)
        result.motion.save(self.path / MOTION)
        self._write_figures(result)
        write_json(self.path / CONFIG, config)
        if result.history is None:
            self._remove(CHECKPOINT)  # an earlier run's
        self._write_metrics(result, None)

    def write_video(
        self, result: "Imitation", progress: Callable[[int, int], None] | None = None, quality: str = "preview"
    ) -> bool:
        """Adds the video, and its time to the metrics; False, with a warning in the log, if nothing can draw.

        Args:
            result: already in the folder.
            progress: called with (frames done, frames in all).
            quality: how carefully it is drawn, one of `fastmimic.render.quality.QUALITIES`.

        Raises:
            OutputError: it cannot be written.
        """
        from fastmimic.render.video import render_video

        began = time.perf_counter()
        assert result.before.log is not None
        rate_hz = result.before.log.rate_hz
        tracks = _tracks(result)
        info = render_video(
            result.robot, tracks, self.path / VIDEO, rate_hz=rate_hz, progress=progress, quality=quality
        )
        if info is not None:
            self._write_metrics(result, time.perf_counter() - began)
        return info is not None

    def _write_metrics(self, result: "Imitation", video_s: float | None) -> None:
        metrics = {}
        for key, value in result.metrics().items():
            metrics[key] = value
            if key == "wall_s":
                metrics["video_s"] = video_s
        write_json(self.path / METRICS, metrics)

    def _write_figures(self, result: "Imitation") -> None:
        import numpy as np

        from fastmimic.render.figure_style import save
        from fastmimic.report.figures import convergence_figure

        title = f"{result.motion.name} on {result.robot.name}"
        h = result.history
        if h is not None and len(h.best):
            iteration = range(1, len(h.best) + 1)
            best = h.best if h.randomized else np.maximum(h.best, h.start)
            figure = convergence_figure(
                list(iteration), best, h.mean, h.std, h.sigma, h.baseline, title, randomized=h.randomized
            )
            save(figure, self.path / CONVERGENCE)
        save(_tracking_figure(result, title), self.path / TRACKING)

    def _remove(self, *names: str) -> None:
        for name in names:
            remove_file(self.path / name)


@contextmanager
def open_run(
    path: Path, config: Mapping[str, Any], same: Mapping[str, Any], *, resume: bool, overwrite: bool
) -> Iterator[RunFolder]:
    """Prepares a folder for a run, before anything takes long. If the run fails, the folder is as it was.

    A folder that holds a run of other arguments, or an unfinished one, is refused unless `overwrite` or `resume`; a
    finished one of the same arguments is run anew. While there are no results yet, `config.json` tells of the run under
    way.

    Args:
        path: the folder.
        config: what goes into `config.json`; its `arguments` tell runs apart.
        same: those of the arguments that must be the same for a run to be the same.
        resume: whether the run goes on from the folder's checkpoint.
        overwrite: whether a run of other arguments may be replaced.

    Raises:
        ConfigError: both `resume` and `overwrite`.
        CheckpointError: nothing to resume from.
        OutputError: the folder holds another run, or cannot be written to.
    """
    folder = RunFolder(path)
    if resume and overwrite:
        raise ConfigError("--resume goes on with a run and --overwrite replaces it: give one of them")
    if resume and not folder.checkpoints:
        raise CheckpointError(f"{folder.checkpoint}: no checkpoint to resume from; leave out --resume to start anew")
    if not resume and not overwrite:
        _refuse_other_run(folder, same)
        if folder.checkpoints and not folder.finished:
            raise OutputError(
                f"{path} holds this run, unfinished; go on with it by --resume, or start it anew by --overwrite"
            )
    created = [p for p in (path, *path.parents) if not p.exists()]
    check_folder(path)
    started = not resume and not folder.finished
    had_config = (path / CONFIG).is_file()
    if started:
        write_json(path / CONFIG, config)
    try:
        yield folder
    except BaseException:
        if started and not had_config and not folder.checkpoints and not folder.finished:
            (path / CONFIG).unlink(missing_ok=True)
        _remove_empty(created)
        raise


def default_folder(root: Path, name: str, *, resume: bool) -> Path:
    """`root/name`, or with -2, -3, … appended: the first not taken; to resume, the last with a checkpoint."""
    path, taken = root / name, []
    while path.is_file() or (path.is_dir() and any(path.iterdir())):
        taken.append(path)
        path = root / f"{name}-{len(taken) + 1}"
    if not resume:
        return path
    unfinished = [p for p in taken if RunFolder(p).checkpoints]
    return unfinished[-1] if unfinished else root / name


def write_json(path: Path, value: Mapping[str, Any]) -> None:
    """Writes JSON, with null for the numbers that JSON does not have; raises `OutputError`."""
    text = json.dumps(finite(value), indent=2, ensure_ascii=False, allow_nan=False) + "\n"
    replace_file(path, lambda file: file.write(text.encode()))


def finite(value: Any) -> Any:
    """Plain JSON values: None in place of the numbers that JSON does not have."""
    if isinstance(value, Mapping):
        return {key: finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [finite(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _refuse_other_run(folder: RunFolder, same: Mapping[str, Any]) -> None:
    found = [name for name in (*RESULTS, CONFIG, CHECKPOINT) if (folder.path / name).exists()]
    if not found:
        return
    arguments = _arguments_of(folder.path / CONFIG)
    if arguments is None:
        raise OutputError(
            f"{folder.path} holds {', '.join(found)} of something else; choose another --out, or --overwrite them"
        )
    differ = [name for name, value in same.items() if arguments.get(name) != value]
    if differ:
        old = ", ".join(f"{name.replace('_', '-')} {arguments.get(name)}" for name in differ)
        raise OutputError(
            f"{folder.path} holds another run ({old}); choose another --out, or --overwrite it,"
            " or --resume it with its own arguments"
        )


def _arguments_of(path: Path) -> dict[str, Any] | None:
    try:
        arguments = json.loads(path.read_text(encoding="utf-8"))["arguments"]
    except (OSError, ValueError, KeyError, TypeError):
        return None
    return arguments if isinstance(arguments, dict) else None


def _remove_empty(created: list[Path]) -> None:
    """Removes folders that were made for nothing, innermost first."""
    for path in created:
        try:
            path.rmdir()
        except OSError:  # not empty, or gone
            return


def _tracks(result: "Imitation") -> "list[Track]":
    """What the video shows: the episode before and, if something was optimised, the one after."""
    from fastmimic.imitation.methods import method_named
    from fastmimic.render.tracks import rollout_track

    def track(rollout: "Rollout", title: str, method: str) -> "Track":
        return rollout_track(rollout, title, note=f"{result.motion.name} · {method_named(method).label}")

    if result.history is not None:  # before it, there was only the method's controller
        return [
            track(result.before, "before: as retargeted", result.method.removesuffix("-dmp")),
            track(result.after, "after: optimised", result.method),
        ]
    as_it_is = "as retargeted" if result.motion.demonstration is None else "as its motions were optimised"
    return [track(result.before, as_it_is, result.method)]


def _tracking_figure(result: "Imitation", title: str) -> Any:
    import numpy as np

    from fastmimic.render.tracks import realised_feet
    from fastmimic.report.figures import tracking_figure

    log = result.after.log
    assert log is not None
    time_s = np.arange(1, log.wanted.shape[1] + 1) / log.rate_hz
    alive_s = max(int(result.before.steps[0]), int(result.after.steps[0])) / log.rate_hz
    starts = result.demonstration.segment_starts
    if len(starts) > 1:  # the first transition
        shown_s = TRANSITION_S
        start = max(0.0, starts[1] / log.rate_hz - 0.5 * shown_s)
    else:
        shown_s = TRACKING_CYCLES * result.demonstration.period_s
        start = max(0.0, min(alive_s, float(time_s[-1])) - shown_s)
    return tracking_figure(
        time_s,
        log.demonstration["foot_pos"][0],
        realised_feet(result.before, result.robot),
        realised_feet(result.after, result.robot),
        log.wanted[0],
        title,
        window_s=(start, start + min(shown_s, float(time_s[-1]))),
    )
