"""The options that several verbs share: which robot, and how a clip is read."""

import math
import re
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

from tyro.conf import arg

from fastmimic.base.errors import ConfigError, OutputError, PolicyError
from fastmimic.motion.motion import Motion
from fastmimic.robot import ROBOT_CHOICES, Robot, load_robot

if TYPE_CHECKING:
    from fastmimic.episode.rollout import MakeController
    from fastmimic.experiments.subject import Search
    from fastmimic.optimize.randomization import Randomization
    from fastmimic.runs.loading import MotionSource

DEFAULT_ROBOT: Final = "a1"
MAX_DURATION_S: Final = 3600.0


@dataclass(frozen=True, kw_only=True)
class MotionOptions:
    """Which robot, and how a clip is read. All but the robot apply to clips only."""

    robot: Annotated[
        str | None, arg(metavar="NAME|FILE.xml", help=f"{ROBOT_CHOICES}; by default the robot motion's own, or a1.")
    ] = None
    frames: Annotated[str | None, arg(metavar="A:B")] = None
    """Part of a clip: first frame and end, 0-based, end exclusive."""
    discrete: bool = False
    """Take the clip for a movement that does not repeat, such as a turn, a start or a stop: it is done once. By default
    a clip whose end does not lead back to its beginning."""
    fps: Annotated[float | None, arg(metavar="HZ")] = None
    """Frames a second of a clip file, in place of what it says."""
    up: Annotated[str | None, arg(metavar="y|z")] = None
    """Vertical axis of a clip file, in place of what its points show."""
    point_map: Annotated[Path | None, arg(metavar="FILE.json")] = None
    """Which of a BVH's joints, or of a table's points by name, neck, pelvis, hips and toes are."""
    scale: Annotated[float | None, arg(metavar="FACTOR")] = None
    """From the animal's size to the robot's, in place of the ratio of leg lengths."""
    speed: Annotated[float | None, arg(metavar="M/S")] = None
    """Of a built-in gait, at the A1's size."""
    yaw_rate: Annotated[float | None, arg(metavar="RAD/S")] = None
    """Of a built-in gait, positive to the left."""
    duty: Annotated[float | None, arg(metavar="SHARE")] = None
    """Of a built-in gait: share of the period that a foot stands."""

    def overrides(self) -> dict[str, Any]:
        """The clip's options that were given, as the API takes them."""
        found = {
            "frames": None if self.frames is None else parse_frames(self.frames),
            "discrete": self.discrete or None,
            "fps": self.fps,
            "up": self.up,
            "point_map": self.point_map,
            "scale": self.scale,
            "speed": self.speed,
            "yaw_rate": self.yaw_rate,
            "duty": self.duty,
        }
        return {name: value for name, value in found.items() if value is not None}

    def load(self, source: str) -> tuple[Robot, Motion]:
        """The robot and its motion, retargeted if `source` is a clip."""
        from fastmimic.runs.loading import find_motion

        overrides = self.overrides()
        found = find_motion(source)
        robot = self.load_robot(found)
        return robot, found.load(robot, **overrides)

    def load_robot(self, source: "MotionSource") -> Robot:
        """The robot that was asked for, else the one that the source is for."""
        return load_robot(self.robot or source.robot or DEFAULT_ROBOT)


@dataclass(frozen=True, kw_only=True)
class RandomizeOptions:
    """Over which robots a search scores its candidates."""

    randomize: Annotated[tuple[str, ...] | None, arg(metavar="[N]")] = None
    """Score each candidate over N robots (by default 4): the robot as it is, and others that all candidates of an
    iteration meet. The search takes N times as long."""
    randomize_over: Annotated[tuple[str, ...], arg(metavar="NAME[=LOWER:UPPER] ...")] = ()
    """In what they differ, such as friction payload=0:3; by default ground, load and motors."""
    criterion: Annotated[str | None, arg(metavar="mean|worst")] = None
    """What their scores are worth together; by default the mean."""

    def randomization(self) -> "Randomization | None":
        """What was asked for; raises `ConfigError`."""
        if self.randomize is None:
            for name, given in (("randomize-over", self.randomize_over), ("criterion", self.criterion)):
                if given:
                    raise ConfigError(f"--{name} is of the robots of a randomised search; add --randomize")
            return None
        from fastmimic.optimize.randomization import Randomization

        number = " ".join(self.randomize)
        if not re.fullmatch(r"\d*", number):
            raise ConfigError(f"--randomize takes one number of robots, or none for 4; found '{number}'")
        options: dict[str, Any] = {"robots": int(number)} if number else {}
        if self.randomize_over:
            options["over"] = self.randomize_over
        if self.criterion is not None:
            options["criterion"] = self.criterion
        return Randomization(**options)

    def recorded(self, arguments: dict[str, Any]) -> dict[str, Any]:
        """A verb's arguments for `config.json`: these three as one, with what they stand for; None without them."""
        for name in ("randomize", "randomize_over", "criterion"):
            arguments.pop(name)
        chosen = self.randomization()
        return arguments | {"randomize": None if chosen is None else chosen.as_dict()}


@dataclass(frozen=True, kw_only=True)
class ExperimentOptions(MotionOptions):
    """What experiments over methods share: the search of those that optimise, and going on with a folder."""

    seed: int = 0
    """Of the episodes' starts, the sensors' errors, uneven ground, and CMA-ES."""
    config: Annotated[str, arg(metavar="default|robust|paper|FILE")] = "default"
    """The controller's parameters."""
    policy: Annotated[Path | None, arg(metavar="FILE")] = None
    """A trained policy of the motion, for the method rl."""
    iterations: int = 200
    """Generations of CMA-ES where a method optimises."""
    population: int = 10
    """Candidates in each."""
    resume: bool = False
    """Keep what is finished in the folder, do what is not."""
    overwrite: bool = False
    """Replace what is finished in the folder."""

    def search(self) -> "Search":
        """What methods that optimise do first."""
        from fastmimic.experiments.subject import Search

        return Search(self.config, self.iterations, self.population, self.seed)


def parse_frames(text: str) -> tuple[int, int]:
    """(first, end) from `A:B`; raises `ConfigError`."""
    found = re.fullmatch(r"\s*(\d+)\s*:\s*(\d+)\s*", text)
    if found is None:
        raise ConfigError(f"--frames takes FIRST:END, 0-based, end exclusive, such as 162:201; found '{text}'")
    return int(found[1]), int(found[2])


def parse_size(text: str) -> tuple[int, int]:
    """(width, height) from `WxH`; raises `ConfigError`."""
    found = re.fullmatch(r"(\d{2,4})[x×](\d{2,4})", text.strip())
    if found is None:
        raise ConfigError(f"--size takes WIDTHxHEIGHT in pixels, such as 1280x720; found '{text}'")
    return int(found[1]), int(found[2])


def policy_controller(path: Path, robot: Robot, motion: Motion) -> "MakeController":
    """The controllers of the policy in a file, checked against robot and motion.

    Raises:
        PolicyError: it cannot be read, or is for another robot or motion; the message names the file.
    """
    from fastmimic.learning.controller import controlled_by
    from fastmimic.learning.policy import Policy

    policy = Policy.load(path)
    try:
        policy.check(robot, motion)
    except PolicyError as error:
        raise PolicyError(f"{path}: {error}") from None
    return controlled_by(policy)


def policy_with_digest(path: Path, robot: Robot, motion: Motion) -> "tuple[MakeController, str]":
    """As `policy_controller`, with what tells the file's content from another's.

    Raises:
        PolicyError: as `policy_controller`.
    """
    import hashlib

    controller = policy_controller(path, robot, motion)
    return controller, hashlib.sha256(path.read_bytes()).hexdigest()


def check_duration(seconds: float) -> float:
    """The duration; raises `ConfigError` if no episode can be that long."""
    if not (math.isfinite(seconds) and 0 < seconds <= MAX_DURATION_S):
        raise ConfigError(f"--duration must be above 0 and at most {MAX_DURATION_S:g} s, found {seconds:g}")
    return seconds


def check_writable(path: str | Path, *endings: str) -> Path:
    """The path, once it is certain that a file can be written there: before the work, not after it.

    Raises:
        OutputError: another ending than these, a folder, or a place that cannot be written to.
    """
    from fastmimic.base.files import check_folder

    path = Path(path)
    if path.suffix.lower() not in endings:
        raise OutputError(f"{path}: the file's name must end in {' or '.join(endings)}")
    if path.is_dir():
        raise OutputError(f"{path}: is a folder; give the name of a file")
    check_folder(path.parent)
    return path
