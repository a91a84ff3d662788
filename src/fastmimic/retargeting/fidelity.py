"""Compares a retargeted motion with the animal and writes the report."""

from collections.abc import Iterable

import numpy as np

from fastmimic.base.rotations import rotate_planar, yaw_from_quat
from fastmimic.motion.contacts import duty_factors
from fastmimic.retargeting import measure
from fastmimic.retargeting.cycle import cycle_displacement
from fastmimic.retargeting.fit import Fitted
from fastmimic.retargeting.report import MotionFigures, RetargetReport, with_bounds
from fastmimic.retargeting.scaled_clip import ScaledClip
from fastmimic.retargeting.steps import Retargeting


def make_report(work: Retargeting, fitted: Fitted) -> RetargetReport:
    """The figures of one retargeting with their bounds."""
    motion, track, pose = fitted.motion, fitted.track, fitted.pose
    n = motion.n_samples
    planted = np.linalg.norm((motion.foot_pos_w - fitted.raw_w)[..., :2], axis=-1)
    change = measure.trunk_change(work.track, track)
    report = RetargetReport(
        before=_animal_figures(work, fitted),
        after=_robot_figures(work, fitted),
        scale=work.scale,
        is_cycle=track.cycle is not None,
        cycle_reason=work.cycle_reason,
        changes=work.changes,
        stances=_ints([len(leg) for leg in work.stances]),
        support_share=measure.support_shares(motion.contact),
        foot_path_rms_m=_floats(np.sqrt((planted**2).mean(axis=0))),
        foot_offset_m=_floats([*work.offset[[1, 3], 0], *work.offset[[1, 3], 1]]),
        trunk_change_m=_floats(change[:3]),
        trunk_change_deg=_floats(np.degrees(change[3:])),
        base_height_m=float(motion.root_pos_w[:, 2].mean()),
        lowered_m=pose.lowered_m - work.raised,
        unreachable=_ints(pose.unreachable.sum(axis=0)),
        joint_limited=_ints(pose.limited.reshape(n, 4, 3).any(axis=1).sum(axis=0)),
        samples=n,
        joint_speed_peak=_floats(np.abs(motion.joint_vel).reshape(n, 4, 3).max(axis=(0, 1))),
        joint_speed_limit=_floats(work.robot.joint_speed_limit.reshape(4, 3).min(axis=0)),
        smoothed_legs=fitted.smoothed,
        heading_aligned_deg=float(np.degrees(work.aligned)),
    )
    return with_bounds(report, work.config.turning_radius_m)


def _animal_figures(work: Retargeting, fitted: Fitted) -> MotionFigures:
    track, source, stances = fitted.track, work.source, work.stances
    periodic = track.cycle is not None
    speed, turn = _travel_of_source(source, periodic)
    closure = measure.closure_of_source(source) if periodic else measure.Closure(0.0, 0.0)
    return MotionFigures(
        period_s=work.duration,
        slip_m=_floats(measure.slip(fitted.raw_w, track, stances)),
        closure_m=closure.distance_m,
        closure_deg=closure.angle_deg,
        duty=_floats(duty_factors(work.detected, fitted.motion.n_samples)),
        speed_m_per_s=speed,
        yaw_deg=float(np.degrees(turn)),
        clearance_m=_floats(measure.mean_clearance(track.toe_height, stances, periodic)),
    )


def _robot_figures(work: Retargeting, fitted: Fitted) -> MotionFigures:
    motion, track, stances = fitted.motion, fitted.track, work.stances
    feet = motion.foot_pos_w
    periodic = track.cycle is not None
    heading = np.unwrap(yaw_from_quat(motion.root_quat_wxyz))
    turn = track.cycle[2] if track.cycle is not None else heading[-1] - heading[0]
    closure = measure.closure_of_motion(motion, track) if periodic else measure.Closure(0.0, 0.0)
    return MotionFigures(
        period_s=motion.period_s,
        slip_m=_floats(measure.slip(feet, track, stances)),
        closure_m=closure.distance_m,
        closure_deg=closure.angle_deg,
        duty=_floats(duty_factors(stances, motion.n_samples)),
        speed_m_per_s=measure.mean_speed(motion.root_lin_vel_w[:, :2], heading),
        yaw_deg=float(np.degrees(turn)),
        clearance_m=_floats(measure.mean_clearance(feet[..., 2] - work.robot.foot_radius, stances, periodic)),
    )


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
