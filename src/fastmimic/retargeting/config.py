"""Settings of retargeting: one set for all clips and robots."""

import dataclasses
from dataclasses import dataclass, field
from typing import Any, TypeVar

from fastmimic.base.configuration import documented, parameter, parameters
from fastmimic.motion.contacts import ContactConfig
from fastmimic.retargeting.contact_schedule import ContactScheduleConfig
from fastmimic.retargeting.feet import SwingPathConfig
from fastmimic.robot import Robot
from fastmimic.robot.robot import length_ratio

_Settings = TypeVar("_Settings")


@documented
@dataclass(frozen=True)
class RetargetConfig:
    """Settings of retargeting. Those of its steps are described at their classes.

    Lengths with `scale="length"` are at the A1's size; `for_robot` scales them with the robot's legs.

    A trot bounces at 3.6 Hz and a canter pitches at 2 Hz; above 6 Hz the dog's trunk shows marker noise only, which
    differentiation would amplify. The published retargeting levels the lateral axis before it builds the trunk's
    rotation, which leaves half of the roll: shoulders and hips roll more than the trunk between them. As published
    (Peng et al. 2020), feet stand 0.05 m outside the A1's abduction axes, and its base is 0.06 m below the scaled
    neck–pelvis line. That line runs 0.045 m above the hips; toe markers and foot radius add the rest of `crouch_m`, and
    reach 0.01 m.
    """

    trunk_hz: float = parameter(6.0, unit="Hz", above=0.0, about="half-power frequency of the trunk's low-pass filter")
    foot_hz: float = parameter(12.0, unit="Hz", above=0.0, about="half-power frequency of the toes' low-pass filter")
    roll_share: float = parameter(0.5, about="share of the shoulders' and hips' roll that the trunk takes")
    stance_width: float = parameter(
        0.59, about="lateral distance of the mean footholds from the abduction axis, share of the robot's lateral link"
    )
    crouch_m: float = parameter(0.04, unit="m", about="how much lower than the scaled hips the base is, at A1 size")
    max_lowering_m: float = parameter(
        0.02, unit="m", scale="length", about="most that the base is lowered further, for reach"
    )
    max_raising_m: float = parameter(
        0.06,
        unit="m",
        scale="length",
        about="most that the base is raised for knees that would fold too far or touch the ground; 0 keeps the animal's"
        " height. Without a cycle the base is raised only where it is needed",
    )
    limit_margin_rad: float = parameter(0.02, unit="rad", about="distance from the joint limits")
    reach_margin_rad: float = parameter(
        0.1, unit="rad", about="distance from the limits of knees and abduction joints when footholds are chosen"
    )
    straight_yaw_deg: float = parameter(10.0, unit="deg", about="a straight gait turns less than this in a cycle")
    straight_travel_deg: float = parameter(
        15.0,
        unit="deg",
        about="a straight gait travels within this angle of its heading, which is then turned into that direction",
    )
    min_travel_m_per_s: float = parameter(0.2, unit="m/s", about="slower motions have no direction of travel")
    cycle_mismatch: float = parameter(0.6, about="a clip is a cycle if it closes better than this (`pose_mismatch`)")
    longest_cycle_s: float = parameter(
        4.0, unit="s", above=0.0, about="a longer clip is a passage, even if its end leads back to its beginning"
    )
    short_s: float = parameter(1.5, unit="s", about="clips shorter than this use `short_mismatch`")
    short_mismatch: float = parameter(
        1.5, about="a short clip is a cycle if it closes better than this: such clips are usually cut out as one cycle"
    )
    hold_s: float = parameter(
        0.5,
        unit="s",
        about="for how long the last pose of a recording that ends standing is held, so that it ends at rest",
    )
    rest_m_per_s: float = parameter(0.15, unit="m/s", about="a slower trunk is at rest")
    rest_rad_per_s: float = parameter(0.5, unit="rad/s", about="a trunk that turns more slowly is at rest")
    knee_clearance_m: float = parameter(
        0.02, unit="m", scale="length", about="least height of the knees above the centre of a standing foot"
    )
    turning_radius_m: float = parameter(
        0.22,
        unit="m",
        scale="length",
        about="radius at which the feet circle the trunk's middle: the speed that a turn on the spot is measured by",
    )
    contact: ContactConfig = field(default_factory=ContactConfig)
    schedule: ContactScheduleConfig = field(default_factory=ContactScheduleConfig)
    swing: SwingPathConfig = field(default_factory=SwingPathConfig)
    consistent: bool = parameter(
        True,
        about="False keeps feet, contacts, heading and trunk as scaled and closed, as in the published retargeting:"
        " feet slide in stance and hover. For comparisons",
    )

    def for_robot(self, robot: Robot) -> "RetargetConfig":
        """These settings at the size of a robot."""
        return _scaled(self, length_ratio(robot))


def _scaled(settings: _Settings, factor: float) -> _Settings:
    changes: dict[str, Any] = {
        name: factor * getattr(settings, name)
        for name, (known, _) in parameters(settings).items()
        if known.scale == "length"
    }
    for part in dataclasses.fields(settings):  # type: ignore[arg-type]
        value = getattr(settings, part.name)
        if dataclasses.is_dataclass(value):
            changes[part.name] = _scaled(value, factor)
    return dataclasses.replace(settings, **changes)  # type: ignore[type-var]
