"""Robots by name or by file."""

from importlib import resources
from pathlib import Path
from typing import Final

from fastmimic.base.errors import RobotError, did_you_mean
from fastmimic.robot.robot import Robot

ROBOT_NAMES: Final = ("a1", "go1", "go2")  # each is the file NAME.xml beside this one
ROBOT_CHOICES: Final = f"{', '.join(ROBOT_NAMES)}, or the MJCF of your own"  # for help texts


def load_robot(robot: str | Path | Robot) -> Robot:
    """Returns a built-in robot by name or reads the user's own MJCF; a `Robot` is returned unchanged. Raises
    `RobotError`: no such robot or file, not an MJCF, or not a quadruped with abduction, hip and knee joints."""
    import mujoco

    from fastmimic.robot.mjcf import one_line, robot_from_spec

    if isinstance(robot, Robot):
        return robot
    name = str(robot)
    if name.lower() in ROBOT_NAMES:
        text = resources.files("fastmimic.robot").joinpath(f"{name.lower()}.xml").read_text(encoding="utf-8")
        return robot_from_spec(mujoco.MjSpec.from_string(text), name)
    path = Path(robot)
    if not path.exists():
        hint = did_you_mean(name, ROBOT_NAMES)
        raise RobotError(f"unknown robot '{name}': not one of {', '.join(ROBOT_NAMES)} and not a file{hint}")
    if path.is_dir():
        raise RobotError(f"{path}: a folder; expected an MJCF file")
    try:
        spec = mujoco.MjSpec.from_file(str(path))
    except (ValueError, OSError, UnicodeDecodeError) as error:
        raise RobotError(f"{path}: not a readable MJCF ({one_line(error)})") from None
    return robot_from_spec(spec, str(path))
