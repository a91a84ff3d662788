"""Drivers by name."""

from importlib import import_module
from typing import Any, Final

from fastmimic.base.errors import ConfigError, did_you_mean
from fastmimic.deploy.driver import RobotDriver
from fastmimic.robot import Robot

SIM: Final = "sim"
WIRED: Final[dict[str, tuple[str, str, tuple[str, ...]]]] = {
    "go2": ("fastmimic.deploy.go2.driver", "Go2Driver", ("interface", "domain")),
    "a1": ("fastmimic.deploy.a1.driver", "A1Driver", ()),
}
"""Drivers of the built-in robots: module, class, and names of the driver's own options."""
DRIVERS: Final = (*WIRED, SIM)


def check_driver(name: str) -> None:
    """Raises `ConfigError` for an unknown driver."""
    if name not in DRIVERS:
        raise ConfigError(f"unknown driver '{name}'; there are {', '.join(DRIVERS)}{did_you_mean(name, DRIVERS)}")


def robot_driven(driver: str) -> str | None:
    """The built-in robot of a driver; None for any robot."""
    return driver if driver in WIRED else None


def make_driver(driver: str, robot: Robot, **options: Any) -> RobotDriver:
    """A driver (one of `WIRED`) of a real robot, not yet open; `options` are those of `RobotDriver` and its own. Raises
    `ConfigError` for an unknown option, `DriverError` for a missing dependency."""
    module, name, own = WIRED[driver]
    unknown = next((option for option in options if option not in (*own, "release", "say", "timeout_s")), None)
    if unknown is not None:
        known = f"; it has {', '.join(f'--{option}' for option in own)}" if own else ""
        raise ConfigError(f"driver '{driver}' has no --{unknown}{known}")
    made: RobotDriver = getattr(import_module(module), name)(robot, **options)
    return made
