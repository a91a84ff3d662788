"""The safety limits of a deployment, and reading them."""

import dataclasses
import math
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from fastmimic.base.configuration import changed, check, documented, parameter
from fastmimic.base.errors import ConfigError
from fastmimic.robot import Robot
from fastmimic.robot.scaling import joint_ratio


@documented
@dataclass(frozen=True)
class SafetyLimits:
    """Beyond one of them the robot is damped. Shares refer to the robot's own limits in its model.

    The defaults are an A1's; `SafetyLimits.of` gives those of a robot.
    """

    joint_margin: float = parameter(
        0.1,
        unit="rad",
        about="by which a joint may be beyond its range: a calibrated encoder is off by some mrad, and end stops yield",
    )
    joint_speed: float = parameter(1.5, above=0.0, about="share of the joints' speed limit")
    torque: float = parameter(
        0.95, above=0.0, about="share of the torque limit that a motor may give for longer than torque_time_s"
    )
    torque_time_s: float = parameter(0.3, unit="s", above=0.0, about="how long a motor may give more than that")
    torque_peak: float = parameter(1.5, above=0.0, about="share of the torque limit that no motor may ever exceed")
    tilt: float = parameter(
        0.6,
        unit="rad",
        above=0.0,
        high=math.pi / 2,
        about="angle between the trunk's vertical and the reference's, or the world's while the robot stands up and"
        " sits down",
    )
    height_least: float = parameter(0.6, above=0.0, about="of the base over the ground, share of the reference's")
    height_most: float = parameter(1.4, above=0.0, about="of the base over the ground, share of the reference's")
    stale_s: float = parameter(0.02, unit="s", above=0.0, about="age of the newest state")
    overrun_s: float = parameter(
        0.05,
        unit="s",
        above=0.0,
        about="by which a command may be late. In simulation a trot continues after a pause of 50 ms, in which the"
        " robot's own watchdog damps the motors; damped for good it falls",
    )
    qp_failures: int = parameter(
        5, low=1, about="of the stance QP in a row; where only planning ahead fails, the stance QP replaces it"
    )
    posture: float = parameter(
        0.35, unit="rad", above=0.0, about="by which a standing joint may be off its target before the robot steps"
    )
    stiffness_most: float = parameter(300.0, unit="N·m/rad", above=0.0, about="of a command; what is beyond is cut")
    damping_most: float = parameter(20.0, unit="N·m·s/rad", above=0.0, about="of a command; what is beyond is cut")
    damping: float = parameter(3.0, unit="N·m·s/rad", above=0.0, about="of the joints after a violation")
    damping_s: float = parameter(1.5, unit="s", about="for which it is commanded")

    def __post_init__(self) -> None:
        check(self, "safety limit ")
        if self.height_least >= self.height_most:
            raise ConfigError(
                f"safety limit height_least ({self.height_least:g}) must be below height_most ({self.height_most:g})"
            )

    @classmethod
    def of(cls, robot: Robot) -> "SafetyLimits":
        """Those of a robot: gains in proportion to what its joints have to move, as the controller's."""
        ratio, an_a1 = joint_ratio(robot), cls()
        gains = {name: ratio * getattr(an_a1, name) for name in ("stiffness_most", "damping_most", "damping")}
        return dataclasses.replace(an_a1, **gains)


def read_limits(robot: Robot, file: str | Path | None = None, settings: Sequence[str] = ()) -> SafetyLimits:
    """A robot's limits, changed by a TOML file and by texts `name=value`, which override the file.

    Raises:
        ConfigError: a file that cannot be read, an unknown name, or a value out of its range.
    """
    limits = SafetyLimits.of(robot)
    if file is not None:
        try:
            found = tomllib.loads(Path(file).read_text(encoding="utf-8"))
        except (OSError, ValueError) as error:
            raise ConfigError(f"{file}: cannot be read as TOML ({error})") from None
        limits = changed(limits, found, f"safety limits in {file}")
    numbers: dict[str, float] = {}
    for text in settings:
        name, equals, value = text.partition("=")
        try:
            number = float(value)
        except ValueError:
            equals = ""
        if not equals:
            raise ConfigError(f"a limit is given as NAME=VALUE, such as tilt=0.5; found '{text}'")
        numbers[name.strip()] = number
    limits = changed(limits, numbers, "safety limits")
    return limits
