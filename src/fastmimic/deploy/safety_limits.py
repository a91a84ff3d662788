"""Safety limits of a deployment, and how they are read from a file and the command line."""

import dataclasses
import math
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fastmimic.base.configuration import changed, check, documented, parameter
from fastmimic.base.errors import ConfigError
from fastmimic.robot import Robot
from fastmimic.robot.scaling import joint_ratio


@documented
@dataclass(frozen=True)
class SafetyLimits:
    """Limits of a deployment. Beyond any of them the joints are damped.

    Shares refer to the robot's limits in its model. The defaults are an A1's; `SafetyLimits.of` scales them.
    """

    joint_margin: float = parameter(
        0.1,
        unit="rad",
        about="how far a joint may be beyond its range (`joint_position`)",
    )
    joint_speed: float = parameter(1.5, above=0.0, about="share of the joint's speed limit (`joint_velocity`)")
    torque: float = parameter(
        0.95, above=0.0, about="share of the motor's limit that it may exceed for `torque_time_s` at most (`torque`)"
    )
    torque_time_s: float = parameter(0.3, above=0.0, unit="s", about="how long a motor may exceed `torque` (`torque`)")
    torque_peak: float = parameter(1.5, above=0.0, about="share of the motor's limit that is never exceeded (`torque`)")
    tilt: float = parameter(
        0.6,
        above=0.0,
        high=math.pi / 2,
        unit="rad",
        about="angle between the trunk's vertical and the reference's, or the world's while standing up and sitting"
        " down (`tilt`)",
    )
    height_least: float = parameter(
        0.6, above=0.0, about="least height of the base as a share of the reference's (`height`)"
    )
    height_most: float = parameter(
        1.4, above=0.0, about="greatest height of the base as a share of the reference's (`height`)"
    )
    stale_s: float = parameter(0.02, above=0.0, unit="s", about="age of the newest state (`stale_state`)")
    # In simulation a trot survives a pause of 50 ms, in which the robot's own watchdog damps the motors.
    overrun_s: float = parameter(0.05, above=0.0, unit="s", about="how late a command may be (`overrun`)")
    qp_failures: int = parameter(
        5, low=1, about="failures of the stance QP in a row (`qp_failure`); it also replaces a failed horizon QP"
    )
    posture: float = parameter(
        0.35,
        above=0.0,
        unit="rad",
        about="a joint's distance from the standing posture before stepping (`posture`)",
    )
    stiffness_most: float = parameter(
        300.0, above=0.0, unit="N·m/rad", about="greatest stiffness of a command; scaled with the robot; cut"
    )
    damping_most: float = parameter(
        20.0, above=0.0, unit="N·m·s/rad", about="greatest damping of a command; scaled with the robot; cut"
    )
    damping: float = parameter(
        3.0, above=0.0, unit="N·m·s/rad", about="damping of the joints after a violation; scaled with the robot"
    )
    damping_s: float = parameter(1.5, unit="s", about="how long the joints are damped after a violation")

    def __post_init__(self) -> None:
        check(self, "safety limit ")
        if self.height_least >= self.height_most:
            raise ConfigError(
                f"safety limit height_least ({self.height_least:g}) must be below height_most ({self.height_most:g})"
            )

    @classmethod
    def of(cls, robot: Robot) -> "SafetyLimits":
        """The defaults for a robot, with gains in proportion to the inertia that its joints move."""
        ratio, an_a1 = joint_ratio(robot), cls()
        gains = {name: ratio * getattr(an_a1, name) for name in ("stiffness_most", "damping_most", "damping")}
        return dataclasses.replace(an_a1, **gains)


def read_limits(robot: Robot, file: str | Path | None = None, settings: Sequence[str] = ()) -> SafetyLimits:
    """A robot's limits, changed by a TOML file and then by texts `name=value`; raises `ConfigError` for bad ones."""
    changes: dict[str, Any] = {}
    if file is not None:
        try:
            changes = tomllib.loads(Path(file).read_text(encoding="utf-8"))
        except (OSError, ValueError) as error:
            raise ConfigError(f"{file}: cannot be read as TOML ({error})") from None
    for text in settings:
        name, _, value = text.partition("=")
        try:
            changes[name.strip()] = float(value)
        except ValueError:
            raise ConfigError(f"--limit takes NAME=VALUE, e.g. tilt=0.5; found '{text}'") from None
    where = str(file) if file is not None and not settings else "--limit"
    return changed(SafetyLimits.of(robot), changes, where)
