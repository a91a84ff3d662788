"""Holds a retargeted motion against the animal and writes the report."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fastmimic.motion import retarget_measure as measure
from fastmimic.motion import retarget_report as bounds
from fastmimic.motion.contacts import Stances, duty_factors
from fastmimic.motion.motion import Motion
from fastmimic.motion.retarget_cycle import Track, cycle_displacement
from fastmimic.motion.retarget_gait import GaitChanges
from fastmimic.motion.retarget_pose import Pose
from fastmimic.motion.retarget_report import Bound, RetargetReport
from fastmimic.motion.retarget_source import Source
from fastmimic.robot import Robot
from fastmimic.rotations import rotate_planar, yaw_from_quat

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Before:
    """What the report needs from the steps of retargeting besides their results.

    Attributes:
        scale: animal's to robot's size.
        duration_s: of the clip.
        cycle_reason: how it was decided whether the clip is a cycle.
        aligned: angle by which the heading was turned, rad.
        raw_w: (t, 4, 3) foot paths before planting; z is the height above the ground.
        stances: contacts as detected.
        offset: (4, 2) constant shifts of the feet against the hips, m.
        changes: made to the contacts.
        smoothed: times that each leg's swings were smoothed further.
    """

    scale: float
    duration_s: float
    cycle_reason: str
    aligned: float
    raw_w: Array
    stances: Stances
    offset: Array
    changes: GaitChanges
    smoothed: tuple[int, int, int, int]


def make_report(
    motion: Motion, robot: Robot, source: Source, track: Track, stances: Stances, pose: Pose, before: Before
) -> RetargetReport:
    """The figures of one retargeting."""
    heading = np.unwrap(yaw_from_quat(motion.root_quat_wxyz))
    n, periodic = motion.n_samples, track.cycle is not None
    feet = measure.feet_in_world(motion)
    planar = np.linalg.norm((feet - before.raw_w)[..., :2], axis=-1)
    speed_before, yaw_before = _travel_of_source(source, periodic)
    zero = measure.Closure(0.0, 0.0)
    closed_before = measure.closure_of_source(source) if periodic else zero
    closed_after = measure.closure_of_motion(motion, track) if periodic else zero
    peak = np.abs(motion.joint_vel).reshape(n, 4, 3).max(axis=(0, 1))
    figures = {
        "slip_before_m": _four(measure.slip(before.raw_w, track, stances)),
        "slip_after_m": _four(measure.slip(feet, track, stances)),
        "closure_before_m": closed_before.distance_m,
        "closure_after_m": closed_after.distance_m,
        "closure_before_deg": closed_before.angle_deg,
        "closure_after_deg": closed_after.angle_deg,
        "duty_before": _four(duty_factors(before.stances, n)),
        "duty_after": _four(duty_factors(stances, n)),
        "speed_before_m_per_s": speed_before,
        "speed_after_m_per_s": measure.mean_speed(motion.root_lin_vel_w[:, :2], heading),
        "yaw_before_deg": float(np.degrees(yaw_before)),
        "yaw_after_deg": float(np.degrees(track.cycle[2] if track.cycle is not None else heading[-1] - heading[0])),
        "clearance_before_m": _four(measure.mean_clearance(track.toe_height, stances, periodic)),
        "clearance_after_m": _four(measure.mean_clearance(feet[..., 2] - robot.foot_radius, stances, periodic)),
        "unreachable": tuple(int(x) for x in pose.unreachable.sum(axis=0)),
        "joint_limited": tuple(int(x) for x in pose.limited.reshape(n, 4, 3).any(axis=1).sum(axis=0)),
        "joint_speed_peak": tuple(float(x) for x in peak),
        "joint_speed_limit": tuple(float(x) for x in robot.joint_speed_limit.reshape(4, 3).min(axis=0)),
    }
    report = RetargetReport(
        scale=before.scale,
        is_cycle=periodic,
        cycle_reason=before.cycle_reason,
        period_before_s=before.duration_s,
        period_after_s=motion.period_s,
        stances=tuple(len(leg) for leg in stances),  # type: ignore[arg-type]
        pairing=before.changes.pairing,
        common_duty=before.changes.common_duty,
        closed_flights=before.changes.closed_flights,
        widened_swings=before.changes.widened_swings,
        support_share=measure.support_shares(motion.contact),  # type: ignore[arg-type]
        foot_path_rms_m=_four(np.sqrt((planar**2).mean(axis=0))),
        foot_offset_m=_four(np.array([*before.offset[[1, 3], 0], *before.offset[[1, 3], 1]])),
        base_height_m=float(motion.root_pos_w[:, 2].mean()),
        lowered_m=pose.lowered_m,
        samples=n,
        smoothed_legs=before.smoothed,
        heading_aligned_deg=float(np.degrees(before.aligned)),
        bounds=(),
        **figures,  # type: ignore[arg-type]
    )
    return bounds.with_bounds(report)


def _travel_of_source(source: Source, periodic: bool) -> tuple[float, float]:
    """Mean speed and heading change of the scaled animal, over one cycle or from the first frame to the last."""
    steps = np.diff(source.root_xy, axis=0)
    middle = 0.5 * (source.heading[1:] + source.heading[:-1])
    local = rotate_planar(-middle, steps)
    if periodic:
        local = np.concatenate([local, 0.5 * (local[:1] + local[-1:])])
    turn = cycle_displacement(source)[2] if periodic else source.heading[-1] - source.heading[0]
    return measure.mean_speed(local * source.rate_hz, np.zeros(len(local))), float(turn)


def _four(values: Array) -> tuple[float, float, float, float]:
    a, b, c, d = (float(x) for x in values)
    return a, b, c, d
