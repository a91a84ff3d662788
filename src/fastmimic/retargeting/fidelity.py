"""Measures a retargeted motion and the animal, and writes the report."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from fastmimic.base.arrays import Array
from fastmimic.base.rotations import (
    quat_conjugate,
    quat_from_rotvec,
    quat_from_yaw,
    quat_multiply,
    rotate_planar,
    rotvec_from_quat,
    yaw_from_quat,
)
from fastmimic.motion.contacts import Stances, duty_factors, swings_of
from fastmimic.motion.motion import Motion
from fastmimic.retargeting.report import MotionFigures, RetargetReport, with_bounds
from fastmimic.retargeting.steps import Retargeting
from fastmimic.retargeting.track import ScaledClip, TrunkTrack, WorldPath, closing_error, cycle_displacement


def make_report(work: Retargeting) -> RetargetReport:
    """The figures of one retargeting with their bounds."""
    motion, track, pose = work.motion, work.track, work.pose
    n = motion.n_samples
    planted = np.linalg.norm((motion.foot_pos_w - work.raw_w)[..., :2], axis=-1)
    report = RetargetReport(
        before=_animal_figures(work),
        after=_robot_figures(work),
        scale=work.scale,
        is_cycle=track.cycle is not None,
        cycle_reason=work.cycle_reason,
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
    closure_m, closure_deg = closure_of_source(source) if periodic else (0.0, 0.0)
    return MotionFigures(
        period_s=work.duration,
        slip_m=_listed(slip(work.raw_w, track, stances)),
        closure_m=closure_m,
        closure_deg=closure_deg,
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
    closure_m, closure_deg = closure_of_motion(motion, track) if periodic else (0.0, 0.0)
    return MotionFigures(
        period_s=motion.period_s,
        slip_m=_listed(slip(feet, track, stances)),
        closure_m=closure_m,
        closure_deg=closure_deg,
        duty=_listed(duty_factors(stances, motion.n_samples)),
        speed_m_per_s=mean_speed(motion.root_lin_vel_w[:, :2], heading),
        yaw_deg=float(np.degrees(turn)),
        clearance_m=_listed(mean_clearance(feet[..., 2] - work.robot.foot_radius, stances, periodic)),
    )


def _travel_of_source(source: ScaledClip, periodic: bool) -> tuple[float, float]:
    """Mean speed and heading change of the scaled animal, over one cycle or from the first frame to the last."""
    steps = np.diff(source.root_xy, axis=0)
    middle = 0.5 * (source.heading[1:] + source.heading[:-1])
    local = rotate_planar(-middle, steps)
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


def closure_of_motion(motion: Motion, track: TrunkTrack) -> tuple[float, float]:
    """Distance of sample 0, moved by `cycle`, from the last sample continued by its velocity and acceleration: the
    worst of root and feet, m, and the trunk's rotation, deg."""
    assert motion.cycle is not None
    points = np.concatenate([motion.root_pos_w[:, None], motion.foot_pos_w], axis=1)
    repeated = np.concatenate([track.moved(points[0, :, :2], 1), points[0, :, 2:]], axis=1)
    distance = max(float(np.linalg.norm(apart)) for apart in _continued(points[-3:]) - repeated)
    last = motion.root_quat_wxyz[-1]
    turn = (1.5 * motion.root_ang_vel_w[-1] - 0.5 * motion.root_ang_vel_w[-2]) * motion.dt
    ahead_quat = quat_multiply(quat_from_rotvec(turn), last)
    repeated_quat = quat_multiply(quat_from_yaw(motion.cycle[2]), motion.root_quat_wxyz[0])
    angle = np.linalg.norm(rotvec_from_quat(quat_multiply(ahead_quat, quat_conjugate(repeated_quat))))
    return distance, float(np.degrees(angle))


def _continued(last_three: Array) -> Array:
    """The next sample by constant acceleration."""
    a, b, c = last_three
    return a - 3 * b + 3 * c


def mean_speed(velocity_xy: Array, heading: Array) -> float:
    """Length of the mean velocity (t, 2) as seen from the trunk with `heading` (t,), m/s: unlike the path's length it
    does not grow with sway, and unlike the end-to-end distance it does not shrink in a turn."""
    return float(np.linalg.norm(rotate_planar(-heading, velocity_xy).mean(axis=0)))
