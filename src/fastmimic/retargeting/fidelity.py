"""Holds a retargeted motion against the animal and writes the report."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from fastmimic.base.arrays import Array
from fastmimic.base.rotations import rotate_planar, yaw_from_quat
from fastmimic.motion.contacts import Stances, duty_factors
from fastmimic.retargeting import measure
from fastmimic.retargeting.contact_schedule import GaitChanges
from fastmimic.retargeting.cycle import TrunkTrack, cycle_displacement
from fastmimic.retargeting.fit import Fitted
from fastmimic.retargeting.report import RetargetReport, with_bounds
from fastmimic.retargeting.scaled_clip import ScaledClip
from fastmimic.robot import Robot


@dataclass(frozen=True, eq=False)
class Before:
    """What the report needs from the steps before the fit.

    Attributes:
        scale: animal's to robot's size.
        duration_s: of the clip.
        cycle_reason: how it was decided whether the clip is a cycle.
        aligned: angle by which the heading was turned, rad.
        track: the animal's trunk and toes.
        stances: contacts as detected.
        offset: (4, 2) constant shifts of the feet against the hips, m.
        changes: made to the contacts.
        raised_m: by how much the base's nominal height was raised for folded legs.
    """

    scale: float
    duration_s: float
    cycle_reason: str
    aligned: float
    track: TrunkTrack
    stances: Stances
    offset: Array
    changes: GaitChanges
    raised_m: float


def make_report(fitted: Fitted, robot: Robot, source: ScaledClip, stances: Stances, before: Before) -> RetargetReport:
    """The figures of one retargeting, held against the bounds."""
    motion, track, pose = fitted.motion, fitted.track, fitted.pose
    n, periodic = motion.n_samples, track.cycle is not None
    feet = motion.foot_pos_w
    planted = np.linalg.norm((feet - fitted.raw_w)[..., :2], axis=-1)
    heading = np.unwrap(yaw_from_quat(motion.root_quat_wxyz))
    turn = track.cycle[2] if track.cycle is not None else heading[-1] - heading[0]
    speed_before, turn_before = _travel_of_source(source, periodic)
    zero = measure.Closure(0.0, 0.0)
    closed_before = measure.closure_of_source(source) if periodic else zero
    closed_after = measure.closure_of_motion(motion, track) if periodic else zero
    change = measure.trunk_change(before.track, track)
    joint_speed = np.abs(motion.joint_vel).reshape(n, 4, 3).max(axis=(0, 1))
    report = RetargetReport(
        scale=before.scale,
        is_cycle=periodic,
        cycle_reason=before.cycle_reason,
        period_before_s=before.duration_s,
        period_after_s=motion.period_s,
        slip_before_m=_floats(measure.slip(fitted.raw_w, track, stances)),
        slip_after_m=_floats(measure.slip(feet, track, stances)),
        closure_before_m=closed_before.distance_m,
        closure_after_m=closed_after.distance_m,
        closure_before_deg=closed_before.angle_deg,
        closure_after_deg=closed_after.angle_deg,
        duty_before=_floats(duty_factors(before.stances, n)),
        duty_after=_floats(duty_factors(stances, n)),
        stances=_ints([len(leg) for leg in stances]),
        pairing=before.changes.pairing,
        common_duty=before.changes.common_duty,
        closed_flights=before.changes.closed_flights,
        widened_swings=before.changes.widened_swings,
        steps=before.changes.steps,
        support_share=measure.support_shares(motion.contact),
        speed_before_m_per_s=speed_before,
        speed_after_m_per_s=measure.mean_speed(motion.root_lin_vel_w[:, :2], heading),
        yaw_before_deg=float(np.degrees(turn_before)),
        yaw_after_deg=float(np.degrees(turn)),
        clearance_before_m=_floats(measure.mean_clearance(track.toe_height, stances, periodic)),
        clearance_after_m=_floats(measure.mean_clearance(feet[..., 2] - robot.foot_radius, stances, periodic)),
        foot_path_rms_m=_floats(np.sqrt((planted**2).mean(axis=0))),
        foot_offset_m=_floats([*before.offset[[1, 3], 0], *before.offset[[1, 3], 1]]),
        trunk_change_m=_floats(change[:3]),
        trunk_change_deg=_floats(np.degrees(change[3:])),
        base_height_m=float(motion.root_pos_w[:, 2].mean()),
        lowered_m=pose.lowered_m - before.raised_m,
        unreachable=_ints(pose.unreachable.sum(axis=0)),
        joint_limited=_ints(pose.limited.reshape(n, 4, 3).any(axis=1).sum(axis=0)),
        samples=n,
        joint_speed_peak=_floats(joint_speed),
        joint_speed_limit=_floats(robot.joint_speed_limit.reshape(4, 3).min(axis=0)),
        smoothed_legs=fitted.smoothed,
        heading_aligned_deg=float(np.degrees(before.aligned)),
        bounds=(),
    )
    return with_bounds(report)


def _travel_of_source(source: ScaledClip, periodic: bool) -> tuple[float, float]:
    """Mean speed and heading change of the scaled animal, over one cycle or from the first frame to the last."""
    steps = np.diff(source.root_xy, axis=0)
    middle = 0.5 * (source.heading[1:] + source.heading[:-1])
    local = rotate_planar(-middle, steps)
    if periodic:
        local = np.concatenate([local, 0.5 * (local[:1] + local[-1:])])
    turn = cycle_displacement(source)[2] if periodic else source.heading[-1] - source.heading[0]
    return measure.mean_speed(local * source.rate_hz, np.zeros(len(local))), float(turn)


def _floats(values: Iterable[float]) -> tuple[float, ...]:
    return tuple(float(x) for x in values)


def _ints(values: Iterable[int]) -> tuple[int, ...]:
    return tuple(int(x) for x in values)
