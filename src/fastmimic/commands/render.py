"""`fastmimic render`: writes a video of one motion, or of several side by side."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

from tyro.conf import Positional

from fastmimic.base.errors import ConfigError, OutputError
from fastmimic.commands import options as opt
from fastmimic.commands.console import count_progress, put, slow_start
from fastmimic.motion.motion import Motion
from fastmimic.robot import Robot

if TYPE_CHECKING:
    from fastmimic.render.tracks import Track

SECONDS: Final = 5.0
MOST: Final = 4


@dataclass(frozen=True, kw_only=True)
class Render:
    """Writes a video of a motion under the controller in simulation, with its demonstration as a ghost. Two motions are
    shown side by side, three or four in a 2 x 2 grid.
    """

    motions: Annotated[Positional[tuple[str, ...]], opt.option("MOTION [MOTION ...]")]
    """One to four robot motions (.npz), folders of runs, clips, or names from 'fastmimic motions'."""
    out: Annotated[Path, opt.option("FILE.mp4|.gif|.webm")]
    """File of the video."""
    quality: opt.Quality = "preview"
    kinematic: opt.Flag = False
    """Show the motions as written, without physics."""
    duration: opt.Seconds = None
    """Length. Default: 5 s, or the whole of a non-periodic motion."""
    robot: opt.RobotChoice = None
    method: Annotated[
        tuple[str, ...],
        opt.option(
            "NAME [NAME ...]",
            lambda: (
                f"Controller: {opt.controllers()}; one for all motions, or one for each. Default: the one the "
                "motion was optimised with, else mbc."
            ),
        ),
    ] = ()
    config: opt.FoundConfig = None
    size: Annotated[str | None, opt.option("WxH")] = None
    """Width and height in pixels. Default: 800x450; 1280x720 for high quality; 640x360 for a GIF."""
    frame_rate: Annotated[float | None, opt.option("HZ")] = None
    """Frames per second of the video. Default: 30; 20 for a GIF."""
    slow_motion: Annotated[float, opt.option("FACTOR")] = 1.0
    """Slow the video down by this factor."""
    no_marks: opt.Flag = False
    """Omit the trails of the feet and the discs under loaded feet."""
    clip: opt.ClipReading

    def run(self) -> int:
        """Writes the video; returns the exit status."""
        self._check()
        size = None if self.size is None else opt.parse_size(self.size)
        from fastmimic.render.encoding import ENDINGS
        from fastmimic.render.video import render_video

        out = opt.check_writable(self.out, *ENDINGS)
        robot, shown = self._tracks()
        rates = sorted({rate for _, rate in shown})
        if len(rates) > 1:
            raise ConfigError(f"motions of {' and '.join(f'{r:g}' for r in rates)} Hz cannot be shown together")
        with count_progress("frame") as progress:
            info = render_video(
                robot,
                [track for track, _ in shown],
                out,
                rate_hz=rates[0],
                fps=self.frame_rate,
                size=size,
                quality=self.quality,
                progress=progress,
                slow_motion=self.slow_motion,
                marks=not self.no_marks,
            )
        if info is None:
            raise OutputError(
                f"{out} was not written: there is no OpenGL to draw with; 'fastmimic view' shows the same in a browser"
                " without OpenGL"
            )
        put(f"{info.frames} frames, {info.seconds:.1f} s, {out.stat().st_size / 1e6:.1f} MB, in {out}")
        return 0

    def _check(self) -> None:
        """Raises `ConfigError` for options that cannot be used, before any long work."""
        from fastmimic.imitation.methods import method_named
        from fastmimic.render.quality import quality_named

        if not 1 <= len(self.motions) <= MOST:
            raise ConfigError(f"render takes one to {MOST} motions, found {len(self.motions)}")
        opt.check_duration(self.duration)
        quality_named(self.quality)
        for name, value in (("--frame-rate", self.frame_rate), ("--slow-motion", self.slow_motion)):
            if value is not None and not (math.isfinite(value) and value > 0):
                raise ConfigError(f"{name} must be positive, found {value:g}")
        if len(self.method) not in (0, 1, len(self.motions)):
            raise ConfigError(
                f"--method takes one name, or one for each of the {len(self.motions)} motions; found {len(self.method)}"
            )
        for name in self.method:
            method_named(name)
        given = [f"--{name}" for name, value in (("method", self.method), ("config", self.config)) if value]
        if self.kinematic and given:
            raise ConfigError(f"{', '.join(given)} cannot be applied with --kinematic: there is no controller")

    def _tracks(self) -> "tuple[Robot, list[tuple[Track, float]]]":
        """The robot, and a panel with its rate for each motion."""
        from fastmimic.episode.plan import default_duration
        from fastmimic.runs.loading import find_motion

        sources = [find_motion(source) for source in self.motions]
        robot = opt.choose_robot(sources[0], self.robot)
        overrides = self.clip.overrides()
        motions = [source.load(robot, **overrides) for source in sources]
        methods: Sequence[str | None] = self.method if len(self.method) == len(motions) else ()
        methods = methods or [self.method[0] if self.method else None] * len(motions)
        shown = []
        for motion, method in zip(motions, methods, strict=True):
            seconds = self.duration if self.duration is not None else default_duration(motion, SECONDS)
            shown.append(
                self._kinematic(motion, robot, seconds)
                if self.kinematic
                else self._simulated(motion, robot, seconds, method)
            )
        return robot, shown

    def _simulated(self, motion: Motion, robot: Robot, seconds: float, method: str | None) -> "tuple[Track, float]":
        from fastmimic.imitation.evaluate import evaluate
        from fastmimic.imitation.methods import METHODS
        from fastmimic.render.tracks import rollout_track

        with slow_start():
            found = evaluate(motion, robot, duration_s=seconds, method=method, config=self.config, log=True)
        assert found.rollout.log is not None
        note = METHODS[found.method].label + (f" ({found.config.name})" if found.config.name != "default" else "")
        track = rollout_track(
            found.rollout, found.config.release_force(robot), f"{motion.name} on {robot.name}", note=note
        )
        return track, found.rollout.log.rate_hz

    def _kinematic(self, motion: Motion, robot: Robot, seconds: float) -> "tuple[Track, float]":
        from fastmimic.render.tracks import motion_track

        ghost = None if motion.demonstration is None else motion_track(motion.demonstration, seconds, "demonstration")
        caption = "as optimised, no physics" if ghost is not None else "as retargeted, no physics"
        return motion_track(motion, seconds, f"{motion.name} on {robot.name}", ghost, caption), motion.rate_hz
