"""What retargeting changed: figures that show whether the result is still the animal's motion."""

import math
from dataclasses import asdict, dataclass, replace
from typing import Any, Final

from fastmimic.base.conventions import JOINTS_PER_LEG, LEGS
from fastmimic.base.text import plain
from fastmimic.motion.provenance import RetargetBound
from fastmimic.retargeting.contact_schedule import ScheduleChanges
from fastmimic.trajectory.executable import ExecutableFigures

Floats = tuple[float, ...]
Ints = tuple[int, ...]

_JOINT_SPEED: Final = "joint speed, share of the limit"
MAX_SPEED_CHANGE: Final = 0.03
SLOW_M_PER_S: Final = 0.4  # the change of a slower animal's speed is a share of this
MAX_YAW_CHANGE_DEG: Final = 2.0
MIN_CLEARANCE_SHARE: Final = 0.8
MAX_DUTY_CHANGE: Final = 0.1
MAX_SLIP_M: Final = 1e-3
MAX_CLOSURE_M: Final = 1e-3
MAX_CLOSURE_DEG: Final = 0.1


@dataclass(frozen=True)
class MotionFigures:
    """Figures by which the animal's motion and the robot's are compared. Legs FR, FL, RR, RL."""

    period_s: float  # duration; that of the robot is a whole number of control steps
    slip_m: Floats  # largest horizontal motion of each foot within a stance
    closure_m: float  # largest distance of a foot or the root from its place at the cycle's end; 0 without one
    closure_deg: float  # the same for the trunk's orientation
    duty: Floats  # share of the time in stance
    speed_m_per_s: float  # length of the mean velocity as seen from the trunk
    yaw_deg: float  # heading change over the motion (one cycle)
    clearance_m: Floats  # mean height of each leg's swings above its stance


@dataclass(frozen=True)
class RetargetReport:
    """Retargeting of one clip."""

    before: MotionFigures  # the animal at the robot's size
    after: MotionFigures  # the robot's motion
    scale: float  # animal's to robot's size
    is_cycle: bool  # whether the motion repeats
    cycle_reason: str  # why
    changes: ScheduleChanges  # of the contacts
    stances: Ints  # number of stances of each leg
    support_share: Floats  # share of the time with 0, 1, 2, 3 and 4 feet on the ground
    foot_path_rms_m: Floats  # change of each foot's path in the world by planting
    foot_offset_m: Floats  # shift of the feet against the hips: front and rear along x, then outwards
    base_height_m: float  # mean
    lowered_m: float  # of the base for reach, negative if raised for folded knees
    unreachable: Ints  # samples in which a leg could not reach, of `samples`
    joint_limited: Ints  # samples in which a joint was held at its limit, for abduction, hip and knee
    samples: int  # of the motion
    joint_speed_peak: Floats  # abduction, hip, knee, rad/s
    joint_speed_limit: Floats  # likewise
    heading_aligned_deg: float  # angle by which the trunk was turned into the direction of travel
    bounds: tuple[RetargetBound, ...] = ()  # see `with_bounds`
    executable: ExecutableFigures | None = None
    """Of the optimal control problem, if the motion was made executable; the rest is about the kinematic motion that it
    starts from."""

    def as_dict(self) -> dict[str, Any]:
        found: dict[str, Any] = plain(asdict(self))
        return found

    def lines(self) -> list[str]:
        """The report for a human."""
        before, after = self.before, self.after
        speeds = ", ".join(
            f"{name} {peak:.1f} of {limit:.0f}"
            for name, peak, limit in zip(JOINTS_PER_LEG, self.joint_speed_peak, self.joint_speed_limit, strict=True)
        )
        period = f"period {before.period_s:.4f} → {after.period_s:.4f} s"
        speed = f"speed {before.speed_m_per_s:.3f} → {after.speed_m_per_s:.3f} m/s"
        yaw = f"yaw {before.yaw_deg:.1f} → {after.yaw_deg:.1f}°"
        distance = f"{1e3 * before.closure_m:.1f} → {1e3 * after.closure_m:.2f} mm"
        angle = f"{before.closure_deg:.2f} → {after.closure_deg:.3f}°"
        support = [f"{feet} feet {100 * share:.0f} %" for feet, share in enumerate(self.support_share) if share > 0]
        clamps = f"reach {sum(self.unreachable)}, joint limits {sum(self.joint_limited)} of {self.samples} samples"
        moved = f"lowered {1e3 * self.lowered_m:.0f} mm for reach"
        if self.lowered_m < 0:
            moved = f"raised {-1e3 * self.lowered_m:.0f} mm for knees that fold too far"
        return [
            f"scale {self.scale:.3f}; {self.cycle_reason}; {period}",
            f"{speed}; {yaw}; heading aligned by {self.heading_aligned_deg:.1f}°; closure {distance}, {angle}",
            f"{'':24}{' '.join(f'{leg:>6}' for leg in LEGS)}",
            _row("slip in stance, mm", before.slip_m, after.slip_m, 1e3, 1),
            _row("duty factor", before.duty, after.duty, 1, 2),
            _row("swing clearance, mm", before.clearance_m, after.clearance_m, 1e3, 0),
            _row("foot path RMS, mm", None, self.foot_path_rms_m, 1e3, 0),
            f"support: {', '.join(support)}",
            f"base height {self.base_height_m:.3f} m ({moved})",
            f"joint speeds {speeds} rad/s; clamps: {clamps}",
            *map(_bound_line, self.bounds),
            *([] if self.executable is None else self.executable.lines()),
        ]


def with_bounds(report: RetargetReport, turning_radius_m: float) -> RetargetReport:
    """Adds the bounds, with a reason for each that is not met; `turning_radius_m` is that of `RetargetConfig`."""
    before, after = report.before, report.after
    # a turn on the spot has no speed to compare with, but its feet walk on a circle
    turning = turning_radius_m * math.radians(abs(before.yaw_deg)) / before.period_s
    scale = max(math.hypot(before.speed_m_per_s, turning), SLOW_M_PER_S)
    speed = abs(after.speed_m_per_s - before.speed_m_per_s) / scale
    yaw = abs(after.yaw_deg - before.yaw_deg)
    lifts = zip(before.clearance_m, after.clearance_m, strict=True)
    clearance = min((b / max(a, 1e-3) for a, b in lifts if b > 0), default=1.0)
    duty = max(abs(a - b) for a, b in zip(before.duty, after.duty, strict=True))
    joint_speed = max(a / b for a, b in zip(report.joint_speed_peak, report.joint_speed_limit, strict=True))
    held = f"{sum(report.unreachable)} samples out of reach, {sum(report.joint_limited)} at a joint limit"
    low = clearance < MIN_CLEARANCE_SHARE
    found = [
        _at_most("slip in stance, m", max(after.slip_m), MAX_SLIP_M, held),
        _at_most("cycle closure, m", after.closure_m, MAX_CLOSURE_M, held),
        _at_most("cycle closure, deg", after.closure_deg, MAX_CLOSURE_DEG, ""),
        _at_most("speed change, share", speed, MAX_SPEED_CHANGE, "the path was smoothed"),
        _at_most("yaw change, deg", yaw, MAX_YAW_CHANGE_DEG, ""),
        RetargetBound(
            "swing clearance, share of the animal's", clearance, MIN_CLEARANCE_SHARE, not low, held if low else ""
        ),
        _at_most("duty change", duty, MAX_DUTY_CHANGE, ", ".join(report.changes.reasons())),
        _at_most(_JOINT_SPEED, joint_speed, 1.0, "the animal's legs move faster than the motors can"),
    ]
    return replace(report, bounds=tuple(found))


def with_executable(report: RetargetReport, figures: ExecutableFigures) -> RetargetReport:
    """Adds what made the motion executable; the joints' speeds are then those of that motion."""
    speed = _at_most(_JOINT_SPEED, figures.peak["joint speed"], 1.0, "")
    bounds = tuple(speed if bound.name == _JOINT_SPEED else bound for bound in report.bounds)
    return replace(report, bounds=bounds, executable=figures)


def _at_most(name: str, value: float, limit: float, reason: str) -> RetargetBound:
    met = value <= limit
    return RetargetBound(name, value, limit, met, "" if met else reason)


def _bound_line(bound: RetargetBound) -> str:
    why = f" ({bound.reason})" if bound.reason else ""
    return f"{'ok ' if bound.met else 'NOT MET'} {bound.name}: {bound.value:.3g} of {bound.limit:.3g}{why}"


def _row(title: str, before: Floats | None, after: Floats, factor: float, digits: int) -> str:
    first = "" if before is None else " ".join(f"{factor * value:6.{digits}f}" for value in before) + "  →"
    return f"{title:24}{first}" + " ".join(f"{factor * value:6.{digits}f}" for value in after)
