"""Retargeting: an animal's clip becomes a consistent reference motion of a robot.

After Peng et al. 2020 (section IV), then made consistent; one rule for every clip. The steps, each in its own module:

    retarget_source    keypoints → trunk and toe targets at the robot's size
    retarget_posture   of a recording that does not repeat, as low as folded legs allow
    retarget_cycle     the recording as a continuous motion, closed if it is a cycle
    contacts           when each foot stands; retarget_gait makes a clean gait of it
    retarget_reach     where the feet can stand; retarget_feet plants them there and blends their swings
    retarget_balance   the trunk as the standing feet can move it; retarget_dynamics says what they must push
    retarget_pose      inverse kinematics, limits and velocities; retarget_fit calls these four
    retarget_fidelity  what changed, as a retarget_report
"""

from dataclasses import replace
from typing import Final

import numpy as np

from fastmimic.base.arrays import Array
from fastmimic.base.errors import ClipError, ConfigError
from fastmimic.base.rotations import quat_rotate_inverse, rotate_planar
from fastmimic.clips.clip import Clip
from fastmimic.motion.contacts import ContactConfig, Stances, detect, foot_activity
from fastmimic.motion.motion import Motion
from fastmimic.retargeting.config import RetargetConfig
from fastmimic.retargeting.contact_schedule import GaitChanges, make_consistent, with_steps
from fastmimic.retargeting.cycle import TrunkTrack, cycle_displacement, pose_mismatch, track_cycle, track_open
from fastmimic.retargeting.fidelity import Before, make_report
from fastmimic.retargeting.fit import Fitter
from fastmimic.retargeting.posture import levelled, within_folded_legs
from fastmimic.retargeting.reach import Reach, foot_offsets
from fastmimic.retargeting.report import MIN_CLEARANCE_SHARE, RetargetReport
from fastmimic.retargeting.scaled_clip import ScaledClip, extract
from fastmimic.robot import Robot

__all__ = ["RetargetConfig", "RetargetReport", "choose_scale", "retarget"]


DOG_SCALE: Final = 0.825
"""The A1's size over the dog's (Peng et al. 2020)."""
DOG_LEG_LENGTH_M: Final = 0.4 / DOG_SCALE
"""Leg length that this scale implies for an animal whose own is not known, so that other robots scale by theirs."""
MIN_FRAMES: Final = 8
_END_S: Final = 0.1
"""Of a recording, over which is judged whether it comes to rest."""
_SAME_BODY_M: Final = 2e-3
_EXACT_FEET: Final = 0.2


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
        scale: animal's to robot's size; if None the clip's own, else the ratio of leg lengths (0.825 for a dog on the
            A1).
        cycle: whether the clip is one period; if None what the clip says, else whether it closes.
        config: settings, `RetargetConfig()` if None.

    Returns:
        The motion and what was changed. `motion.meta` holds `name`, `robot`, `source`, `licence` and `retarget` (the
        report).

    Raises:
        ConfigError: rate or scale not positive.
        ClipError: the clip is too short.
    """
    config = config or RetargetConfig()
    _check(clip, rate_hz, scale)
    scale = choose_scale(clip, robot) if scale is None else float(scale)
    source = extract(clip, scale, config.roll_share)
    periodic, cycle_reason = _decide_cycle(clip, source, cycle, config)
    source, straight, aligned = _align(source, periodic and config.consistent, config)
    own = _is_own_body(clip, robot, scale)
    if own:
        config = _for_own_body(config)
    lowered = 0.0 if own else config.crouch_m * scale / DOG_SCALE
    if not periodic and config.consistent and not own:
        source = within_folded_legs(levelled(source), robot, lowered, config)
    held = 0 if periodic or not config.consistent else _held_frames(source, config)
    if held:
        source = source.held(held)
        cycle_reason += f"; ends standing, and is held for {held / clip.rate_hz:.2g} s"
    duration = (clip.n_frames if periodic else clip.n_frames + held - 1) / clip.rate_hz
    n = max(2, round(duration * rate_hz))
    activity = _activity(source, n, periodic, config.contact)
    detected = detect(activity, rate_hz, periodic, config.contact)
    travels = not (config.consistent and _stands(detected, n))
    if periodic:
        track = track_cycle(source, n, config.trunk_hz, config.foot_hz, travels=travels)
    else:
        track = track_open(source, n, config.trunk_hz, config.foot_hz)

    height = source.hip_height + robot.foot_radius - lowered
    raised = _raise(Reach.of_robot(robot, height, config.reach_margin_rad), track, config) if periodic else 0.0
    height += raised
    reach = Reach.of_robot(robot, height, config.reach_margin_rad)
    longest = reach.longest_stance(_speed(track, duration), config.swing.linger_s)
    if config.consistent:
        stances, changes = make_consistent(detected, n, rate_hz, periodic, straight, longest, config.gait)
        if periodic:
            stances, steps = with_steps(stances, _travel(robot, track), activity, rate_hz, config.gait)
            changes = replace(changes, steps=steps)
    else:
        stances, changes = detected, GaitChanges(None, False, 0, 0)
    offset = np.zeros((4, 2)) if own else foot_offsets(robot, track, stances, config.stance_width)
    fitted = Fitter(robot, track, stances, height, rate_hz, config).fit(offset)

    before = Before(scale, duration, cycle_reason, aligned, track, detected, offset, changes, raised)
    report = make_report(fitted, robot, source, stances, before)
    meta = {
        "name": clip.meta.get("name", "motion"),
        "robot": robot.name,
        "source": {k: v for k, v in clip.meta.items() if k not in ("name", "licence")},
        "licence": clip.meta.get("licence"),
        "retarget": report.as_dict(),
    }
    if held:
        meta["held_s"] = held / clip.rate_hz
    return replace(fitted.motion, meta=meta), report


def choose_scale(clip: Clip, robot: Robot) -> float:
    """The clip's own scale, else the ratio of leg lengths; an animal of unknown legs is taken for the dog of
    `DOG_SCALE`."""
    if clip.scale is not None:
        return float(clip.scale)
    return robot.leg_length / (clip.leg_length_m if clip.leg_length_m is not None else DOG_LEG_LENGTH_M)


def _check(clip: Clip, rate_hz: float, scale: float | None) -> None:
    if not (np.isfinite(rate_hz) and rate_hz > 0):
        raise ConfigError(f"the rate of a motion must be positive, found {rate_hz} Hz")
    if scale is not None and not (np.isfinite(scale) and scale > 0):
        raise ConfigError(f"the scale must be positive, found {scale}")
    if clip.n_frames < MIN_FRAMES:
        raise ClipError(f"retargeting needs at least {MIN_FRAMES} frames, found {clip.n_frames}; choose a longer cut")


def is_one_cycle(clip: Clip, config: RetargetConfig | None = None) -> bool:
    """Whether a clip is taken for one cycle if nothing else is asked: if it says so, or if its ends meet."""
    config = config or RetargetConfig()
    return _decide_cycle(clip, extract(clip, clip.scale or 1.0, config.roll_share), None, config)[0]


def _decide_cycle(clip: Clip, source: ScaledClip, cycle: bool | None, config: RetargetConfig) -> tuple[bool, str]:
    if cycle is not None:
        return cycle, "taken as one cycle, as asked" if cycle else "not a cycle, as asked"
    if clip.is_cycle is not None:
        return clip.is_cycle, "one cycle, as the clip says" if clip.is_cycle else "not a cycle, as the clip says"
    mismatch = pose_mismatch(source)
    short = clip.n_frames / clip.rate_hz < config.short_s
    limit = config.short_mismatch if short else config.cycle_mismatch
    found = f"its ends differ by {mismatch:.2f} of the spread of its poses; limit {limit:.2f} for this length"
    closes = mismatch <= limit
    return closes, f"taken as one cycle ({found})" if closes else f"not a cycle ({found})"


def _held_frames(source: ScaledClip, config: RetargetConfig) -> int:
    """For how many frames the last pose of a recording that does not repeat is held: none unless it ends standing, on
    all feet and with its trunk at rest."""
    end = slice(-1 - max(1, round(_END_S * source.rate_hz)), None)
    seconds = (len(source.heading[end]) - 1) / source.rate_hz
    moved = np.linalg.norm(source.root_xy[end][-1] - source.root_xy[end][0]) / seconds
    sunk = abs(source.root_z[end][-1] - source.root_z[end][0]) / seconds
    turned = abs(source.heading[end][-1] - source.heading[end][0]) / seconds
    frames = round(config.hold_s * source.rate_hz)
    if max(moved, sunk) > config.rest_m_per_s or turned > config.rest_rad_per_s or frames < 1:
        return 0
    held = source.held(frames)
    activity = foot_activity(held.toe_height, held.toe_speed, held.rate_hz, False, config.contact)
    stands = all(
        leg and leg[-1].lift_off == len(held.heading) and leg[-1].touch_down <= len(source.heading) - 1
        for leg in detect(activity, held.rate_hz, False, config.contact)
    )
    return frames if stands else 0


def _align(source: ScaledClip, periodic: bool, config: RetargetConfig) -> tuple[ScaledClip, bool, float]:
    """Turns the trunk into the direction of travel if the gait is straight; returns source, straightness, angle in
    rad."""
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


def _activity(source: ScaledClip, n: int, periodic: bool, config: ContactConfig) -> Array:
    """The animal's feet's activity (n, 4) on the output grid; between frames it is linear."""
    frames = foot_activity(source.toe_height, source.toe_speed, source.rate_hz, periodic, config)
    if periodic:
        frames = np.concatenate([frames, frames[:1]])
    at = np.arange(n) * (len(frames) - 1) / n
    return np.stack([np.interp(at, np.arange(len(frames)), leg) for leg in frames.T], axis=-1)


def _stands(stances: Stances, n: int) -> bool:
    """Whether no foot ever lifts off."""
    return all(leg and leg[0].duration >= n for leg in stances)


def _travel(robot: Robot, track: TrunkTrack) -> Array:
    """How far each hip (4,) is from where it is a cycle later, m."""
    hips = track.root_xy[0] + rotate_planar(track.heading[0], robot.hip_pos_b[:, :2])
    return np.asarray(np.linalg.norm(track.moved(hips, 1) - hips, axis=-1))


def _is_own_body(clip: Clip, robot: Robot, scale: float) -> bool:
    """Whether the clip is this robot's own motion: its hips are where the robot's are."""
    if clip.root_quat_wxyz is None:
        return False
    centre = clip.hips_w.mean(axis=1, keepdims=True)
    hips = scale * quat_rotate_inverse(clip.root_quat_wxyz[:, None], clip.hips_w - centre)
    return bool(np.abs(hips - (robot.hip_pos_b - robot.hip_pos_b.mean(axis=0))).max() < _SAME_BODY_M)


def _for_own_body(config: RetargetConfig) -> RetargetConfig:
    """A robot's own motion has its own height and balance, and its feet are known more exactly than an animal's
    paws."""
    contact = replace(
        config.contact, enter=_EXACT_FEET * config.contact.enter, leave=_EXACT_FEET * config.contact.leave
    )
    return replace(config, contact=contact, balance=replace(config.balance, rounds=0), max_raising_m=0.0)


def _raise(reach: Reach, track: TrunkTrack, config: RetargetConfig) -> float:
    """How much the base must be higher for its folded legs to fit under it and be lifted, m: an animal sits and
    crouches lower than a robot's knees bend."""
    if not config.consistent or config.max_raising_m == 0:
        return 0.0
    lift = max(config.swing.min_clearance_m, MIN_CLEARANCE_SHARE * float(track.toe_height.max()))
    return max(0.0, lift - reach.clearance)


def _speed(track: TrunkTrack, duration_s: float) -> float:
    """Mean horizontal speed along the trunk's path, m/s."""
    return float(np.linalg.norm(np.diff(track.root_xy, axis=0), axis=1).sum() / duration_s)
