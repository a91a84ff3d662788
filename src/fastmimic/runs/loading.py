"""Loads a motion from a name, a clip, a robot motion, or the folder of a run."""

import io
import os
from dataclasses import dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from fastmimic.base.errors import ConfigError, MotionError, check_path
from fastmimic.base.files import read_json
from fastmimic.clips.catalogue import motion_names, open_clip
from fastmimic.clips.clip import Clip
from fastmimic.clips.formats.format import is_robot_motion
from fastmimic.motion.motion import Motion
from fastmimic.robot import ROBOT_NAMES, Robot, load_robot
from fastmimic.runs.work_folder import CONFIG, MOTION
from fastmimic.trajectory.solved import Remembered

if TYPE_CHECKING:  # loads the compiler
    from fastmimic.retargeting.report import RetargetReport


@dataclass(frozen=True, eq=False)
class MotionSource:
    """A motion that was named, before its robot is known."""

    name: str  # the given name, or that of the given clip or motion
    motion: Motion | None = None  # the robot motion; None for a clip, which must be retargeted
    clip: Clip | str | Path | None = None  # the clip, its name or its file; None for a robot motion
    folder: Path | None = None

    @property
    def robot(self) -> str | None:
        """The built-in robot of a robot motion, else the robot argument of its run, by name or MJCF file."""
        if self.motion is None:
            return None
        name = self.motion.provenance.robot
        return name if name in ROBOT_NAMES else self.run_arguments().get("robot")

    def run_arguments(self) -> dict[str, Any]:
        """Arguments of the command that wrote the folder, if any; raises `MotionError` for a damaged `config.json`."""
        if self.folder is None:
            return {}
        path = self.folder / CONFIG
        arguments = read_json(path, MotionError).get("arguments", {}) if path.is_file() else {}
        if not isinstance(arguments, dict):
            raise MotionError(f"{path}: not the settings of a run (arguments: {arguments})")
        return arguments

    def open_clip(self, robot: Robot, **overrides: Any) -> Clip:
        """The clip, as `open_clip` reads it; raises `FastMimicError` as that, for a robot motion, and for options of
        reading that a `Clip` is given after it was read."""
        if self.clip is None:
            raise ConfigError(f"{self.name}: already a robot motion; a clip is needed")
        if not isinstance(self.clip, Clip):
            return open_clip(self.clip, robot=robot, **overrides)
        clip, given = self.clip, {name: value for name, value in overrides.items() if value is not None}
        if frames := given.pop("frames", None):
            clip = clip.cut(*frames)
        fields = {"cycle": "is_cycle", "scale": "scale"}
        changed = {field: given.pop(name) for name, field in fields.items() if name in given}
        if given:
            raise ConfigError(f"{', '.join(sorted(given))}: '{self.name}' is already read; give them to open_clip")
        return replace(clip, **changed)

    def retarget(self, robot: Robot, *, executable: bool = True, **overrides: Any) -> "tuple[Motion, RetargetReport]":
        """The clip's motion for a robot, and what changed; raises as `open_clip` and `retarget` do."""
        from fastmimic.episode.loop import share_of_falls  # loads the compiler
        from fastmimic.retargeting.retarget import retarget

        return retarget(self.open_clip(robot, **overrides), robot, executable=executable, falls=share_of_falls)

    def load(self, robot: Robot, **overrides: Any) -> Motion:
        """The motion for a robot; see `load_motion`."""
        given = {k: v for k, v in overrides.items() if v is not None}
        if self.motion is None:
            executable = given.pop("executable", True)
            return _remembered(self.open_clip(robot, **given), robot, executable)
        if given:
            said = f"{', '.join(sorted(given))} cannot be applied to '{self.motion.name}'"
            raise ConfigError(f"{said}: it is already a robot motion")
        self.motion.check_robot(robot.name)
        return self.motion


def _remembered(clip: Clip, robot: Robot, executable: bool) -> Motion:
    """The motion of a clip, retargeted once and then kept in the user's cache folder."""
    body = clip.rate_hz, clip.is_cycle, clip.leg_length_m, clip.scale
    about = repr((version("casadi"), clip.origin, *body, executable, robot.said))
    known = Remembered(about, [a for a in (clip.points_w, clip.root_quat_wxyz) if a is not None], outcome=True)
    if (found := known.read()) is not None:
        return Motion.load(io.BytesIO(found["motion"].tobytes()))
    motion, _ = find_motion(clip).retarget(robot, executable=executable)
    motion.save(content := io.BytesIO())
    known.keep({"motion": np.frombuffer(content.getvalue(), np.uint8)}, packaged=False)
    return motion


def find_motion(source: str | Path | Clip | Motion) -> MotionSource:
    """Finds out the kind of a source, and reads it if it is a robot motion. A name precedes a file or a folder of the
    same name (use ./NAME). Raises `MotionError` for no such source, a folder without a motion, or an unreadable one."""
    if isinstance(source, Motion):
        return MotionSource(source.name, motion=source)
    if isinstance(source, Clip):
        return MotionSource(source.origin.name or "clip", clip=source)
    check_path(source, "a motion's source is its name, a file, the folder of a run, a Clip or a Motion", MotionError)
    name = str(source)
    if not name.strip():
        raise MotionError("a motion without a name; give the name of a motion, a file, or the folder of a run")
    if name in motion_names():
        return MotionSource(name, clip=name)
    if os.path.isdir(source):
        path = Path(source) / MOTION
        if not path.is_file():
            raise MotionError(f"{source}: a folder without {MOTION}; give the folder of a finished run, or a file")
        return MotionSource(name, motion=Motion.load(path), folder=Path(source))
    if is_robot_motion(source):
        return MotionSource(name, motion=Motion.load(source))
    return MotionSource(name, clip=source)


def load_motion(
    source: str | Path | Clip | Motion | MotionSource, robot: Robot | str = "a1", **overrides: Any
) -> Motion:
    """A robot motion from any source.

    Args:
        source: a name of `motion_names()`, a clip file of any known format, a robot motion (`.npz`), the folder of a
            run, a `Clip` or a `Motion`. A clip is retargeted to the robot. A name precedes a file or a folder.
        robot: the robot, its name, or the path of its MJCF.
        overrides: for clips, as in `open_clip` (`fps`, `up`, `point_map`, `travel`, `scale`, `frames`, `cycle`,
            `speed`, `yaw_rate`, `duty`), and `executable` as in `retarget`.

    Raises `FastMimicError` if there is no such source, a file cannot be read, or an override does not apply.
    """
    found = source if isinstance(source, MotionSource) else find_motion(source)
    return found.load(load_robot(robot), **overrides)
