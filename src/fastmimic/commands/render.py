"""`fastmimic render`: a video of a motion."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

from tyro.conf import Positional, arg

from fastmimic.commands.console import count_progress, put, slow_start
from fastmimic.commands.options import MotionOptions, check_duration, check_writable, parse_size
from fastmimic.errors import OutputError

if TYPE_CHECKING:
    from fastmimic.motion.motion import Motion
    from fastmimic.report import Track
    from fastmimic.robot import Robot

SECONDS: Final = 5.0


@dataclass(frozen=True, kw_only=True)
class Render(MotionOptions):
    """Writes a video of a motion under the controller in simulation, with its demonstration as a ghost."""

    motion: Annotated[Positional[str], arg(metavar="MOTION")]
    """A robot motion (.npz), a clip, or a name of 'fastmimic motions'."""
    out: Annotated[Path, arg(metavar="FILE.mp4")]
    """The video."""
    kinematic: bool = False
    """The motion as it is written, without physics."""
    duration: Annotated[float | None, arg(metavar="S")] = None
    """How much of it; by default 5, or the whole of a motion that does not repeat."""
    config: Annotated[str, arg(metavar="default|paper")] = "default"
    """The controller's parameters."""
    size: Annotated[str, arg(metavar="WxH")] = "1280x720"
    """Width and height, pixels, even."""
    slow_motion: Annotated[float, arg(metavar="FACTOR")] = 1.0
    """How many times slower than reality."""

    def run(self) -> int:
        """Writes it; returns the exit status."""
        if self.duration is not None:
            check_duration(self.duration)
        size = parse_size(self.size)
        out = check_writable(self.out, ".mp4")
        from fastmimic.report import render_video

        robot, motion = self.load(self.motion)
        from fastmimic.pipeline import default_duration

        seconds = self.duration if self.duration is not None else default_duration(motion, SECONDS)
        shown = self._kinematic(motion, seconds) if self.kinematic else self._simulated(motion, robot, seconds)
        track, rate_hz = shown
        with count_progress("frame") as progress:
            info = render_video(
                robot,
                [track],
                out,
                rate_hz=rate_hz,
                size=size,
                progress=progress,
                slow_motion=self.slow_motion,
            )
        if info is None:
            raise OutputError(f"{out} was not written: there is no OpenGL to draw with")
        put(f"{info.frames} frames, {info.seconds:.1f} s, in {out}")
        return 0

    def _simulated(self, motion: "Motion", robot: "Robot", seconds: float) -> "tuple[Track, float]":
        from fastmimic.pipeline import evaluate
        from fastmimic.report.tracks import rollout_track

        with slow_start():
            rollout = evaluate(motion, robot, duration_s=seconds, config=self.config, log=True).rollout
        assert rollout.log is not None
        return rollout_track(rollout, f"{motion.name} on {robot.name}"), rollout.log.rate_hz

    def _kinematic(self, motion: "Motion", seconds: float) -> "tuple[Track, float]":
        from fastmimic.report.tracks import motion_track

        ghost = None if motion.demonstration is None else motion_track(motion.demonstration, seconds, "demonstration")
        return motion_track(motion, seconds, f"{motion.name}, no physics", ghost), motion.rate_hz
