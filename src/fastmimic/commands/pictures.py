"""Motions to look at: `fastmimic render` (videos), `report` (HTML files), `view` and `play` (in the browser)."""

import dataclasses
import sys
import threading
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

from tyro.conf import Positional

from fastmimic.base.configuration import parse_pair
from fastmimic.base.errors import ConfigError, MotionError, OutputError, check_positive
from fastmimic.base.progress import count_progress, note, slow_start
from fastmimic.commands import options as opt
from fastmimic.commands.console import put
from fastmimic.commands.show import check_truth, open_log
from fastmimic.deploy.log import is_deployment_log
from fastmimic.episode.plan import default_duration
from fastmimic.imitation.methods import METHODS, controller_for
from fastmimic.motion.motion import Motion
from fastmimic.render.encoding import ENDINGS, QUALITIES
from fastmimic.robot import Robot
from fastmimic.runs.loading import MotionSource, find_motion
from fastmimic.simulation.conditions import Conditions

if TYPE_CHECKING:  # loads the compiler
    from fastmimic.play.page import PlayPage
    from fastmimic.render.tracks import Animal, Track
    from fastmimic.viewer.take import Take
    from fastmimic.viewer.viewer import Viewer

SECONDS: Final = 5.0
MOST: Final = 4


@opt.command
class Render:
    """Writes a video of a motion under the controller in simulation, with its demonstration as a ghost. Two motions are
    shown side by side, three or four in a 2 x 2 grid."""

    motions: Annotated[Positional[tuple[str, ...]], opt.option("MOTION [MOTION ...]")]
    out: Annotated[Path, opt.option("FILE.mp4|.gif|.webm")]
    quality: opt.Quality = "preview"
    kinematic: opt.Flag = False
    duration: opt.Seconds = None
    robot: opt.RobotChoice = None
    method: Annotated[tuple[str, ...], opt.shared("NAME [NAME ...]", "found methods")] = ()
    config: opt.FoundConfig = None
    terrain: opt.TerrainName = None
    size: Annotated[str | None, opt.option("WxH")] = None
    frame_rate: Annotated[float | None, opt.option("HZ")] = None
    slow_motion: Annotated[float, opt.option("FACTOR")] = 1.0
    no_marks: opt.Flag = False
    clip: opt.ClipReading

    def run(self) -> None:
        self._check()
        takes = "--size takes WIDTHxHEIGHT in pixels, such as 1280x720"
        size = None if self.size is None else parse_pair(self.size, r"(\d{2,4})[x×](\d{2,4})", takes)
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
            said = f"{out} was not written: there is no OpenGL to draw with"
            raise OutputError(f"{said}; 'fastmimic view' shows the same in a browser without OpenGL")
        put(f"{info.frames} frames, {info.seconds:.1f} s, {out.stat().st_size / 1e6:.1f} MB, in {out}")

    def _check(self) -> None:
        """Raises `ConfigError` for options that cannot be used, before any long work."""
        if not 1 <= len(self.motions) <= MOST:
            raise ConfigError(f"render takes one to {MOST} motions, found {len(self.motions)}")
        opt.check_duration(self.duration)
        _ = QUALITIES[self.quality]
        for name, value in (("--frame-rate", self.frame_rate), ("--slow-motion", self.slow_motion)):
            if value is not None:
                check_positive(value, name, shown=f"{value:g}")
        if len(self.method) not in (0, 1, len(self.motions)):
            takes = f"--method takes one name, or one for each of the {len(self.motions)} motions"
            raise ConfigError(f"{takes}; found {len(self.method)}")
        for name in self.method:
            _ = METHODS[name]
        opt.check_kinematic(self, "method", "config", "terrain")

    def _tracks(self) -> "tuple[Robot, list[tuple[Track, float]]]":
        """The robot, and a panel with its rate for each motion."""
        sources = [find_motion(source) for source in self.motions]
        robot = opt.choose_robot(self.robot, sources[0])
        motions = [source.load(robot, **self.clip.overrides()) for source in sources]
        methods: Sequence[str | None] = self.method or [None]
        if len(methods) == 1:
            methods = [methods[0]] * len(motions)
        shown = []
        for motion, method in zip(motions, methods, strict=True):
            seconds = self.duration if self.duration is not None else default_duration(motion, SECONDS)
            if self.kinematic:
                shown.append(_kinematic(motion, robot, seconds))
            else:
                shown.append(self._simulated(motion, robot, seconds, method))
        return robot, shown

    def _simulated(self, motion: Motion, robot: Robot, seconds: float, method: str | None) -> "tuple[Track, float]":
        from fastmimic.imitation.evaluate import evaluate
        from fastmimic.render.tracks import rollout_track

        options: dict[str, Any] = {"duration_s": seconds, "method": method, "config": self.config, "log": True}
        with slow_start():
            found = evaluate(motion, robot, conditions=opt.apply(Conditions, self), **options)
        caption = METHODS[found.method].label + (f" ({found.config.name})" if found.config.name != "default" else "")
        loaded, title = found.config.release_force(robot), f"{motion.name} on {robot.name}"
        return rollout_track(found.rollout, loaded, title, note=caption), found.rollout.course.rate_hz


def _kinematic(motion: Motion, robot: Robot, seconds: float) -> "tuple[Track, float]":
    from fastmimic.render.tracks import motion_track

    ghost = None if motion.demonstration is None else motion_track(motion.demonstration, seconds).pose
    caption = "as optimised, no physics" if ghost is not None else "as retargeted, no physics"
    return motion_track(motion, seconds, f"{motion.name} on {robot.name}", ghost, caption), motion.rate_hz


@opt.command
class WriteReport:
    """Writes report.html into the folder of a run of 'imitate', 'stitch' or 'deploy', or of 'compare', 'stress'
    or 'transfer': one self-contained file with the video, the figures before and after, and pictures of what the robot
    did. A clip, a motion or a name runs first as it is, into a folder of its own: 'imitate --no-optimize'."""

    runs: Annotated[Positional[tuple[str, ...]], opt.option("RUN|MOTION ...")]
    out: Annotated[Path | None, opt.option("FILE.html")] = None
    robot: opt.RobotChoice = None
    reading: opt.ClipReading

    def run(self) -> None:
        if not self.runs:
            raise ConfigError("report takes the folder of at least one run")
        if self.out is not None and len(self.runs) > 1:
            raise ConfigError(f"--out names one file, but {len(self.runs)} runs were given; drop it")
        from fastmimic.report.html import REPORT, kind_of, make_report
        from fastmimic.viewer.replay import recorded

        folders = [Path(run) if Path(run).is_dir() else None for run in self.runs]
        if None not in folders and (self.robot is not None or self.reading.overrides()):
            raise ConfigError("--robot and how a clip is read belong to motions that are not run yet; drop them")
        for run, path in zip(self.runs, folders, strict=True):  # refuses before anything is written
            if path is None:
                self.reading.animal(run, opt.choose_robot(self.robot, find_motion(run)))
            else:
                kind_of(path)
        outs = [opt.check_writable(self.out or (path or Path()) / REPORT, ".html", ".htm") for path in folders]
        for run, found, out in zip(self.runs, folders, outs, strict=True):
            path = found or self._ran(run)
            out = out if found or self.out else path / REPORT
            with slow_start():
                report = make_report(path, recorded)
            for line in report.missing:
                note(f"fastmimic: warning: {line}")
            report.save(out)
            put(f"report in {out}")

    def _ran(self, motion: str) -> Path:
        """The folder of a run of a motion as it is."""
        from fastmimic.commands.imitate import Imitate

        command = Imitate(
            motion=motion,
            robot=self.robot,
            no_optimize=True,
            search=opt.SearchOptions(),
            folder=opt.FolderOptions(),
            video=opt.VideoOptions(),
            clip=self.reading,
        )
        return command.make()[0]


@opt.command
class View:
    """Shows a motion under the controller in the browser: the robot, its demonstration as a ghost, contacts, forces
    and reward, to play and scrub. For the folder of a run: before and after the optimisation, side by side."""

    motion: Annotated[Positional[str], opt.option("MOTION|RUN")]
    truth: Annotated[Path | None, opt.option("FILE")] = None
    port: opt.Port = 8080
    kinematic: opt.Flag = False
    clip: Annotated[str | None, opt.option("CLIP")] = None
    episodes: Annotated[int | None, opt.option("N")] = None
    duration: opt.Seconds = None
    seed: int = 0
    robot: opt.RobotChoice = None
    method: opt.FoundMethod = None
    config: opt.FoundConfig = None
    terrain: opt.TerrainName = None
    reading: opt.ClipReading

    def run(self) -> None:
        opt.check_duration(self.duration)
        opt.check_kinematic(self, "episodes", "method", "config", "terrain")
        from fastmimic.viewer.viewer import Viewer, free_port, require_viser

        require_viser()
        free_port(self.port)  # before anything is simulated
        if is_deployment_log(self.motion):
            robot, shown, heading, animal = self._deployed()
        else:
            check_truth(self.motion, self.truth)
            source = find_motion(self.motion)
            command = self if source.folder is None else self._of_run(source)
            robot, shown, heading, animal = command._prepare(source)
        with Viewer(robot, shown, heading, self.port, animal) as viewer:
            serve(viewer, heading, self.port)

    def _deployed(self) -> "tuple[Robot, list[list[Take]], str, None]":
        from fastmimic.viewer.replay import deployment_take

        robot, log = open_log(self, self.reading, "port", "reading")
        return robot, [[deployment_take(robot, log)]], f"{log.motion.name} on {robot.name}, deployed", None

    def _of_run(self, source: MotionSource) -> "View":
        """The same command with the arguments of the run where nothing was given."""
        arguments = source.run_arguments()
        seconds = arguments.get("duration")
        if seconds is not None and not isinstance(seconds, int | float):
            raise MotionError(f"{source.name}: the duration in config.json is not a number ({seconds!r})")
        return dataclasses.replace(
            self,
            robot=self.robot or arguments.get("robot"),
            method=self.method or (None if self.kinematic else arguments.get("method")),
            config=self.config or (None if self.kinematic else arguments.get("config")),
            duration=self.duration if self.duration is not None else seconds,
        )

    def _prepare(self, source: MotionSource) -> "tuple[Robot, list[list[Take]], str, Animal | None]":
        from fastmimic.imitation.evaluate import EVALUATION_S
        from fastmimic.render.tracks import Animal

        overrides = self.reading.overrides()
        executable = overrides.pop("executable", None)
        robot = opt.choose_robot(self.robot, source)
        clip = None
        if self.clip is not None:
            clip = find_motion(self.clip).open_clip(robot, **(overrides if source.motion is not None else {}))
        if source.motion is not None:
            motion = source.load(robot, **({} if clip is not None else overrides), executable=executable)
        else:
            original = source.open_clip(robot, **overrides)
            motion = find_motion(original).load(robot, executable=executable)
            clip = clip if clip is not None else original
        seconds = self.duration if self.duration is not None else default_duration(motion, EVALUATION_S)
        motions = [(motion, motion.name)]
        if source.folder is not None and motion.demonstration is not None:
            motions = [(motion.target, "before: not optimised"), (motion, "after: optimised")]
        shown = [self._takes(each, motion, robot, seconds, title) for each, title in motions]
        animal = Animal(clip, robot, motion) if clip is not None else None
        return robot, shown, f"{motion.name} on {robot.name}", animal

    def _takes(self, motion: Motion, of: Motion, robot: Robot, seconds: float, title: str) -> "list[Take]":
        """The episodes of one motion under the controller of the motion `of`."""
        from fastmimic.imitation.evaluate import evaluate
        from fastmimic.viewer.take import motion_take, rollout_take

        if self.kinematic:
            return [motion_take(motion, robot, seconds, title)]
        method, config = controller_for(of, self.method, self.config)
        episodes = 1 if self.episodes is None else self.episodes
        with slow_start():
            rollout = evaluate(
                motion,
                robot,
                episodes=episodes,
                duration_s=seconds,
                seed=self.seed,
                method=method.name,
                config=config,
                conditions=opt.apply(Conditions, self),
                log=True,
            ).rollout
        return [rollout_take(rollout, motion, robot, config, title, episode) for episode in range(episodes)]


def serve(page: "Viewer | PlayPage", what: str, port: int) -> None:
    """Serves a page until Ctrl-C; prints its address, and its port if `port` was taken."""
    taken = page.server.get_port()
    if taken != port:
        note(f"port {port} is taken; listening on {taken} instead")
    try:
        put(f"{what}: open {page.url} in a browser; Ctrl-C ends it")
        sys.stdout.flush()
        page.run(threading.Event())
    except KeyboardInterrupt:
        note("closed")
