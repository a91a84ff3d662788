"""Retargeting: an animal's clip becomes a consistent reference motion of a robot (Peng et al. 2020, then made consistent).

One rule for every clip. The steps, each in its own module: keypoints to trunk and toe targets at the robot's size (`retarget_source`);
the recording as a continuous motion, closed if it is a cycle (`retarget_cycle`); contacts (`contacts`) and the gait
that they make (`retarget_gait`); feet planted in stance and blended through swing (`retarget_feet`); inverse
kinematics within the limits (`retarget_pose`); what changed (`retarget_report`).
"""

from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from fastmimic.conventions import LEFT
from fastmimic.errors import ClipError, ConfigError
from fastmimic.motion.clip import Clip
from fastmimic.motion.contacts import (
    ContactConfig,
    Stances,
    contact_mask,
    detect,
    foot_activity,
)
from fastmimic.motion.motion import Motion
from fastmimic.motion.retarget_balance import BalanceConfig, balance
from fastmimic.motion.retarget_cycle import Track, cycle_displacement, pose_mismatch, track_cycle, track_open
from fastmimic.motion.retarget_dynamics import Demand, ground_demand
from fastmimic.motion.retarget_fidelity import Before, make_report
from fastmimic.motion.retarget_feet import Reach, SwingConfig, footholds, plant_feet
from fastmimic.motion.retarget_gait import GaitConfig, make_consistent
from fastmimic.motion.retarget_pose import Pose, joint_velocity, root_velocity, solve_pose, unlimited_pose
from fastmimic.motion.retarget_report import RetargetReport
from fastmimic.motion.retarget_spline import TrunkSpline
from fastmimic.motion.retarget_source import Source, extract
from fastmimic.robot import Robot
from fastmimic.rotations import quat_rotate_inverse, rotate_planar

Array = NDArray[np.float64]

DOG_SCALE: Final = 0.825
"""The A1's size over the dog's (Peng et al. 2020)."""
DOG_LEG_LENGTH_M: Final = 0.4 / DOG_SCALE
"""Leg length that this scale implies for an animal whose own is not known, so that other robots scale by theirs."""

MIN_FRAMES: Final = 8
REACH_MARGIN_RAD: Final = 0.1
MORE_EVEN: Final = (0.1, 0.4, 1.6, 6.4)
"""Evenness of the swings of a leg whose joints are too fast, tried one after the other."""


@dataclass(frozen=True)
class RetargetConfig:
    """Settings of retargeting; the defaults serve all clips and robots.

    Attributes:
        trunk_hz: half-power frequency of the trunk's low-pass. A trot's bounce is at 3.6 Hz, a canter's pitch at 2 Hz; above 6 Hz the
            spectra of the dog's trunk are flat marker noise, which differentiation would make the largest part of the angular velocity.
        foot_hz: the same for the toes.
        roll_share: share of the shoulders' and hips' roll that the trunk takes. The published retargeting levels the lateral axis
            before it builds the rotation, which leaves half: girdles roll more than the trunk between them.
        stance_width: lateral distance of the mean footholds from the abduction axis, as a share of the robot's lateral link.
        crouch_m: how much lower than the scaled hips the base is at the A1's size. The published base lies 0.06 m below the scaled
            neck–pelvis line, which is 0.045 m above the hips.
        max_lowering_m: further lowering for reach, at most.
        limit_margin_rad: kept to the joint limits.
        speed_share: of the joint speed limit that the reference may use.
        straight_yaw_deg, straight_travel_deg: a gait is straight if it turns less than the first a cycle and travels within the
            second of its heading; only then the heading is turned into the direction of travel.
        min_travel_m_per_s: slower motions have no direction of travel.
        cycle_mismatch: a clip of which nothing is known is a cycle if it closes better than this (see `pose_mismatch`).
        contact, gait, swing: settings of these steps.
    """

    trunk_hz: float = 6.0
    foot_hz: float = 12.0
    roll_share: float = 0.5
    stance_width: float = 0.59
    crouch_m: float = 0.04
    max_lowering_m: float = 0.05
    limit_margin_rad: float = 0.02
    speed_share: float = 0.95
    straight_yaw_deg: float = 10.0
    straight_travel_deg: float = 15.0
    min_travel_m_per_s: float = 0.2
    cycle_mismatch: float = 0.6
    contact: ContactConfig = field(default_factory=ContactConfig)
    gait: GaitConfig = field(default_factory=GaitConfig)
    swing: SwingConfig = field(default_factory=SwingConfig)
    balance: BalanceConfig = field(default_factory=BalanceConfig)


def retarget(
    clip: Clip,
    robot: Robot,
    *,
    rate_hz: float = 500.0,
    scale: float | None = None,
    cycle: bool | None = None,
    config: RetargetConfig | None = None,
) -> tuple[Motion, RetargetReport]:
    """Turns an animal's clip into a reference motion of a robot.

    Args:
        clip: the animal's keypoints.
        robot: who is to move like it.
        rate_hz: of the motion; a cycle's period becomes a whole number of samples.
        scale: animal's to robot's size; if None the clip's own, else the ratio of leg lengths (0.825 for the dog on the A1).
        cycle: whether the clip is one period; if None what the clip says, else whether it closes.
        config: settings, `RetargetConfig()` if None.

    Returns:
        The motion and what was changed. `motion.meta` holds `name`, `robot`, `source`, `licence` and `retarget` (the report).

    Raises:
        ConfigError: rate or scale not positive.
        ClipError: too short, or larger or smaller than the robot by so much that the scale must be wrong.
    """
    config = config or RetargetConfig()
    _check(clip, rate_hz, scale)
    scale = choose_scale(clip, robot) if scale is None else float(scale)
    source = extract(clip, scale, config.roll_share)
    periodic, cycle_reason = _decide_cycle(clip, source, cycle, config)
    source, straight, aligned = _align(source, periodic, config)
    duration = (clip.n_frames if periodic else clip.n_frames - 1) / clip.rate_hz
    n = max(2, round(duration * rate_hz))
    track = (track_cycle if periodic else track_open)(source, n, config.trunk_hz, config.foot_hz)

    own = _is_own_body(clip, robot, scale)
    detected = detect(_activity(source, n, periodic, config.contact), rate_hz, periodic, config.contact)
    height = source.hip_height + robot.foot_radius - (0.0 if own else config.crouch_m * scale / DOG_SCALE)
    reach = Reach.of_robot(robot, height, REACH_MARGIN_RAD)
    longest = reach.longest_stance(_speed(track, duration), config.swing.linger_s)
    stances, changes = make_consistent(detected, n, rate_hz, periodic, straight, longest, config.gait)
    offset = np.zeros((4, 2)) if own else foot_offsets(robot, track, stances, config.stance_width)
    height = source.hip_height + robot.foot_radius - (0.0 if own else config.crouch_m * scale / DOG_SCALE)
    raw_w = _raw_feet(robot, track, offset)
    balanced, raw_w = _balance(robot, track, raw_w, stances, height, rate_hz, config)
    pose, smoothed = _fit_within_limits(robot, balanced, raw_w, stances, height, rate_hz, config)
    motion = _motion(pose, balanced, stances, rate_hz)
    before = Before(scale, duration, cycle_reason, aligned, raw_w, detected, offset, changes, smoothed)
    report = make_report(motion, robot, source, balanced, stances, pose, before)
    meta = {
        "name": clip.meta.get("name", "motion"),
        "robot": robot.name,
        "source": {k: v for k, v in clip.meta.items() if k not in ("name", "licence")},
        "licence": clip.meta.get("licence"),
        "retarget": report.as_dict(),
    }
    return replace(motion, meta=meta), report


def _balance(
    robot: Robot, track: Track, raw_w: Array, stances: Stances, height: float, rate_hz: float, config: RetargetConfig
) -> tuple[Track, Array]:
    """The trunk as the standing feet can move it, and the animal's foot paths shifted under it."""
    n = len(track.root_z)
    spline = TrunkSpline(n, rate_hz, track.cycle is not None, config.balance.hz)
    sample = np.arange(0, n, max(1, round(config.balance.sample_s * rate_hz)))
    reach = Reach.of_robot(robot, height, REACH_MARGIN_RAD)
    linger = round(config.swing.linger_s * rate_hz)


    def applied(coefficients: Array) -> tuple[Track, Array]:
        # a constant shift of the trunk over its feet is given to the feet, or a turning robot would travel at another speed
        deviation = spline.values(coefficients)
        shift = deviation[:, :2].mean(axis=0)
        deviation[:, :2] -= shift
        moved_w = raw_w.copy()
        moved_w[..., :2] -= rotate_planar(track.heading, np.broadcast_to(shift, (n, 2)))[:, None]
        return track.deviated(deviation), moved_w

    def demand_of(coefficients: Array) -> Demand:
        moved, moved_w = applied(coefficients)
        holds = footholds(moved_w, track, stances, reach, linger)
        feet_w = plant_feet(moved_w, moved, stances, holds, reach, robot.foot_radius, rate_hz, config.swing)
        pose = unlimited_pose(robot, moved, feet_w, height)
        return ground_demand(robot, _motion(pose, moved, stances, rate_hz), sample)

    return applied(balance(robot, spline, demand_of, config.balance))


def _motion(pose: Pose, track: Track, stances: Stances, rate_hz: float) -> Motion:
    linear, angular = root_velocity(pose, track, rate_hz)
    return Motion(
        rate_hz=rate_hz,
        root_pos_w=pose.root_pos_w,
        root_quat_wxyz=pose.root_quat_wxyz,
        joint_pos=pose.joint_pos,
        joint_vel=joint_velocity(pose.joint_pos, rate_hz, track.cycle is not None),
        foot_pos_b=pose.foot_pos_b,
        contact=contact_mask(stances, len(pose.joint_pos)),
        root_lin_vel_w=linear,
        root_ang_vel_w=angular,
        cycle=track.cycle,
    )


def choose_scale(clip: Clip, robot: Robot) -> float:
    """The clip's own scale, else the ratio of leg lengths; an animal of unknown legs is taken for the dog of the published scale."""
    if clip.scale is not None:
        return float(clip.scale)
    return robot.leg_length / (clip.leg_length_m if clip.leg_length_m is not None else DOG_LEG_LENGTH_M)


def foot_offsets(robot: Robot, track: Track, stances: Stances, stance_width: float) -> Array:
    """Constant shifts (4, 2) of the feet against the robot's hips, m.

    Where shoulder, hip and toe markers sit is the animal's build, not its motion. The mean foothold of each girdle is put where the
    robot stands well: fore-aft so that the mean of all footholds lies under the centre of mass, laterally
    `stance_width` of the lateral link outside the abduction axis. Left and right move alike.
    """
    side = np.where(LEFT, 1.0, -1.0)
    stands = contact_mask(stances, len(track.root_z))
    mean = np.stack([track.toe_from_hip[stands[:, leg], leg].mean(axis=0) if stands[:, leg].any() else np.zeros(2) for leg in range(4)])
    forward = float(mean[:, 0].mean())
    outward = np.repeat((side * mean[:, 1]).reshape(2, 2).mean(axis=1), 2)
    centre = robot.com_b[0] - robot.hip_pos_b[:, 0].mean()
    width = stance_width * np.abs(robot.lateral_offset)
    return np.stack([np.full(4, centre - forward), side * (width - outward)], axis=-1)


def _check(clip: Clip, rate_hz: float, scale: float | None) -> None:
    if not (np.isfinite(rate_hz) and rate_hz > 0):
        raise ConfigError(f"the rate of a motion must be positive, found {rate_hz} Hz")
    if scale is not None and not (np.isfinite(scale) and scale > 0):
        raise ConfigError(f"the scale must be positive, found {scale}")
    if clip.n_frames < MIN_FRAMES:
        raise ClipError(f"retargeting needs at least {MIN_FRAMES} frames, found {clip.n_frames}")


def _decide_cycle(clip: Clip, source: Source, cycle: bool | None, config: RetargetConfig) -> tuple[bool, str]:
    if cycle is not None:
        return cycle, "taken as one cycle, as asked" if cycle else "not a cycle, as asked"
    if clip.is_cycle is not None:
        return clip.is_cycle, "one cycle, as the clip says" if clip.is_cycle else "not a cycle, as the clip says"
    mismatch = pose_mismatch(source)
    closes = mismatch <= config.cycle_mismatch
    found = f"its ends differ by {mismatch:.2f} of the spread of its poses; limit {config.cycle_mismatch:.2f}"
    return closes, f"taken as one cycle ({found})" if closes else f"not a cycle ({found})"


def _align(source: Source, periodic: bool, config: RetargetConfig) -> tuple[Source, bool, float]:
    """Turns the trunk into the direction of travel if the gait is straight; returns source, straightness, angle in rad."""
    if not periodic:
        return source, False, 0.0
    dx, dy, dyaw = cycle_displacement(source)
    speed = np.hypot(dx, dy) * source.rate_hz / len(source.heading)
    if abs(dyaw) >= np.radians(config.straight_yaw_deg) or speed < config.min_travel_m_per_s:
        return source, False, 0.0
    travel = np.arctan2(dy, dx) - (source.heading.mean() - source.heading[0])
    backward = abs(travel) > np.pi / 2
    angle = float(travel - np.sign(travel) * np.pi if backward else travel)
    if abs(angle) >= np.radians(config.straight_travel_deg):
        return source, False, 0.0
    return source.turned(angle), True, angle


def _activity(source: Source, n: int, periodic: bool, config: ContactConfig) -> Array:
    """The feet's activity (n, 4) between the frames, linear."""
    frames = foot_activity(source.toe_height, source.toe_speed, config)
    if periodic:
        frames = np.concatenate([frames, frames[:1]])
    at = np.arange(n) * (len(frames) - 1) / n
    return np.stack([np.interp(at, np.arange(len(frames)), leg) for leg in frames.T], axis=-1)


def _is_own_body(clip: Clip, robot: Robot, scale: float) -> bool:
    """Whether the clip is this robot's own motion: its hips are where the robot's are."""
    if clip.root_quat_wxyz is None:
        return False
    centre = clip.hips_w.mean(axis=1, keepdims=True)
    hips = scale * quat_rotate_inverse(clip.root_quat_wxyz[:, None], clip.hips_w - centre)
    return bool(np.abs(hips - (robot.hip_pos_b - robot.hip_pos_b.mean(axis=0))).max() < 2e-3)


def _speed(track: Track, duration_s: float) -> float:
    """Mean horizontal speed along the trunk's path, m/s."""
    return float(np.linalg.norm(np.diff(track.root_xy, axis=0), axis=1).sum() / duration_s)


def _raw_feet(robot: Robot, track: Track, offset: Array) -> Array:
    """The animal's foot paths (t, 4, 3) under the robot's hips, world; z is the height above the ground."""
    local = robot.hip_pos_b[:, :2] + offset + track.toe_from_hip
    xy = track.root_xy[:, None] + rotate_planar(track.heading[:, None], local)
    return np.concatenate([xy, track.toe_height[..., None]], axis=-1)


def _fit_within_limits(
    robot: Robot,
    track: Track,
    raw_w: Array,
    stances: Stances,
    height: float,
    rate_hz: float,
    config: RetargetConfig,
) -> tuple[Pose, tuple[int, int, int, int]]:
    """Feet and joints; the swings of a leg that would exceed joint speed are smoothed further."""
    reach = Reach.of_robot(robot, height, REACH_MARGIN_RAD)
    holds = footholds(raw_w, track, stances, reach, round(config.swing.linger_s * rate_hz))
    limit = config.speed_share * robot.joint_speed_limit
    evenness = np.full(4, config.swing.evenness)
    times = np.zeros(4, dtype=int)
    for round_ in range(len(MORE_EVEN) + 1):
        feet_w = plant_feet(
            raw_w, track, stances, holds, reach, robot.foot_radius, rate_hz, config.swing, tuple(evenness)
        )
        pose = solve_pose(robot, track, feet_w, height, config.max_lowering_m, config.limit_margin_rad)
        speed = np.abs(joint_velocity(pose.joint_pos, rate_hz, track.cycle is not None))
        too_fast = (speed > limit).reshape(-1, 4, 3).any(axis=(0, 2))
        if round_ == len(MORE_EVEN) or not too_fast.any():
            break
        evenness[too_fast] = MORE_EVEN[round_]
        times[too_fast] += 1
    return pose, (int(times[0]), int(times[1]), int(times[2]), int(times[3]))
