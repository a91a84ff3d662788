"""What retargeting changed: figures of the animal and of the robot, which show whether it is still the same motion."""

import math
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from fastmimic.base.arrays import Array
from fastmimic.base.conventions import JOINTS_PER_LEG, LEGS
from fastmimic.base.rotations import rotate_planar, yaw_from_quat
from fastmimic.motion.contacts import Stances, duty_factors, swings_of
from fastmimic.motion.provenance import RetargetBound
from fastmimic.retargeting.contact_schedule import ScheduleChanges
from fastmimic.retargeting.feet import MIN_CLEARANCE_SHARE
from fastmimic.retargeting.steps import Retargeting
from fastmimic.retargeting.track import ScaledClip, TrunkTrack, WorldPath, closing_error, cycle_displacement
from fastmimic.trajectory.executable import ExecutableFigures

Floats = tuple[float, ...]
Ints = tuple[int, ...]

_JOINT_SPEED: Final = "joint speed, share of the limit"
MAX_SPEED_CHANGE: Final = 0.03
SLOW_M_PER_S: Final = 0.4  # the change of a slower animal's speed is a share of this
MAX_YAW_CHANGE_DEG: Final = 2.0
MAX_DUTY_CHANGE: Final = 0.1
MAX_SLIP_M: Final = 1e-3


@dataclass(frozen=True)
class MotionFigures:
    """Figures by which the animal's motion and the robot's are compared. Legs FR, FL, RR, RL."""

    period_s: float  # duration; that of the robot is a whole number of control steps
    slip_m: Floats  # largest horizontal motion of each foot within a stance
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
    closure_m: float  # how far the animal's cycle is from closing: a foot against its hip, or a height; 0 without one
    closure_deg: float  # likewise its roll and pitch
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

    def lines(self) -> list[str]:
        """The report for a human."""
        before, after = self.before, self.after
        joints = zip(JOINTS_PER_LEG, self.joint_speed_peak, self.joint_speed_limit, strict=True)
        speeds = ", ".join(f"{name} {peak:.1f} of {limit:.0f}" for name, peak, limit in joints)
        period = f"period {before.period_s:.4f} → {after.period_s:.4f} s"
        speed = f"speed {before.speed_m_per_s:.3f} → {after.speed_m_per_s:.3f} m/s"
        yaw = f"yaw {before.yaw_deg:.1f} → {after.yaw_deg:.1f}°"
        closed = f"cut closed by {1e3 * self.closure_m:.1f} mm, {self.closure_deg:.2f}°"
        support = [f"{feet} feet {100 * share:.0f} %" for feet, share in enumerate(self.support_share) if share > 0]
        clamps = f"reach {sum(self.unreachable)}, joint limits {sum(self.joint_limited)} of {self.samples} samples"
        moved = f"lowered {1e3 * self.lowered_m:.0f} mm for reach"
        if self.lowered_m < 0:
            moved = f"raised {-1e3 * self.lowered_m:.0f} mm for knees that fold too far"
        return [
            f"scale {self.scale:.3f}; {self.cycle_reason}; {period}",
            f"{speed}; {yaw}; heading aligned by {self.heading_aligned_deg:.1f}°; {closed}",
            f"{'':24}{' '.join(f'{leg:>6}' for leg in LEGS)}",
            _row("slip in stance, mm", before.slip_m, after.slip_m, 1e3, 1),
            _row("duty factor", before.duty, after.duty, 1, 2),
            _row("swing clearance, mm", before.clearance_m, after.clearance_m, 1e3, 0),
            _row("foot path RMS, mm", None, self.foot_path_rms_m, 1e3, 0),
            f"support: {', '.join(support)}",
            f"base height {self.base_height_m:.3f} m ({moved})",
            f"kinematic joint speeds {speeds} rad/s; clamps: {clamps}",
            *(f"{'ok ' if bound.met else 'NOT MET'} {bound}" for bound in self.bounds),
            *([] if self.executable is None else self.executable.lines()),
        ]


def make_report(work: Retargeting) -> RetargetReport:
    """The figures of one retargeting with their bounds."""
    motion, track, pose = work.motion, work.track, work.pose
    n = motion.n_samples
    closure_m, closure_deg = closure_of_source(work.source) if track.cycle is not None else (0.0, 0.0)
    planted = np.linalg.norm((motion.foot_pos_w - work.raw_w)[..., :2], axis=-1)
    report = RetargetReport(
        before=_animal_figures(work),
        after=_robot_figures(work),
        scale=work.scale,
        is_cycle=track.cycle is not None,
        cycle_reason=work.cycle_reason,
        closure_m=closure_m,
        closure_deg=closure_deg,
        changes=work.changes,
        stances=tuple(len(leg) for leg in work.stances),
        support_share=_listed(np.bincount(motion.contact.sum(axis=1), minlength=5) / n),
        foot_path_rms_m=_listed(np.sqrt((planted**2).mean(axis=0))),
        foot_offset_m=_listed(work.offset[[1, 3]].T.ravel()),
        base_height_m=float(motion.root_pos_w[:, 2].mean()),
        lowered_m=pose.lowered_m - work.raised,
        unreachable=_listed(pose.unreachable.sum(axis=0)),
        joint_limited=_listed(pose.limited.reshape(n, 4, 3).any(axis=1).sum(axis=0)),
        samples=n,
        joint_speed_peak=_listed(np.abs(motion.joint_vel).reshape(n, 4, 3).max(axis=(0, 1))),
        joint_speed_limit=_listed(work.robot.joint_speed_limit.reshape(4, 3).min(axis=0)),
        heading_aligned_deg=float(np.degrees(work.aligned)),
    )
    return with_bounds(report, work.config.turning_radius_m)


def _animal_figures(work: Retargeting) -> MotionFigures:
    track, source, stances = work.track, work.source, work.stances
    periodic = track.cycle is not None
    speed, turn = _travel_of_source(source, periodic)
    return MotionFigures(
        period_s=work.duration,
        slip_m=_listed(slip(work.raw_w, track, stances)),
        duty=_listed(duty_factors(work.detected, work.n)),
        speed_m_per_s=speed,
        yaw_deg=float(np.degrees(turn)),
        clearance_m=_listed(mean_clearance(track.toe_height, stances, periodic)),
    )


def _robot_figures(work: Retargeting) -> MotionFigures:
    motion, track, stances = work.motion, work.track, work.stances
    feet = motion.foot_pos_w
    periodic = track.cycle is not None
    heading = np.unwrap(yaw_from_quat(motion.root_quat_wxyz))
    turn = track.cycle[2] if track.cycle is not None else heading[-1] - heading[0]
    return MotionFigures(
        period_s=motion.period_s,
        slip_m=_listed(slip(feet, track, stances)),
        duty=_listed(duty_factors(stances, motion.n_samples)),
        speed_m_per_s=mean_speed(motion.root_lin_vel_w[:, :2], heading),
        yaw_deg=float(np.degrees(turn)),
        clearance_m=_listed(mean_clearance(feet[..., 2] - work.robot.foot_radius, stances, periodic)),
    )


def _travel_of_source(source: ScaledClip, periodic: bool) -> tuple[float, float]:
    """Mean speed and heading change of the scaled animal, over one cycle or from the first frame to the last."""
    middle = 0.5 * (source.heading[1:] + source.heading[:-1])
    local = rotate_planar(-middle, np.diff(source.root_xy, axis=0))
    if periodic:
        local = np.concatenate([local, 0.5 * (local[:1] + local[-1:])])
    turn = cycle_displacement(source)[2] if periodic else source.heading[-1] - source.heading[0]
    return mean_speed(local * source.rate_hz, np.zeros(len(local))), float(turn)


def _listed(values: NDArray[Any]) -> tuple[Any, ...]:
    return tuple(values.tolist())


def slip(feet_w: Array, track: TrunkTrack, stances: Stances) -> Array:
    """Largest horizontal distance (4,), m, of each foot from its touch-down, within a stance."""
    worst = np.zeros(4)
    for leg, spans in enumerate(stances):
        path = WorldPath(feet_w[:, leg], track)
        for span in spans:
            points = path.read(np.arange(*span))[:, :2]
            worst[leg] = max(worst[leg], float(np.linalg.norm(points - points[0], axis=1).max()))
    return worst


def mean_clearance(height: Array, stances: Stances, periodic: bool) -> Array:
    """Mean over each leg's swings of the highest point, (4,), m; 0 for a leg that never swings."""
    n = len(height)
    result = np.zeros(4)
    for leg, spans in enumerate(stances):
        tops = [height[np.arange(a, b) % n, leg].max() for a, b in swings_of(spans, n, periodic)]
        result[leg] = float(np.mean(tops)) if tops else 0.0
    return result


def closure_of_source(source: ScaledClip) -> tuple[float, float]:
    """How far a cut cycle is from closing: the worst of feet against hips and of heights, m; of roll and pitch, deg."""
    feet = np.concatenate([source.toe_from_hip, source.toe_height[..., None]], axis=-1)
    distance = max(np.linalg.norm(closing_error(feet), axis=-1).max(), abs(closing_error(source.root_z)))
    return float(distance), float(np.degrees(np.linalg.norm(closing_error(source.tilt))))


def mean_speed(velocity_xy: Array, heading: Array) -> float:
    """Length of the mean velocity (t, 2) as seen from the trunk with `heading` (t,), m/s: unlike the path's length it
    does not grow with sway, and unlike the end-to-end distance it does not shrink in a turn."""
    return float(np.linalg.norm(rotate_planar(-heading, velocity_xy).mean(axis=0)))


def with_bounds(report: RetargetReport, turning_radius_m: float) -> RetargetReport:
    """Adds the bounds, with a reason for each that is not met; `turning_radius_m` is that of `RetargetConfig`."""
    before, after = report.before, report.after
    # a turn on the spot has no speed to compare with, but its feet walk on a circle
    turning = turning_radius_m * math.radians(abs(before.yaw_deg)) / before.period_s
    scale = max(math.hypot(before.speed_m_per_s, turning), SLOW_M_PER_S)
    speed = abs(after.speed_m_per_s - before.speed_m_per_s) / scale
    lifts = zip(before.clearance_m, after.clearance_m, strict=True)
    clearance = min((b / max(a, 1e-3) for a, b in lifts if b > 0), default=1.0)
    duty = max(abs(a - b) for a, b in zip(before.duty, after.duty, strict=True))
    joint_speed = max(a / b for a, b in zip(report.joint_speed_peak, report.joint_speed_limit, strict=True))
    held = f"{sum(report.unreachable)} samples out of reach, {sum(report.joint_limited)} at a joint limit"
    low, lift = clearance < MIN_CLEARANCE_SHARE, "swing clearance, share of the animal's"
    found = [
        _at_most("slip in stance, m", max(after.slip_m), MAX_SLIP_M, held),
        _at_most("speed change, share", speed, MAX_SPEED_CHANGE, "the path was smoothed"),
        _at_most("yaw change, deg", abs(after.yaw_deg - before.yaw_deg), MAX_YAW_CHANGE_DEG, ""),
        RetargetBound(lift, clearance, MIN_CLEARANCE_SHARE, not low, held if low else ""),
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


def _row(title: str, before: Floats | None, after: Floats, factor: float, digits: int) -> str:
    first = "" if before is None else " ".join(f"{factor * value:6.{digits}f}" for value in before) + "  →"
    return f"{title:24}{first}" + " ".join(f"{factor * value:6.{digits}f}" for value in after)
