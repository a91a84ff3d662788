"""The figures and the video of a run."""

import time
from collections.abc import Callable
from typing import Any, Final

import numpy as np

from fastmimic.episode.rollout import Rollout
from fastmimic.imitation.imitate import Imitation
from fastmimic.imitation.methods import method_named
from fastmimic.render.figure_style import save
from fastmimic.render.tracks import Track, realised_feet, rollout_track
from fastmimic.report.figures import convergence_figure, tracking_figure
from fastmimic.runs.work_folder import CONVERGENCE, TRACKING, VIDEO, RunFolder

TRACKING_CYCLES: Final = 2  # in the tracking figure
TRANSITION_S: Final = 2.0  # length of a stitched motion's tracking figure


def draw_run(result: Imitation, folder: RunFolder) -> None:
    """Writes the figures of a run; raises `OutputError`."""
    title = f"{result.motion.name} on {result.robot.name}"
    h = result.history
    if h is not None and len(h.best):
        iteration = range(1, len(h.best) + 1)
        best = h.best if h.randomized else np.maximum(h.best, h.start)
        figure = convergence_figure(
            list(iteration), best, h.mean, h.std, h.sigma, h.baseline, title, randomized=h.randomized
        )
        save(figure, folder.path / CONVERGENCE)
    save(_tracking_figure(result, title), folder.path / TRACKING)


def write_video(
    result: Imitation,
    folder: RunFolder,
    progress: Callable[[int, int], None] | None = None,
    quality: str = "preview",
) -> bool:
    """Adds the video, and its time to the metrics; False, with a warning in the log, if nothing can draw. `progress` is
    called with (frames done, frames in all); `quality` is one of `fastmimic.render.quality.QUALITIES`. Raises
    `OutputError`."""
    from fastmimic.render.video import render_video

    began = time.perf_counter()
    assert result.before.log is not None
    info = render_video(
        result.robot,
        _tracks(result),
        folder.path / VIDEO,
        rate_hz=result.before.log.rate_hz,
        progress=progress,
        quality=quality,
    )
    if info is not None:
        folder.write_metrics(result.metrics(), time.perf_counter() - began)
    return info is not None


def _tracks(result: Imitation) -> list[Track]:
    """The episodes before and, if something was optimised, after."""

    def track(rollout: Rollout, title: str, method: str) -> Track:
        loaded = result.config.release_force(result.robot)
        return rollout_track(rollout, loaded, title, note=f"{result.motion.name} · {method_named(method).label}")

    if result.history is not None:  # before it, there was only the method's controller
        return [
            track(result.before, "before: as retargeted", method_named(result.method).unoptimised.name),
            track(result.after, "after: optimised", result.method),
        ]
    as_it_is = "as retargeted" if result.motion.demonstration is None else "as its motions were optimised"
    return [track(result.before, as_it_is, result.method)]


def _tracking_figure(result: Imitation, title: str) -> Any:

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
