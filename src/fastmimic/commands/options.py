"""Options that several verbs share: groups, each a box in `--help`, and single options as annotated types."""

import dataclasses
import inspect
import math
import re
from collections.abc import Callable
from contextlib import AbstractContextManager, closing, nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final, Literal, TypeVar, dataclass_transform

from tyro.conf import OmitArgPrefixes, UseAppendAction, arg

from fastmimic.base.errors import ConfigError, OutputError
from fastmimic.base.files import check_folder, packaged
from fastmimic.base.progress import count_progress, note
from fastmimic.base.text import plain
from fastmimic.clips.catalogue import parse_frames
from fastmimic.clips.clip import Clip
from fastmimic.control.config import CONFIGS
from fastmimic.imitation.methods import METHODS
from fastmimic.motion.motion import Motion
from fastmimic.render.encoding import QUALITIES
from fastmimic.robot import ROBOT_CHOICES, Robot, load_robot
from fastmimic.runs.loading import MotionSource, find_motion
from fastmimic.simulation.disturbance_kinds import DISTURBANCES
from fastmimic.simulation.simulators import SIMULATORS
from fastmimic.simulation.terrain import TERRAINS

if TYPE_CHECKING:  # loads the compiler
    from fastmimic.episode.loop import MakeController
    from fastmimic.steering.commands import Commands
    from fastmimic.steering.gait_field import GaitField

DEFAULT_ROBOT: Final = "a1"
STEER: Final = "steer"  # in place of a motion: the robot is steered
MAX_DURATION_S: Final = 3600.0
RUNS: Final = Path("runs")
Result = TypeVar("Result")
Kind = TypeVar("Kind")

_TEXTS: Final = packaged("fastmimic.commands", "help.json", dict[str, dict[str, str]])
_NAMES: Final[dict[str, Callable[[], str]]] = {
    "robots": lambda: ROBOT_CHOICES,
    "configs": lambda: ", ".join(CONFIGS),
    "methods": lambda: "; ".join(f"{name}: {m.summary}" for name, m in METHODS.items() if not m.learned),
    "controllers": lambda: ", ".join(name for name, method in METHODS.items() if method.playable),
    "simulators": lambda: ", or ".join(f"{name} ({entry.about})" for name, entry in SIMULATORS.items()),
    "disturbances": lambda: ", ".join(DISTURBANCES),
    "terrains": lambda: ", ".join(TERRAINS),
}  # what stands for {these} in help texts: extensions may add to it


def option(metavar: str | None = None, text: str | Callable[[], str] | None = None) -> Any:
    """An option's placeholder and help text; the text may be a function, which only `--help` calls. Its default is
    shown unless it is None, False or empty: then the text says what happens without the option."""
    help_text: Any = text  # tyro calls functions, but does not declare it
    return arg(metavar=metavar, help=help_text, help_behavior_hint=_shown_default)


def shared(metavar: str | None, name: str) -> Any:
    """An option with one of the texts that stand in `help.json` for several verbs."""
    text = _TEXTS["shared"][name]
    return option(metavar, lambda: text.format(**{name: names() for name, names in _NAMES.items()}))


@dataclass_transform(kw_only_default=True, frozen_default=True)
def command(kind: type[Kind]) -> type[Kind]:
    """A class decorator of verbs and groups of options: a frozen dataclass whose fields, by keyword, are options. Their
    help texts, and more about a verb, are those of `help.json` by class and field; all of it is in the docstring."""
    details, texts = _TEXTS["details"].get(kind.__name__), _TEXTS.get(kind.__name__, {})
    lines = "".join(f"\n        {name}: {text}" for name, text in texts.items())
    parts = (kind.__doc__, details, f"Attributes:{lines}\n    " if texts else None)
    kind.__doc__ = "\n\n    ".join(filter(None, parts))
    return dataclass(frozen=True, kw_only=True)(kind)


def _shown_default(default: str) -> str:
    return "" if default in ("None", "False", "") else f"(default: {default})"


def joined(given: tuple[tuple[str, ...], ...]) -> tuple[str, ...]:
    """All values of an option of the kind `Several`, in their order."""
    return tuple(value for values in given for value in values)


Flag = Annotated[bool, option()]
Generations = Annotated[int | None, option("N")]
Several = UseAppendAction[tuple[tuple[str, ...], ...]]
"""Values of an option that may be given several times, with one or more values each."""
Seconds = Annotated[float | None, option("S")]
RobotChoice = Annotated[str | None, shared("NAME|FILE", "found robot")]
RobotName = Annotated[str, shared("NAME|FILE", "robot")]
MethodName = Annotated[str, shared("NAME", "method")]
ConfigName = Annotated[str, shared("NAME|FILE", "config")]
FoundMethod = Annotated[str | None, shared("NAME", "found method")]
FoundConfig = Annotated[str | None, shared("NAME|FILE", "found config")]
PolicyFile = Annotated[Path | None, shared("FILE", "policy")]
Simulator = Annotated[str, shared("NAME", "simulator")]
Observation = Annotated[str, shared("truth|sensors", "observe")]
FootForce = Annotated[Literal["auto", "off", "on"], shared("auto|off|on", "foot force")]
Disturbances = Annotated[Several, shared("NAME=VALUE ...", "disturb")]
TerrainName = Annotated[str | None, shared("NAME=LEVEL|FILE", "terrain")]
Ideal = Annotated[bool, shared(None, "ideal")]
Quality = Annotated[str, shared("preview|high", "quality")]
Workers = Annotated[int | None, shared("N", "workers")]
Port = Annotated[int, shared("PORT", "port")]
JsonFlag = Annotated[bool, shared(None, "json")]


@command
class ClipFileOptions:
    """How a clip file is read."""

    fps: Annotated[float | None, option("HZ")] = None
    up: Annotated[str | None, option("x|y|z|-x|-y|-z")] = None
    point_map: Annotated[Path | None, option("FILE.json")] = None
    travel: Annotated[str | None, option("auto|recover|as-is")] = None

    def overrides(self) -> dict[str, Any]:
        """The options that were given, as the Python functions take them."""
        found = {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}
        return {name: value for name, value in found.items() if value is not None}

    def words(self) -> str:
        """The options that were given, as they are written on a command line."""
        return "".join(f" --{name.replace('_', '-')}={value}" for name, value in self.overrides().items())


@command
class ClipOptions(ClipFileOptions):
    """How a clip is read and retargeted. None of these applies to a robot motion."""

    frames: Annotated[str | None, option("A:B")] = None
    cycle: Flag = False
    discrete: Flag = False
    scale: Annotated[float | None, option("FACTOR")] = None
    speed: Annotated[float | None, option("M/S")] = None
    yaw_rate: Annotated[float | None, option("RAD/S")] = None
    duty: Annotated[float | None, option("SHARE")] = None
    no_executable: Flag = False

    def overrides(self) -> dict[str, Any]:
        """The options that were given, as the Python functions take them."""
        if self.cycle and self.discrete:
            raise ConfigError("a clip either repeats (--cycle) or is run once (--discrete): drop one of the two")
        found = super().overrides()
        if self.frames is not None:
            found["frames"] = parse_frames(self.frames, "--frames")
        cycle, once = found.pop("cycle"), found.pop("discrete")
        if cycle or once:
            found["cycle"] = cycle
        if found.pop("no_executable"):
            found["executable"] = False
        return found

    def load(self, source: str, robot: str | None) -> tuple[Robot, Motion]:
        """The robot and its motion, retargeted if `source` is a clip."""
        overrides = self.overrides()
        found = find_motion(source)
        body = choose_robot(robot, found)
        return body, found.load(body, **overrides)

    def animal(self, source: str, robot: Robot) -> Clip | None:
        """The clip that `source` is; None for a robot motion."""
        found, overrides = find_motion(source), self.overrides()
        overrides.pop("executable", None)
        return None if found.clip is None else found.open_clip(robot, **overrides)


@command
class SearchOptions:
    """The search of methods that optimise (CMA-ES)."""

    iterations: Generations = None
    population: int = 10


@command
class FolderOptions:
    """What happens if the folder already holds results."""

    resume: Flag = False
    overwrite: Flag = False


@command
class VideoOptions:
    """The video of the result."""

    no_video: Flag = False
    quality: Quality = "preview"

    @property
    def wanted(self) -> str | None:
        """The quality; None for no video. Raises `ConfigError` for an unknown quality."""
        _ = QUALITIES[self.quality]
        return None if self.no_video else self.quality


FileReading = Annotated[ClipFileOptions, OmitArgPrefixes]
ClipReading = Annotated[ClipOptions, OmitArgPrefixes]
Searching = Annotated[SearchOptions, OmitArgPrefixes]
Folder = Annotated[FolderOptions, OmitArgPrefixes]
Video = Annotated[VideoOptions, OmitArgPrefixes]


def recorded(command: Any) -> dict[str, Any]:
    """A verb's arguments for `config.json`, flat."""
    found: dict[str, Any] = {}
    for field in dataclasses.fields(command):
        value = getattr(command, field.name)
        if dataclasses.is_dataclass(value):
            found |= recorded(value)
        else:
            found[field.name] = plain(value)
    return found


def apply(function: Callable[..., Result], *groups: Any, **others: Any) -> Result:
    """Calls a function, or makes settings, with what groups have under its parameters' names, and with `others`."""
    names = inspect.signature(function).parameters
    found = {name: value for group in groups for name, value in vars(group).items() if name in names}
    return function(**found | others)


def choose_robot(robot: str | None, *sources: MotionSource) -> Robot:
    """The robot that was asked for, else the first that a source names, else the default one."""
    return load_robot(robot_name(robot, *sources))


@command
class SteeredBy:
    """With "steer" in place of a motion."""

    gait: Annotated[tuple[str, ...], option("CLIP ...")] = ()
    udp: Annotated[int | None, option("PORT")] = None
    topic: Annotated[str | None, option("NAME")] = None
    commands: Annotated[Path | None, option("FILE.csv")] = None

    def opened(
        self, interface: str | None = None, domain: int | None = None
    ) -> "AbstractContextManager[Commands | None]":
        """Where the velocities come from, if from elsewhere; a topic by a network interface and in a DDS domain, those
        of this computer's ROS 2 if None."""
        from fastmimic.steering.commands import CommandScript, CommandSocket

        if self.udp is not None:
            return closing(CommandSocket(self.udp))
        if self.topic is not None:
            from fastmimic.deploy.dds.ros import CommandTopic

            return closing(CommandTopic(self.topic, interface, domain))
        return nullcontext(None if self.commands is None else CommandScript(self.commands))

    def gaits(self, robot: str | None) -> "GaitField":
        """The gaits of a robot, by name or file; says how far it is when they are made."""
        from fastmimic.steering.gait_field import gait_field, gaits_of

        name = robot or DEFAULT_ROBOT
        clips = gaits_of([find_motion(gait).open_clip(load_robot(name)) for gait in self.gait], note)
        with count_progress("velocities made executable, once for this robot:") as progress:
            return gait_field(name, clips, progress, workers=None)

    def check(self, steers: bool, others_steer: bool = True) -> None:
        """Raises `ConfigError` for options that nothing is steered by, or for too many or too few that say how."""
        sources = given(self, "udp", "topic", "commands")
        if not steers and (unused := given(self)):
            raise ConfigError(f"{unused[0]} steers a robot; give '{STEER}' in place of a motion")
        if steers and len(sources) != 1 and (sources or not others_steer):
            raise ConfigError("velocities come from --udp PORT, --topic NAME or --commands FILE.csv: give one of them")


def robot_name(robot: str | None, *sources: MotionSource) -> str:
    """Name or file of `choose_robot`."""
    return robot or next((source.robot for source in sources if source.robot is not None), DEFAULT_ROBOT)


def given(options: Any, *names: str) -> list[str]:
    """The options, all or those of these names, that differ from their defaults, as they are written: `--dry-run`."""
    fields = [field for field in dataclasses.fields(options) if not names or field.name in names]
    return [f"--{f.name.replace('_', '-')}" for f in fields if getattr(options, f.name) != f.default]


def check_kinematic(command: Any, *names: str) -> None:
    """Raises `ConfigError` for options of these names beside `--kinematic`: they are the controller's."""
    if command.kinematic and (found := given(command, *names)):
        raise ConfigError(f"{', '.join(found)} cannot be applied with --kinematic: there is no controller")


def folder_name(*parts: str | int) -> str:
    """The default name of a run's folder."""
    return re.sub(r"[^\w.+-]+", "-", "-".join(str(part) for part in parts))


def policy_controller(path: Path, robot: Robot, motion: Motion) -> "MakeController":
    """The controllers of a policy's file, checked against robot and motion; raises `PolicyError`, naming the file."""
    from fastmimic.learning.policy import controlled_by, policy_for

    return controlled_by(policy_for(path, robot, motion))


def check_duration(seconds: float | None) -> None:
    """Raises `ConfigError` if no episode can be that long."""
    if seconds is not None and not (math.isfinite(seconds) and 0 < seconds <= MAX_DURATION_S):
        raise ConfigError(f"--duration must be above 0 and at most {MAX_DURATION_S:g} s, found {seconds:g}")


def check_writable(path: str | Path, *endings: str) -> Path:
    """The path, if a file of these endings can be written there, to know before long work; raises `OutputError`."""
    path = Path(path)
    if path.suffix.lower() not in endings:
        raise OutputError(f"{path}: the file's name must end in {' or '.join(endings)}")
    if path.is_dir():
        raise OutputError(f"{path}: is a folder; give the name of a file")
    check_folder(path.parent)
    return path
