"""Settings of retargeting: one set for all clips and robots."""

import dataclasses
from dataclasses import dataclass, field
from typing import Any, TypeVar

from fastmimic.base.configuration import parameters, tabulated
from fastmimic.motion.contacts import ContactConfig
from fastmimic.retargeting.contact_schedule import ContactScheduleConfig
from fastmimic.retargeting.feet import SwingPathConfig
from fastmimic.robot import Robot
from fastmimic.robot.robot import length_ratio

_Settings = TypeVar("_Settings")


@tabulated
@dataclass(frozen=True)
class RetargetConfig:
    """Settings of retargeting. Those of its steps are described at their classes.

    Lengths with `scale="length"` are at the A1's size; `for_robot` scales them with the robot's legs.

    A trot bounces at 3.6 Hz and a canter pitches at 2 Hz; above 6 Hz the dog's trunk shows marker noise only, which
    differentiation would amplify. The published retargeting levels the lateral axis before it builds the trunk's
    rotation, which leaves half of the roll: shoulders and hips roll more than the trunk between them. As published
    (Peng et al. 2020), feet stand 0.05 m outside the A1's abduction axes, and its base is 0.06 m below the scaled
    neck–pelvis line, which runs 0.045 m above the hips. Toe markers and foot radius add to `crouch_m`, reach 0.01 m.
    """

    trunk_hz: float = 6.0
    foot_hz: float = 12.0
    roll_share: float = 0.5
    stance_width: float = 0.59
    crouch_m: float = 0.04
    max_lowering_m: float = 0.02
    max_raising_m: float = 0.06
    limit_margin_rad: float = 0.02
    reach_margin_rad: float = 0.1
    straight_yaw_deg: float = 10.0
    straight_travel_deg: float = 15.0
    min_travel_m_per_s: float = 0.2
    cycle_mismatch: float = 0.6
    longest_cycle_s: float = 2.0
    short_s: float = 1.5
    short_mismatch: float = 1.5
    hold_s: float = 0.5
    rest_m_per_s: float = 0.15
    rest_rad_per_s: float = 0.5
    knee_clearance_m: float = 0.02
    turning_radius_m: float = 0.22
    contact: ContactConfig = field(default_factory=ContactConfig)
    schedule: ContactScheduleConfig = field(default_factory=ContactScheduleConfig)
    swing: SwingPathConfig = field(default_factory=SwingPathConfig)
    consistent: bool = True

    def for_robot(self, robot: Robot) -> "RetargetConfig":
        """These settings at the size of a robot."""
        return _scaled(self, length_ratio(robot))


def _scaled(settings: _Settings, factor: float) -> _Settings:
    lengths = [name for name, (known, _) in parameters(settings).items() if known.scale == "length"]
    changes: dict[str, Any] = {name: factor * getattr(settings, name) for name in lengths}
    for part in dataclasses.fields(settings):  # type: ignore[arg-type]
        value = getattr(settings, part.name)
        if dataclasses.is_dataclass(value):
            changes[part.name] = _scaled(value, factor)
    return dataclasses.replace(settings, **changes)  # type: ignore[type-var]
