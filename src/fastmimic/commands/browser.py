"""`fastmimic view` and `fastmimic play`: a motion, or a live simulation, in the browser."""

import dataclasses
import signal
import sys
import threading
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from typing import TYPE_CHECKING, Annotated

from tyro.conf import Positional

from fastmimic.base.errors import ConfigError, MotionError
from fastmimic.commands import options as opt
from fastmimic.commands.console import note, put, slow_start
from fastmimic.control.config import controller_config
from fastmimic.episode.plan import default_duration
from fastmimic.imitation.methods import controller_for
from fastmimic.motion.motion import Motion
from fastmimic.robot import Robot, load_robot
from fastmimic.runs.loading import MotionSource, find_motion
from fastmimic.viewer.web import free_port, require_viser

if TYPE_CHECKING:  # loads the compiler
    from fastmimic.play.page import PlayPage
    from fastmimic.render.tracks import Animal
    from fastmimic.viewer.take import Take
    from fastmimic.viewer.viewer import Viewer


@dataclass(frozen=True, kw_only=True)
class View:
    """Shows a motion under the controller in the browser: the robot, its demonstration as a ghost, contacts, forces
    and reward, to play and scrub. For the folder of a run: before and after the optimisation, side by side.

    The server listens on this machine only (127.0.0.1); Ctrl-C ends it.
    """

    motion: Annotated[Positional[str], opt.option("MOTION|RUN")]
    """A robot motion (.npz), a clip, a name from 'fastmimic motions', or the folder of a run."""
    port: opt.Port = 8080
    kinematic: opt.Flag = False
    """Show the motion as written, without physics."""
    clip: Annotated[str | None, opt.option("CLIP")] = None
    """Animal to show beside a robot motion: a clip or a name. A clip is always shown with its own animal."""
    episodes: Annotated[int | None, opt.option("N")] = None
    """Episodes to choose from. The first starts at the motion's start, the others are perturbed as in 'evaluate'.
    Default: 1."""
    duration: opt.Seconds = None
    """Length of an episode. Default: the run's, else 10 s or the whole of a non-periodic motion."""
    seed: int = 0
    """Seed of the perturbations."""
    robot: opt.RobotChoice = None
    method: opt.FoundMethod = None
    config: opt.FoundConfig = None
    reading: opt.ClipReading

    def run(self) -> int:
        opt.check_duration(self.duration)
        opt.check_kinematic(self, "episodes", "method", "config")
        from fastmimic.viewer.viewer import Viewer

        require_viser()
        free_port(self.port)  # before anything is simulated
        source = find_motion(self.motion)
        command = self if source.folder is None else self._of_run(source)
        robot, shown, heading, animal = command._prepare(source)
        with Viewer(robot, shown, heading, self.port, animal) as viewer:
            return serve(viewer, heading, self.port)

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
        """The robot, its takes, the heading, and the animal."""
        from fastmimic.imitation.evaluate import EVALUATION_S
        from fastmimic.render.tracks import Animal

        overrides = self.reading.overrides()
        executable = {name: overrides.pop(name) for name in ("executable",) if name in overrides}
        robot = opt.choose_robot(self.robot, source)
        clip = None
        if self.clip is not None:
            given = find_motion(self.clip)
            if given.motion is not None:
                raise ConfigError(f"--clip takes an animal's clip; {self.clip} is already a robot motion")
            clip = given.open_clip(robot, **(overrides if source.motion is not None else {}))
        if source.motion is not None:
            motion = source.load(robot, **({} if clip is not None else overrides), **executable)
        else:
            original = source.open_clip(robot, **overrides)
            motion = find_motion(original).load(robot, **executable)
            clip = clip if clip is not None else original
        seconds = self.duration if self.duration is not None else default_duration(motion, EVALUATION_S)
        motions = [(motion, motion.name)]
        if source.folder is not None and motion.demonstration is not None:
            motions = [(motion.target, "before: as retargeted"), (motion, "after: optimised")]
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
                log=True,
            ).rollout
        return [rollout_take(rollout, motion, robot, config, title, episode) for episode in range(episodes)]


@dataclass(frozen=True, kw_only=True)
class Play:
    """Simulates a robot under the controller live in the browser. Switch motions, steer, change speed, yaw rate, swing
    height, friction and payload, and push the robot, by mouse, keyboard or gamepad. A robot that falls gets up again.

    The server listens on this machine only (127.0.0.1); Ctrl-C ends it.
    """

    motions: Annotated[Positional[tuple[str, ...]], opt.option("[MOTION|RUN ...]")] = ()
    """Periodic motions: names from 'fastmimic motions', clips, robot motions (.npz) or folders of runs. Default: the
    built-in gaits. "stand" and "in-place" are always available."""
    robot: opt.RobotChoice = None
    port: opt.Port = 8080
    method: Annotated[str, opt.option("NAME", lambda: f"Controller at the start: {opt.controllers()}.")] = "mbc"
    config: opt.ConfigName = "default"

    def run(self) -> int:
        require_viser()
        free_port(self.port)  # before the motions are loaded
        from fastmimic.play.page import PlayPage
        from fastmimic.play.session import DEFAULTS, LiveSession, check_method, load_motions
        from fastmimic.reference.motion_set import MotionSet, warm_up

        check_method(self.method)
        config = controller_config(self.config)
        sources = [find_motion(source) for source in self.motions or DEFAULTS]
        name = opt.robot_name(self.robot, *sources)
        robot = load_robot(name)
        # transitions take about a second each: another process makes them, so that the simulation keeps real time
        with ProcessPoolExecutor(1, mp_context=get_context("spawn"), initializer=_behind_the_scenes) as executor:
            executor.submit(warm_up, name)  # while this process loads
            with slow_start():
                motions = load_motions(sources, robot)
                library = MotionSet(robot, motions, executor=executor, source=name)
                session = LiveSession(robot, library, method=self.method, config=config)
            try:
                with PlayPage(session, f"{robot.name}, live", self.port) as page:
                    return serve(page, ", ".join(library.names), self.port)
            finally:
                executor.shutdown(wait=False, cancel_futures=True)


def _behind_the_scenes() -> None:
    """Ignores Ctrl-C: the serving process handles it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def serve(page: "Viewer | PlayPage", what: str, port: int) -> int:
    """Serves a page until Ctrl-C; prints its address, and its port if `port` was taken. Returns the exit status."""
    taken = page.server.get_port()
    if taken != port:
        note(f"port {port} is taken; listening on {taken} instead")
    try:
        put(f"{what}: open {page.url} in a browser; Ctrl-C ends it")
        sys.stdout.flush()
        page.run(threading.Event())
    except KeyboardInterrupt:
        note("closed")
    return 0
