"""What retargeting changed: the figures by which a user can judge whether the result is still the animal's motion."""

import math
from dataclasses import asdict, dataclass, replace
from typing import Any, Final

from fastmimic.base.conventions import JOINTS_PER_LEG, LEGS

Floats = tuple[float, ...]
Ints = tuple[int, ...]

_ANGLES: Final = ("roll", "pitch", "yaw")
MAX_SPEED_CHANGE: Final = 0.03
SLOW_M_PER_S: Final = 0.4
"""Of a slower animal the change of speed is measured against this: a share of nothing says nothing."""
TURNING_RADIUS_M: Final = 0.22
"""Of the circle that the feet go round the trunk's middle in a turn, on robots of this size: an animal that turns on
the spot moves its feet at this radius times its turning, and that is the speed the change is measured against."""
MAX_YAW_CHANGE_DEG: Final = 2.0
MIN_CLEARANCE_SHARE: Final = 0.8
MAX_DUTY_CHANGE: Final = 0.1
MAX_SLIP_M: Final = 1e-3
MAX_CLOSURE_M: Final = 1e-3
MAX_CLOSURE_DEG: Final = 0.1


@dataclass(frozen=True)
class Bound:
    """One of the bounds within which the result counts as the animal's motion.

    Attributes:
        name: what is bounded.
        value: found.
        limit: allowed.
        met: whether it holds.
        reason: why not, or what explains the value; empty if there is nothing to say.
    """

    name: str
    value: float
    limit: float
    met: bool
    reason: str = ""


@dataclass(frozen=True)
class RetargetReport:
    """Retargeting of one clip, before (the scaled animal) and after (the robot's motion). Legs FR, FL, RR, RL.

    Attributes:
        scale: animal's to robot's size.
        is_cycle: whether the motion repeats, and `cycle_reason` how that was decided.
        cycle_reason: see above.
        period_before_s, period_after_s: resampled to a whole number of control steps.
        slip_before_m, slip_after_m: largest horizontal motion of each foot within a stance.
        closure_before_m, closure_after_m: largest distance of a foot or the root from where the cycle ends; 0 if not
            a cycle.
        closure_before_deg, closure_after_deg: the same for the trunk's orientation.
        duty_before, duty_after: share of the time in stance.
        stances: number of stances of each leg.
        pairing: pairs of legs that were given common times, or None.
        common_duty: whether left and right were given one duty factor.
        closed_flights, widened_swings: how many moments without support were closed and short swings made longer.
        steps: how many legs stood throughout a cycle that travels, and were given a step.
        support_share: share of the time with 0, 1, 2, 3 and 4 feet on the ground.
        speed_before_m_per_s, speed_after_m_per_s: length of the mean velocity as seen from the trunk; before is
            scale × animal.
        yaw_before_deg, yaw_after_deg: heading change over the motion (one cycle).
        clearance_before_m, clearance_after_m: mean height of each leg's swings above its stance; before is scale ×
            animal.
        foot_path_rms_m: change of each foot's path in the world by planting.
        foot_offset_m: constant shift of the feet against the hips: front and rear along x, front and rear outwards.
        trunk_change_m, trunk_change_deg: RMS change by balancing of x, y, z and of roll, pitch, yaw about their
            means.
        base_height_m, lowered_m: mean height of the base, and how much of its lowering was for reach; negative where
            it was raised for folded knees.
        unreachable: samples in which a leg could not reach, of `samples`.
        joint_limited: samples in which a joint was held at its limit, for abduction, hip and knee.
        samples: of the motion.
        joint_speed_peak, joint_speed_limit: abduction, hip, knee, rad/s.
        smoothed_legs: times that a leg's swings were smoothed further to keep joint speed.
        heading_aligned_deg: by how much the trunk was turned into the direction of travel.
        bounds: what the result is held to.
    """

    scale: float
    is_cycle: bool
    cycle_reason: str
    period_before_s: float
    period_after_s: float
    slip_before_m: Floats
    slip_after_m: Floats
    closure_before_m: float
    closure_after_m: float
    closure_before_deg: float
    closure_after_deg: float
    duty_before: Floats
    duty_after: Floats
    stances: Ints
    pairing: str | None
    common_duty: bool
    closed_flights: int
    widened_swings: int
    steps: int
    support_share: Floats
    speed_before_m_per_s: float
    speed_after_m_per_s: float
    yaw_before_deg: float
    yaw_after_deg: float
    clearance_before_m: Floats
    clearance_after_m: Floats
    foot_path_rms_m: Floats
    foot_offset_m: Floats
    trunk_change_m: Floats
    trunk_change_deg: Floats
    base_height_m: float
    lowered_m: float
    unreachable: Ints
    joint_limited: Ints
    samples: int
    joint_speed_peak: Floats
    joint_speed_limit: Floats
    smoothed_legs: Ints
    heading_aligned_deg: float
    bounds: tuple[Bound, ...]

    @property
    def all_met(self) -> bool:
        """Whether every bound holds."""
        return all(bound.met for bound in self.bounds)

    def as_dict(self) -> dict[str, Any]:
        """The report as plain JSON types."""
        return _plain(asdict(self))

    def _moved(self) -> str:
        if self.lowered_m < 0:
            return f"raised {-1e3 * self.lowered_m:.0f} mm for knees that fold too far"
        return f"lowered {1e3 * self.lowered_m:.0f} mm for reach"

    def lines(self) -> list[str]:
        """The report for a human."""
        legs = " ".join(f"{leg:>6}" for leg in LEGS)
        speeds = ", ".join(
            f"{name} {peak:.1f} of {limit:.0f}"
            for name, peak, limit in zip(JOINTS_PER_LEG, self.joint_speed_peak, self.joint_speed_limit, strict=True)
        )
        period = f"period {self.period_before_s:.4f} → {self.period_after_s:.4f} s"
        speed = f"speed {self.speed_before_m_per_s:.3f} → {self.speed_after_m_per_s:.3f} m/s"
        yaw = f"yaw {self.yaw_before_deg:.1f} → {self.yaw_after_deg:.1f}°"
        distance = f"{1e3 * self.closure_before_m:.1f} → {1e3 * self.closure_after_m:.2f} mm"
        angle = f"{self.closure_before_deg:.2f} → {self.closure_after_deg:.3f}°"
        support = [f"{feet} feet {100 * share:.0f} %" for feet, share in enumerate(self.support_share) if share > 0]
        change = [f"{a} {1e3 * v:.0f} mm" for a, v in zip("xyz", self.trunk_change_m, strict=True)]
        change += [f"{a} {v:.1f}°" for a, v in zip(_ANGLES, self.trunk_change_deg, strict=True)]
        clamps = f"reach {sum(self.unreachable)}, joint limits {sum(self.joint_limited)} of {self.samples} samples"
        lines = [
            f"scale {self.scale:.3f}; {self.cycle_reason}; {period}",
            f"{speed}; {yaw}; heading aligned by {self.heading_aligned_deg:.1f}°; closure {distance}, {angle}",
            f"{'':24}{legs}",
            _row("slip in stance, mm", self.slip_before_m, self.slip_after_m, 1e3, 1),
            _row("duty factor", self.duty_before, self.duty_after, 1, 2),
            _row("swing clearance, mm", self.clearance_before_m, self.clearance_after_m, 1e3, 0),
            _row("foot path RMS, mm", None, self.foot_path_rms_m, 1e3, 0),
            f"support: {', '.join(support)}",
            f"trunk changed by {', '.join(change)} RMS",
            f"base height {self.base_height_m:.3f} m ({self._moved()})",
            f"joint speeds {speeds} rad/s; clamps: {clamps}",
        ]
        for bound in self.bounds:
            why = f" ({bound.reason})" if bound.reason else ""
            lines.append(
                f"{'ok ' if bound.met else 'NOT MET'} {bound.name}: {bound.value:.3g} of {bound.limit:.3g}{why}"
            )
        return lines


def with_bounds(report: RetargetReport) -> RetargetReport:
    """The report with its figures held against the bounds; the reason stands beside each that is not met."""
    # a turn on the spot has no speed to compare with, but feet that walk on a circle
    turning = TURNING_RADIUS_M * math.radians(abs(report.yaw_before_deg)) / report.period_before_s
    scale = max(math.hypot(report.speed_before_m_per_s, turning), SLOW_M_PER_S)
    speed = abs(report.speed_after_m_per_s - report.speed_before_m_per_s) / scale
    yaw = abs(report.yaw_after_deg - report.yaw_before_deg)
    lifts = zip(report.clearance_before_m, report.clearance_after_m, strict=True)
    clearance = min((after / max(before, 1e-3) for before, after in lifts if after > 0), default=1.0)
    changes = [abs(a - b) for a, b in zip(report.duty_before, report.duty_after, strict=True)]
    joint_speed = max(a / b for a, b in zip(report.joint_speed_peak, report.joint_speed_limit, strict=True))
    fast = "the animal's legs move faster than the motors can"
    held = f"{sum(report.unreachable)} samples out of reach, {sum(report.joint_limited)} at a joint limit"
    found = [
        _at_most("slip in stance, m", max(report.slip_after_m), MAX_SLIP_M, held),
        _at_most("cycle closure, m", report.closure_after_m, MAX_CLOSURE_M, held),
        _at_most("cycle closure, deg", report.closure_after_deg, MAX_CLOSURE_DEG, ""),
        _at_most("speed change, share", speed, MAX_SPEED_CHANGE, "the path was smoothed and balanced"),
        _at_most("yaw change, deg", yaw, MAX_YAW_CHANGE_DEG, ""),
        Bound(
            "swing clearance, share of the animal's",
            clearance,
            MIN_CLEARANCE_SHARE,
            clearance >= MIN_CLEARANCE_SHARE,
            "" if clearance >= MIN_CLEARANCE_SHARE else held,
        ),
        _at_most("duty change", max(changes), MAX_DUTY_CHANGE, _duty_reason(report)),
        _at_most("joint speed, share of the limit", joint_speed, 1.0, fast),
    ]
    return replace(report, bounds=tuple(found))


def _at_most(name: str, value: float, limit: float, reason: str) -> Bound:
    met = value <= limit
    return Bound(name, value, limit, met, "" if met else reason)


def _duty_reason(report: RetargetReport) -> str:
    reasons = []
    if report.pairing is not None:
        reasons.append(f"{report.pairing} pairs were given common times")
    if report.common_duty:
        reasons.append("left and right were given one duty factor")
    if report.closed_flights:
        reasons.append(f"{report.closed_flights} moments without support were closed")
    if report.widened_swings:
        reasons.append(f"{report.widened_swings} short swings were widened")
    if report.steps:
        reasons.append(f"{report.steps} legs that stood while the cycle travels were given a step")
    return ", ".join(reasons)


def _row(title: str, before: Floats | None, after: Floats, factor: float, digits: int) -> str:
    first = "" if before is None else " ".join(f"{factor * value:6.{digits}f}" for value in before) + "  →"
    return f"{title:24}{first}" + " ".join(f"{factor * value:6.{digits}f}" for value in after)


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    return value
