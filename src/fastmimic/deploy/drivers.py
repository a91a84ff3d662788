"""Drivers by name."""

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from typing import Any, Final

from fastmimic.base.errors import ConfigError, did_you_mean
from fastmimic.deploy.driver import RobotDriver
from fastmimic.robot import Robot

SIM: Final = "sim"


@dataclass(frozen=True)
class Wired:
    """A driver of a robot on a wire.

    Attributes:
        robot: the built-in robot that it drives.
        module, name: where its class is.
        options: names of the options that it takes.
    """

    robot: str
    module: str
    name: str
    options: tuple[str, ...]


WIRED: Final = {
    "go2": Wired("go2", "fastmimic.deploy.go2.driver", "Go2Driver", ("interface", "domain")),
    "a1": Wired("a1", "fastmimic.deploy.a1.driver", "A1Driver", ()),
}
DRIVERS: Final = (*WIRED, SIM)


def check_driver(name: str) -> None:
    """Raises `ConfigError` for what is not one of `DRIVERS`."""
    if name not in DRIVERS:
        raise ConfigError(f"unknown driver '{name}'; there are {', '.join(DRIVERS)}{did_you_mean(name, DRIVERS)}")


def robot_driven(driver: str) -> str | None:
    """The built-in robot that a driver is for; None for one that drives any."""
    return WIRED[driver].robot if driver in WIRED else None


def make_driver(
    driver: str, robot: Robot, *, touch: bool = True, say: Callable[[str], None], **options: Any
) -> RobotDriver:
    """A driver on a wire, not yet open.

    Args:
        driver: one of `WIRED`.
        robot: which it is expected to be.
        touch: whether opening may have the robot's own programs let go of the motors.
        say: is told what happens while it opens.
        options: those of its own that were given.

    Raises:
        ConfigError: an option that it does not have.
        DriverError: something that it needs is not installed.
    """
    wired = WIRED[driver]
    unknown = next((name for name in options if name not in wired.options), None)
    if unknown is not None:
        known = f"; it has {', '.join(f'--{name}' for name in wired.options)}" if wired.options else ""
        raise ConfigError(f"driver '{driver}' has no --{unknown}{known}")
    made: RobotDriver = getattr(import_module(wired.module), wired.name)(robot, release=touch, say=say, **options)
    return made
