"""`fastmimic view`: a motion, or a run before and after, in the browser."""

import dataclasses
import json
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from tyro.conf import Positional, arg

from fastmimic.base.errors import ConfigError, MotionError
from fastmimic.commands.console import slow_start
from fastmimic.commands.options import MotionOptions, check_duration
from fastmimic.commands.serving import serve
from fastmimic.motion.motion import Motion
from fastmimic.robot import Robot

if TYPE_CHECKING:
    from fastmimic.viewer.animal import Animal
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
        from fastmimic.viewer.server import Viewer, free_port, require_viser

        require_viser()
        free_port(self.port)  # a port that cannot be is no reason to simulate first
        run = self._is_run()
        command = self._of_run(Path(self.motion)) if run else self
        robot, shown, heading, animal = command._prepare(run=run)
        with Viewer(robot, shown, heading, self.port, animal) as viewer:
            return serve(viewer, heading, self.port)

    def _check_combination(self) -> None:
        if self.kinematic:
            given = {"episodes": self.episodes, "method": self.method, "config": self.config}
            found = [f"--{name}" for name, value in given.items() if value is not None]
            if found:
                raise ConfigError(f"{', '.join(found)} cannot be applied with --kinematic: there is no controller")

    def _is_run(self) -> bool:
        """Whether the motion is a folder; a name goes before a folder of the same name, as before a file."""
        from fastmimic.clips.catalogue import motion_names

        return Path(self.motion).is_dir() and self.motion not in motion_names()

    def _of_run(self, folder: Path) -> "View":
        """The same command with what the run's folder says where nothing was given."""
        from fastmimic.report.run_folder import CONFIG, MOTION

        if not (folder / MOTION).is_file():
            raise MotionError(f"{folder}: no {MOTION} in this folder; give a finished run, or a motion")
        try:
            arguments: dict[str, Any] = dict(json.loads((folder / CONFIG).read_text(encoding="utf-8"))["arguments"])
        except FileNotFoundError:
            arguments = {}  # a motion in a folder
        except (OSError, ValueError, TypeError, KeyError) as error:
            raise MotionError(
                f"{folder / CONFIG}: not the settings of a run ({type(error).__name__}: {error})"
            ) from None
        seconds = arguments.get("duration")
        if seconds is not None and not isinstance(seconds, int | float):
            raise MotionError(f"{folder / CONFIG}: the duration is not a number ({seconds!r})")
        return dataclasses.replace(
            self,
            motion=str(folder / MOTION),
            robot=self.robot or arguments.get("robot"),
            method=self.method or (None if self.kinematic else arguments.get("method")),
            config=self.config or (None if self.kinematic else arguments.get("config")),
            duration=self.duration if self.duration is not None else seconds,
        )

    def _prepare(self, *, run: bool) -> "tuple[Robot, list[list[Take]], str, Animal | None]":
        """The robot, what is shown of it, the heading, and the animal."""
        from fastmimic.imitation.imitate import EVALUATION_S, default_duration, load_motion
        from fastmimic.viewer.animal import Animal

        overrides = self.overrides()
        robot_motion = _is_robot_motion(self.motion)
        robot = self.load_robot(self.motion)
        clip = None
        if self.clip is not None:
            clip = self._open_clip(self.clip, robot, overrides if robot_motion else {})
        if robot_motion:
            motion = load_motion(self.motion, robot, **({} if clip is not None else overrides))
        else:
            original = self._open_clip(self.motion, robot, overrides)
            motion = load_motion(original, robot)
            clip = clip if clip is not None else original
        seconds = self.duration if self.duration is not None else default_duration(motion, EVALUATION_S)
        both = run and motion.demonstration is not None
        motions = (
            [(motion.target, "before: as retargeted"), (motion, "after: optimised")]
            if both
            else [(motion, motion.name)]
        )
        shown = [self._takes(each, motion, robot, seconds, title) for each, title in motions]
        animal = Animal(clip, robot, motion) if clip is not None else None
        return robot, shown, f"{motion.name} on {robot.name}", animal

    def _open_clip(self, source: str, robot: Robot, overrides: dict[str, Any]) -> Any:
        from fastmimic.clips.catalogue import open_clip

        if _is_robot_motion(source):
            raise ConfigError(f"--clip takes an animal's clip; {source} is already a robot motion")
        return open_clip(source, robot=robot, **overrides)

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


def _is_robot_motion(source: str) -> bool:
    from fastmimic.clips.formats import detect_format

    return Path(source).is_file() and detect_format(source) == "npz"
