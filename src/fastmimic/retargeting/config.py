"""Settings of retargeting: one set for all clips and robots."""

from dataclasses import dataclass, field

from fastmimic.motion.contacts import ContactConfig
from fastmimic.retargeting.balance import BalanceConfig
from fastmimic.retargeting.contact_schedule import ContactScheduleConfig
from fastmimic.retargeting.feet import SwingPathConfig


@dataclass(frozen=True)
class RetargetConfig:
    """Settings of retargeting; those of its steps are described with them.

    Attributes:
        trunk_hz: half-power frequency of the trunk's low-pass. A trot bounces at 3.6 Hz and a canter pitches at 2 Hz;
            above 6 Hz the spectra of the dog's trunk are flat: marker noise, of which differentiation would make the
            larger part of the angular velocity.
        foot_hz: the same for the toes.
        roll_share: share of the shoulders' and hips' roll that the trunk takes. The published retargeting levels the
            lateral axis before it builds the rotation, which leaves half: girdles roll more than the trunk between
                them.
        stance_width: lateral distance of the mean footholds from the abduction axis, share of the robot's lateral
            link (0.05 m on the A1, as published).
        crouch_m: how much lower than the scaled hips the base is, at the A1's size. As published the base is 0.06 m
            below the scaled neck–pelvis line, which runs 0.045 m above the hips; the rest is what the toe markers and
            the feet's radius add to the height, and 0.01 m for reach.
        max_lowering_m: further lowering for reach, at most.
        max_raising_m: raising at most, for knees that would bend too far or touch the ground, beyond the height at
            which folded legs can be lifted: an animal crouches and sits lower than a robot can. 0 leaves the animal's
            height. In a recording that does not repeat the base is raised where it is needed, and only there.
        limit_margin_rad: kept to the joint limits.
        reach_margin_rad: kept to the knees' and abduction joints' limits when footholds are chosen.
        speed_share: of the joint speed limit that the reference may use.
        straight_yaw_deg, straight_travel_deg: a gait is straight if it turns less than the first a cycle and travels
            within the second of its heading; only then the heading is turned into the direction of travel.
        min_travel_m_per_s: slower motions have no direction of travel.
        cycle_mismatch: a clip of which nothing is known is a cycle if it closes better than this (see `pose_mismatch`).
        short_s, short_mismatch: so is one shorter than this that closes better than that: who cuts out a second of a
            recording means a cycle, and steps of a real animal differ.
        hold_s: a recording that does not repeat and ends standing is held in its last pose for so long, s, so that what
            the robot does there ends at rest, too.
        rest_m_per_s, rest_rad_per_s: a trunk and feet that move less at the end, at the robot's size, stand.
        contact, gait, swing, balance: settings of these steps.
        consistent: without it the animal's feet, contacts, heading and trunk stay as scaled and closed, as in the
            published retargeting: feet slide in stance and hover, contacts are those of the thresholds. For
            comparisons.
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
    speed_share: float = 0.95
    straight_yaw_deg: float = 10.0
    straight_travel_deg: float = 15.0
    min_travel_m_per_s: float = 0.2
    cycle_mismatch: float = 0.6
    short_s: float = 1.5
    short_mismatch: float = 1.5
    hold_s: float = 0.5
    rest_m_per_s: float = 0.15
    rest_rad_per_s: float = 0.5
    contact: ContactConfig = field(default_factory=ContactConfig)
    gait: ContactScheduleConfig = field(default_factory=ContactScheduleConfig)
    swing: SwingPathConfig = field(default_factory=SwingPathConfig)
    balance: BalanceConfig = field(default_factory=BalanceConfig)
    consistent: bool = True
