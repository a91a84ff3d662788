"""`fastmimic view`: shows a motion, or a run before and after, in the browser."""

import dataclasses
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

from tyro.conf import Positional

from fastmimic.base.errors import ConfigError, MotionError
from fastmimic.commands import options as opt
from fastmimic.commands.console import slow_start
from fastmimic.commands.serving import serve
from fastmimic.motion.motion import Motion
from fastmimic.robot import Robot

if TYPE_CHECKING:  # loads the compiler
    from fastmimic.render.animal import Animal
    from fastmimic.runs.loading import MotionSource
    from fastmimic.viewer.take import Take


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
        """Serves until Ctrl-C; returns the exit status."""
        opt.check_duration(self.duration)
        self._check_combination()
        from fastmimic.runs.loading import find_motion
        from fastmimic.viewer.viewer import Viewer
        from fastmimic.viewer.web import free_port, require_viser

        require_viser()
        free_port(self.port)  # before anything is simulated
        source = find_motion(self.motion)
        command = self if source.folder is None else self._of_run(source)
        robot, shown, heading, animal = command._prepare(source)
        with Viewer(robot, shown, heading, self.port, animal) as viewer:
            return serve(viewer, heading, self.port)

    def _check_combination(self) -> None:
        if self.kinematic:
            given = {"episodes": self.episodes, "method": self.method, "config": self.config}
            found = [f"--{name}" for name, value in given.items() if value is not None]
            if found:
                raise ConfigError(f"{', '.join(found)} cannot be applied with --kinematic: there is no controller")

    def _of_run(self, source: "MotionSource") -> "View":
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

    def _prepare(self, source: "MotionSource") -> "tuple[Robot, list[list[Take]], str, Animal | None]":
        """The robot, its takes, the heading, and the animal."""
        from fastmimic.episode.plan import default_duration
        from fastmimic.imitation.evaluate import EVALUATION_S
        from fastmimic.render.animal import Animal
        from fastmimic.runs.loading import find_motion

        overrides = self.reading.overrides()
        robot = opt.choose_robot(source, self.robot)
        clip = None
        if self.clip is not None:
            given = find_motion(self.clip)
            if given.motion is not None:
                raise ConfigError(f"--clip takes an animal's clip; {self.clip} is already a robot motion")
            clip = given.open_clip(robot, **(overrides if source.motion is not None else {}))
        if source.motion is not None:
            motion = source.load(robot, **({} if clip is not None else overrides))
        else:
            original = source.open_clip(robot, **overrides)
            motion = find_motion(original).load(robot)
            clip = clip if clip is not None else original
        seconds = self.duration if self.duration is not None else default_duration(motion, EVALUATION_S)
        both = source.folder is not None and motion.demonstration is not None
        motions = (
            [(motion.target, "before: as retargeted"), (motion, "after: optimised")]
            if both
            else [(motion, motion.name)]
        )
        shown = [self._takes(each, motion, robot, seconds, title) for each, title in motions]
        animal = Animal(clip, robot, motion) if clip is not None else None
        return robot, shown, f"{motion.name} on {robot.name}", animal

    def _takes(self, motion: Motion, of: Motion, robot: Robot, seconds: float, title: str) -> "list[Take]":
        """The episodes of one motion under the controller of the motion `of`."""
        from fastmimic.imitation.evaluate import evaluate
        from fastmimic.imitation.methods import controller_for
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
