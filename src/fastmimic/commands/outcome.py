"""What `imitate` and `stitch` say of their result, and what they write of it."""

from typing import TYPE_CHECKING

from fastmimic.commands.console import EXIT_INTERRUPTED, count_progress, note, put
from fastmimic.motion.motion import Motion
from fastmimic.robot import Robot

if TYPE_CHECKING:
    from fastmimic.imitation.imitate import Imitation
    from fastmimic.report.run_folder import RunFolder


def about(robot: Robot, motion: Motion) -> list[str]:
    """What a motion is, and what was assumed, before the work begins."""
    from fastmimic.commands.provenance import assumed, provenance, unmet_bounds

    lines = [provenance(motion)]
    lines += [f"assumed: {sentence}" for sentence in (*assumed(motion), *robot.assumed)]
    return lines + [f"retargeting: {sentence}" for sentence in unmet_bounds(motion)]


def report(result: "Imitation", folder: "RunFolder", iterations: int, *, video: str | None) -> int:
    """Prints the figures and adds the video to the folder; returns the exit status.

    Args:
        result: already in the folder but for its video.
        folder: of the run.
        iterations: that were asked for.
        video: its quality; None for no video.
    """
    from fastmimic.commands.comparison import comparison

    for line in comparison(result):
        put(line)
    if video is not None:
        _write_video(result, folder, video)
    put(f"results in {folder.path}")
    if not result.interrupted:
        return 0
    note(
        f"fastmimic: interrupted after {result.iterations} of {iterations} iterations;"
        f" the result is the best so far, and --out {folder.path} --resume goes on"
    )
    return EXIT_INTERRUPTED


def _write_video(result: "Imitation", folder: "RunFolder", quality: str) -> None:
    try:
        with count_progress("video, frame") as progress:
            folder.write_video(result, progress, quality)
    except KeyboardInterrupt:
        note(f"the video was left out; everything else is in {folder.path}")
        raise
