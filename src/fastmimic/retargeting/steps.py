"""The steps of retargeting, on one object, up to the robot's kinematic motion: feet planted, joints in their ranges."""

from dataclasses import replace
from typing import Final

import numpy as np

from fastmimic.base.arrays import Array
from fastmimic.base.rotations import quat_rotate_inverse, rotate_planar
from fastmimic.clips.clip import Clip
from fastmimic.motion.contacts import contact_mask, detect, foot_activity
from fastmimic.retargeting.config import RetargetConfig
from fastmimic.retargeting.contact_schedule import ScheduleChanges, make_consistent, with_steps
from fastmimic.retargeting.feet import MIN_CLEARANCE_SHARE, Reach, foot_offsets, footholds, plant_feet
from fastmimic.retargeting.pose import folding_rise, motion_of, solve_pose
from fastmimic.retargeting.track import ScaledClip, cycle_displacement, extract, pose_mismatch, step_times, track_of
from fastmimic.robot import Robot
from fastmimic.robot.robot import length_ratio

DOG_SCALE: Final = 0.825  # the A1's size over the dog's (Peng et al. 2020)
_END_S: Final = 0.1  # final part that shows whether a recording comes to rest
_SAME_BODY_M: Final = 2e-3
_EXACT_FEET: Final = 0.2

# For recordings that do not repeat; m, at the A1's size
_TALL_M: Final = 0.03  # frames this much lower than the tallest have 1/e of its weight
_ROOM_M: Final = 0.05
"""Added to the shortest leg: a folded leg's foot stands ahead of the hip or behind it, and its knee off the ground."""
_SOFT_M: Final = 0.02  # range of the smooth blend to the lowest height


class Retargeting:
    """State of one clip's retargeting. Each method is a step and relies on the previous ones.

    `source` is the animal at the robot's size, as prepared so far; `periodic` and `cycle_reason` whether the clip is a
    cycle, and why; `straight` whether the gait is straight ahead; `aligned` the angle by which the heading was turned,
    rad; `own_body` whether the clip is this robot's own motion. The base is `lowered` and `raised` against the
    animal's height, m, and at `height`, m; the last pose is `held` for so many frames. The motion has `n` samples of
    the clip's `duration`, s; `activity` and `detected` (n, 4) are the feet's, and their contacts; `track` has trunk
    and toes on its grid; `stances` and `changes` are the contact schedule and its changes; `offset` (4, 2) constant
    shifts of the feet against the hips, m; `raw_w` (n, 4, 3) the animal's foot paths under the track, world, with z
    the height above the ground, m; `pose` and `motion` (without provenance) the robot's with its feet planted.
    """

    def __init__(
        self, clip: Clip, robot: Robot, rate_hz: float, scale: float, cycle: bool | None, config: RetargetConfig
    ) -> None:
        self.clip, self.robot, self.rate_hz, self.scale = clip, robot, rate_hz, scale
        self.source = extract(clip, scale, config.roll_share)
        self.own_body = _is_own_body(clip, robot, scale)
        self.config, self.lowered = config, config.crouch_m * scale / DOG_SCALE
        if self.own_body:  # it keeps its height, and its feet are known exactly
            enter, leave = _EXACT_FEET * config.contact.enter, _EXACT_FEET * config.contact.leave
            contact = replace(config.contact, enter=enter, leave=leave)
            self.config, self.lowered = replace(config, contact=contact, max_raising_m=0.0), 0.0
        self.periodic, self.cycle_reason = whether_cycle(self.clip, self.source, cycle, self.config)

    def prepare_source(self) -> None:
        """Turns the trunk of a cycle into its direction of travel if the gait is straight; keeps a recording that does
        not repeat as high as folded legs need, and lengthens it by its last pose if it ends standing."""
        self.straight, self.aligned, self.held = False, 0.0, 0
        if not self.config.consistent:
            return
        if self.periodic:
            angle = _travel_angle(self.source, self.config)
            if angle is not None:
                self.source, self.straight, self.aligned = self.source.turned(angle), True, angle
            return
        if not self.own_body:
            self.source = within_folded_legs(self.source, self.robot, self.lowered, self.config)
        self.held = _held_frames(self.source, self.config)
        if self.held:
            self.source = self.source.held(self.held)
            self.cycle_reason += f"; ends standing, and is held for {self.held / self.clip.rate_hz:.2g} s"

    def make_track(self) -> None:
        """Makes the continuous motion, and detects its contacts."""
        config = self.config
        frames = self.clip.n_frames if self.periodic else self.clip.n_frames + self.held - 1
        self.duration = frames / self.clip.rate_hz
        self.n = max(2, round(self.duration * self.rate_hz))
        self.activity = self._activity()
        self.detected = detect(self.activity, self.rate_hz, self.periodic, config.contact)
        displacement = cycle_displacement(self.source) if self.periodic else None
        if self.periodic and config.consistent and all(leg and leg[0].duration >= self.n for leg in self.detected):
            displacement = np.zeros(3)  # no foot ever lifts off
        self.track = track_of(self.source, self.n, config.trunk_hz, config.foot_hz, displacement)

    def change_velocity(self, velocity: Array) -> None:
        """Changes a cycle's mean velocity (3,): forwards, to the left, m/s, turning, rad/s. Its contacts stay."""
        steps = step_times(self.stances, self.n)
        self.track = self.track.at_twist(velocity * self.duration, steps, self.robot.hip_pos_b[:, :2])

    def _activity(self) -> Array:
        """The feet's activity (n, 4), linear between frames."""
        source = self.source
        frames = foot_activity(source.toe_height, source.toe_speed, source.rate_hz, self.periodic, self.config.contact)
        if self.periodic:
            frames = np.concatenate([frames, frames[:1]])
        at = np.arange(self.n) * (len(frames) - 1) / self.n
        return np.stack([np.interp(at, np.arange(len(frames)), leg) for leg in frames.T], axis=-1)

    def choose_height(self) -> None:
        """Sets the base's nominal height. A cycle is raised as a whole for folded legs."""
        config = self.config
        self.height = self.source.hip_height + self.robot.foot_radius - self.lowered
        self.raised = 0.0
        if self.periodic and config.consistent and config.max_raising_m > 0:
            lift = max(config.swing.min_clearance_m, MIN_CLEARANCE_SHARE * float(self.track.toe_height.max()))
            self.raised = max(0.0, lift - self._reach().clearance)
        self.height += self.raised

    def _reach(self) -> Reach:
        return Reach.of_robot(self.robot, self.height, self.config.reach_margin_rad)

    def schedule_contacts(self) -> None:
        """Makes the contact schedule that a robot can follow."""
        self.stances, self.changes = self.detected, ScheduleChanges()
        if not self.config.consistent:
            return
        n, config = self.n, self.config
        speed = float(np.linalg.norm(np.diff(self.track.root_xy, axis=0), axis=1).sum() / self.duration)
        longest = self._reach().longest_stance(speed, config.swing.linger_s)
        self.stances, self.changes = make_consistent(
            self.detected, n, self.rate_hz, self.periodic, self.straight, longest, config.schedule
        )
        if self.periodic:
            hips = self.track.root_xy[0] + rotate_planar(self.track.heading[0], self.robot.hip_pos_b[:, :2])
            travel = np.asarray(np.linalg.norm(self.track.moved(hips, 1) - hips, axis=-1))
            self.stances, steps = with_steps(self.stances, travel, self.activity, self.rate_hz, config.schedule)
            self.changes = replace(self.changes, steps=steps)

    def fit(self) -> None:
        """Plants the feet and solves for the joints; raises the trunk of a motion that does not repeat for its legs."""
        config, track, max_raising = self.config, self.track, 0.0
        self.offset = np.zeros((4, 2))
        if not self.own_body:
            self.offset = foot_offsets(self.robot, track, self.stances, config.stance_width)
        local = self.robot.hip_pos_b[:, :2] + self.offset + track.toe_from_hip
        xy = track.root_xy[:, None] + rotate_planar(track.heading[:, None], local)
        self.raw_w = np.concatenate([xy, track.toe_height[..., None]], axis=-1)
        if not config.consistent:
            feet_w = self.raw_w + np.array([0.0, 0.0, self.robot.foot_radius])
        elif self.periodic:
            feet_w, max_raising = self._planted(), config.max_raising_m
        else:
            rise = folding_rise(self.robot, track, self._planted(), self.height, config, self.rate_hz)
            self.track = replace(track, root_z=track.root_z + rise)
            self.height += float(rise.mean())
            feet_w = self._planted()
        self.pose = solve_pose(self.robot, self.track, feet_w, self.height, config, max_raising)
        self.motion = motion_of(self.pose, self.track, contact_mask(self.stances, self.n), self.rate_hz)

    def _planted(self) -> Array:
        """The feet (n, 4, 3) with their stances held, world, m."""
        reach, swing = self._reach(), self.config.swing
        holds = footholds(self.raw_w, self.track, self.stances, reach, round(swing.linger_s * self.rate_hz))
        highest, ground_z = reach.clearance, self.robot.foot_radius
        return plant_feet(self.raw_w, self.track, self.stances, holds, highest, ground_z, self.rate_hz, swing)


def whether_cycle(clip: Clip, source: ScaledClip, cycle: bool | None, config: RetargetConfig) -> tuple[bool, str]:
    """Whether a clip is one cycle, and why; `cycle` is the user's answer or None."""
    if cycle is not None:
        return cycle, "taken as one cycle, as asked" if cycle else "not a cycle, as asked"
    if clip.is_cycle is not None:
        return clip.is_cycle, "one cycle, as the clip says" if clip.is_cycle else "not a cycle, as the clip says"
    seconds = clip.n_frames / clip.rate_hz
    if seconds > config.longest_cycle_s:
        return False, f"a passage that is run once ({seconds:.1f} s; cycles are up to {config.longest_cycle_s:g} s)"
    mismatch = pose_mismatch(source)
    limit = config.short_mismatch if seconds < config.short_s else config.cycle_mismatch
    found = f"its ends differ by {mismatch:.2f} of the spread of its poses; limit {limit:.2f} for this length"
    closes = mismatch <= limit
    return closes, f"taken as one cycle ({found})" if closes else f"not a cycle ({found})"


def _held_frames(source: ScaledClip, config: RetargetConfig) -> int:
    """Number of frames for which the last pose is held: 0 unless the recording ends at rest on all feet."""
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
    legs, last = detect(activity, held.rate_hz, False, config.contact), len(source.heading) - 1
    stands = all(leg and leg[-1].lift_off == len(held.heading) and leg[-1].touch_down <= last for leg in legs)
    return frames if stands else 0


def _travel_angle(source: ScaledClip, config: RetargetConfig) -> float | None:
    """Angle, rad, from the mean heading to the direction of travel, or its opposite; None if not straight."""
    dx, dy, dyaw = cycle_displacement(source)
    speed = np.hypot(dx, dy) * source.rate_hz / len(source.heading)
    if abs(dyaw) >= np.radians(config.straight_yaw_deg) or speed < config.min_travel_m_per_s:
        return None
    travel = np.arctan2(dy, dx) - (source.heading.mean() - source.heading[0])
    backward = abs(travel) > np.pi / 2
    angle = float(travel - np.sign(travel) * np.pi if backward else travel)
    return angle if abs(angle) < np.radians(config.straight_travel_deg) else None


def _is_own_body(clip: Clip, robot: Robot, scale: float) -> bool:
    """Whether the clip is this robot's own motion: its hips are at the robot's hip positions."""
    if clip.root_quat_wxyz is None:
        return False
    centre = clip.hips_w.mean(axis=1, keepdims=True)
    hips = scale * quat_rotate_inverse(clip.root_quat_wxyz[:, None], clip.hips_w - centre)
    return bool(np.abs(hips - (robot.hip_pos_b - robot.hip_pos_b.mean(axis=0))).max() < _SAME_BODY_M)


def within_folded_legs(source: ScaledClip, robot: Robot, lowered_m: float, config: RetargetConfig) -> ScaledClip:
    """A recording that does not repeat, in postures that a robot can take; its base is `lowered_m` below the animal's.

    A cycle has one posture; sitting down or getting up has two or more, and the tallest counts as level. Shoulders and
    hips go no lower than folded legs allow with feet lifted as high as the animal's: an animal sits on its rump, a
    robot on its feet. The trunk is raised as a whole, and levelled where its other end would be above standing height.
    """
    size = length_ratio(robot)
    weight = np.exp((source.root_z - source.root_z.max()) / (_TALL_M * size))
    source = replace(source, tilt=source.tilt - weight @ source.tilt / weight.sum())
    mean = float(source.root_z.mean())
    height = source.hip_height + source.root_z - mean - lowered_m  # of the hips' middle above the ground
    shortest = Reach.of_robot(robot, 0.0, config.reach_margin_rad).shortest
    lift = np.maximum(MIN_CLEARANCE_SHARE * source.toe_height, config.swing.min_clearance_m)
    x = robot.hip_pos_b[:, 0].reshape(2, 2).mean(axis=1)  # of shoulders and hips
    slope = -np.sin(source.tilt[:, 1])
    girdle = height[:, None] + slope[:, None] * x
    least = shortest + _ROOM_M * size + lift.reshape(-1, 2, 2).max(axis=2)
    rise = (_no_lower(girdle, least, _SOFT_M * size) - girdle).max(axis=1, keepdims=True)
    raised = -_no_lower(-(girdle + rise), -np.maximum(height.max(), least), _SOFT_M * size)
    raised = np.where(rise > 0, raised, girdle)
    new_slope = slope + ((raised - girdle) @ np.array([1.0, -1.0])) / (x[0] - x[1])
    rise = (raised - girdle)[:, 0] - (new_slope - slope) * x[0]
    changed = np.any(raised != girdle, axis=1)
    pitch = np.where(changed, -np.arcsin(np.clip(new_slope, -1.0, 1.0)), source.tilt[:, 1])
    root_z = source.root_z + np.where(changed, rise, 0.0)
    hip_height = source.hip_height + float(root_z.mean()) - mean
    return replace(source, root_z=root_z, tilt=np.stack([source.tilt[:, 0], pitch], axis=-1), hip_height=hip_height)


def _no_lower(value: Array, least: Array, soft: float) -> Array:
    """The greater of the two, with a smooth blend of ± `soft` m between them."""
    above = value - least
    passage = least + (above + soft) ** 2 / (4 * soft)
    return np.where(above >= soft, value, np.where(above <= -soft, least, passage))
