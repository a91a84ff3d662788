"""`fastmimic view`: a motion, or a run before and after, in the browser."""

import dataclasses
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

from tyro.conf import Positional, arg

from fastmimic.base.errors import ConfigError, MotionError
from fastmimic.commands.console import slow_start
from fastmimic.commands.options import MotionOptions, check_duration
from fastmimic.commands.serving import serve
from fastmimic.motion.motion import Motion
from fastmimic.robot import Robot

if TYPE_CHECKING:
    from fastmimic.render.animal import Animal
    from fastmimic.runs.loading import MotionSource
    from fastmimic.viewer.take import Take


@dataclass(frozen=True, kw_only=True)
class View(MotionOptions):
    """Shows a motion under the controller in the browser: the robot, its demonstration as a ghost, contacts, forces
    and reward, to be played and scrubbed. A run's folder shows it before and after the optimisation, side by side.

    The server listens on this machine only (127.0.0.1); Ctrl-C ends it.
    """

    motion: Annotated[Positional[str], arg(metavar="MOTION|RUN")]
    """A robot motion (.npz), a clip, a name of 'fastmimic motions', or the folder of a run."""
    port: Annotated[int, arg(metavar="PORT")] = 8080
    """Where to listen; if it is taken, the next one that is free."""
    kinematic: bool = False
    """The motion as it is written, without physics."""
    clip: Annotated[str | None, arg(metavar="CLIP")] = None
    """The animal to show beside a robot motion: a clip or a name. A clip that is viewed comes with its own."""
    episodes: Annotated[int | None, arg(metavar="N")] = None
    """How many, to choose from: the first from the motion's start, the others perturbed as in 'evaluate'; by default
    1."""
    duration: Annotated[float | None, arg(metavar="S")] = None
    """Length of each; by default 10, the whole of a motion that does not repeat, or the run's."""
    seed: int = 0
    """Of the perturbations."""
    method: Annotated[str | None, arg(metavar="NAME")] = None
    """Whose controller: raibert, mbc, lh; by default the run's, that with which the motion was optimised, or mbc."""
    config: Annotated[str | None, arg(metavar="default|robust|paper|FILE")] = None
    """The controller's parameters; by default the run's, those with which the motion was optimised, or "default"."""

    def run(self) -> int:
        """Serves until Ctrl-C; returns the exit status."""
        if self.duration is not None:
            check_duration(self.duration)
        self._check_combination()
        from fastmimic.runs.loading import find_motion
        from fastmimic.viewer.viewer import Viewer
        from fastmimic.viewer.web import free_port, require_viser

        require_viser()
        free_port(self.port)  # a port that cannot be is no reason to simulate first
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
        """The robot, what is shown of it, the heading, and the animal."""
        from fastmimic.imitation.imitate import EVALUATION_S, default_duration
        from fastmimic.render.animal import Animal
        from fastmimic.runs.loading import find_motion

        overrides = self.overrides()
        robot = self.load_robot(source)
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
        """What one motion is in so many episodes, under the controller of the motion that was given."""
        from fastmimic.imitation.imitate import evaluate
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
