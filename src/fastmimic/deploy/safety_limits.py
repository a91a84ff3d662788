"""What a robot must not exceed: the limits of a deployment, and how they are read."""

import dataclasses
import math
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from fastmimic.base.errors import ConfigError, did_you_mean
from fastmimic.control.config import stiffness_ratio
from fastmimic.robot import Robot


@dataclass(frozen=True)
class SafetyLimits:
    """Beyond one of them the robot is damped. What is a share refers to the robot's own limits, out of its model.

    Attributes:
        joint_margin: by which a joint may be beyond its range, rad; a calibrated encoder is off by some mrad, and the
            end stops yield.
        joint_speed: share of the joints' speed limit.
        torque: share of the torque limit that a motor may give for longer than `torque_time_s`, s.
        torque_peak: share that no motor may be beyond at all.
        tilt: angle between the trunk's vertical and that of the reference, or the world's while it stands up and sits
            down, rad.
        height_least, height_most: of the base over the ground, shares of the reference's.
        stale_s: age of the newest state, s.
        overrun_s: by which a command may be late, s. In simulation a trot goes on after a pause of 50 ms, in which the
            robot's own watchdog has the motors damp; damped for good it falls.
        qp_failures: of the stance QP in a row; where only planning ahead fails, the stance QP stands in for it.
        posture: by which a joint may be off its target when the robot should stand, before it begins to step, rad.
        stiffness_most, damping_most: of a command, N·m/rad and N·m·s/rad; what is beyond is cut, as joint angles,
            speeds and torques beyond the robot's are.
        damping: of the joints after a violation, N·m·s/rad.
        damping_s: for which it is commanded, s.

    By default all are an A1's; `SafetyLimits.of` gives those of a robot.
    """

    joint_margin: float = 0.1
    joint_speed: float = 1.5
    torque: float = 0.95
    torque_time_s: float = 0.3
    torque_peak: float = 1.5
    tilt: float = 0.6
    height_least: float = 0.6
    height_most: float = 1.4
    stale_s: float = 0.02
    overrun_s: float = 0.05
    qp_failures: int = 5
    posture: float = 0.35
    stiffness_most: float = 300.0
    damping_most: float = 20.0
    damping: float = 3.0
    damping_s: float = 1.5

    def __post_init__(self) -> None:
        may_be_zero = ("joint_margin", "damping_s")
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            if not isinstance(value, int | float) or isinstance(value, bool) or not math.isfinite(value):
                raise ConfigError(f"safety limit {field.name} must be a number, found {value!r}")
            if value < 0 or (value == 0 and field.name not in may_be_zero):
                least = "not be negative" if field.name in may_be_zero else "be positive"
                raise ConfigError(f"safety limit {field.name} must {least}, found {value:g}")
        if self.qp_failures != int(self.qp_failures):
            raise ConfigError(f"safety limit qp_failures must be a whole number, found {self.qp_failures:g}")
        if self.height_least >= self.height_most:
            raise ConfigError(
                f"safety limit height_least ({self.height_least:g}) must be below height_most ({self.height_most:g})"
            )
        if self.tilt > math.pi / 2:
            raise ConfigError(f"safety limit tilt must be at most {math.pi / 2:.2f} rad, found {self.tilt:g}")

    @classmethod
    def of(cls, robot: Robot) -> "SafetyLimits":
        """Those of a robot: gains in proportion to what its joints have to move, as the controller's."""
        ratio, an_a1 = stiffness_ratio(robot), cls()
        gains = {name: ratio * getattr(an_a1, name) for name in ("stiffness_most", "damping_most", "damping")}
        return dataclasses.replace(an_a1, **gains)


NAMES: Final = tuple(field.name for field in dataclasses.fields(SafetyLimits))


def read_limits(robot: Robot, file: str | Path | None = None, settings: Sequence[str] = ()) -> SafetyLimits:
    """A robot's limits, but for those in a TOML file, and in texts `name=value`, which go before the file's.

    Raises:
        ConfigError: a file that cannot be read, a name that is none, or a value out of its range.
    """
    found: dict[str, Any] = {}
    if file is not None:
        try:
            found = tomllib.loads(Path(file).read_text(encoding="utf-8"))
        except (OSError, ValueError) as error:
            raise ConfigError(f"{file}: cannot be read as TOML ({error})") from None
        found = _whole(found, str(file))
    for text in settings:
        name, equals, value = text.partition("=")
        try:
            number = float(value)
        except ValueError:
            equals = ""
        if not equals:
            raise ConfigError(f"a limit is given as NAME=VALUE, such as tilt=0.5; found '{text}'")
        found |= _whole({name.strip(): number}, "--limit")
    try:
        return dataclasses.replace(SafetyLimits.of(robot), **found)
    except ConfigError as error:
        raise ConfigError(f"{file}: {error}" if file is not None and not settings else str(error)) from None


def _whole(found: dict[str, Any], where: str) -> dict[str, Any]:
    unknown = next((name for name in found if name not in NAMES), None)
    if unknown is not None:
        raise ConfigError(
            f"{where}: no safety limit '{unknown}'; there are {', '.join(NAMES)}{did_you_mean(unknown, NAMES)}"
        )
    return {k: int(v) if k == "qp_failures" and v == int(v) else v for k, v in found.items()}
