"""The segments of a stitched motion with the blend weights of its parts, and its transitions, which the robot can
execute. Feet planted under the blended trunk are a first guess; optimal control (`fastmimic.trajectory`) finds the
motion nearest to it that joins the two."""

from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from fastmimic.base.arrays import Array, Flags
from fastmimic.base.conventions import LEGS
from fastmimic.base.errors import MotionError
from fastmimic.motion.contacts import Stance, Stances, stances_of
from fastmimic.motion.motion import Motion
from fastmimic.motion.provenance import Span, StitchedSegment
from fastmimic.retargeting.config import RetargetConfig
from fastmimic.retargeting.feet import Reach, footholds, plant_feet
from fastmimic.retargeting.pose import motion_of, pose_at
from fastmimic.retargeting.track import TrunkTrack
from fastmimic.robot import Robot
from fastmimic.stitching.switch import Cycle
from fastmimic.trajectory.executable import executable_between

_KEPT_S: Final = 0.03  # of the motions before and after what is rebuilt
_RATES: Final = {"joint_vel": "joint_pos", "root_lin_vel_w": "root_pos_w"}


@dataclass(frozen=True)
class Layout:
    """The segments of a stitched motion in order of time; `n` samples in all."""

    segments: tuple[StitchedSegment, ...]
    n: int

    @classmethod
    def of(cls, motion: Motion) -> "Layout":
        """The layout of a motion; `MotionError` if the motion is not stitched or does not fit."""
        layout = cls(motion.provenance.stitched.segments, motion.n_samples)
        parts, last = motion.target.parts, 0
        for s in layout.segments:
            if not 0 <= s.part < len(parts) or not s.first == last < s.last:
                raise MotionError(f"motion '{motion.name}': segment '{s.name}' does not fit its parts or length")
            last = s.last
        if last != motion.n_samples:
            raise MotionError(f"motion '{motion.name}': its segments do not cover all of it")
        return layout

    def trunk_weights(self) -> Array:
        """Share (s, n) of each segment in the trunk's motion; the sum is 1."""
        steps = [np.ones(self.n)]
        steps += [s.trunk.smooth_step(np.arange(self.n)) for s in self.segments if s.trunk is not None]
        return _shares(np.stack(steps))

    def foot_weights(self) -> Array:
        """Share (s, n, 4) of each segment in each foot's motion; the sum is 1."""
        t, feet = np.arange(self.n), [s.feet for s in self.segments if s.feet is not None]
        steps = [np.ones((self.n, 4)), *(np.stack([leg.smooth_step(t) for leg in legs], axis=-1) for legs in feet)]
        return _shares(np.stack(steps))


def too_short(segment: StitchedSegment) -> MotionError:
    said = f"segment '{segment.name}' with {segment.cycles} cycles is too short for its transitions"
    return MotionError(f"{said}; give it more cycles")


def _shares(steps: Array) -> Array:
    """Each segment's own step minus that of the next."""
    return steps - np.concatenate([steps[1:], np.zeros_like(steps[:1])])


def make_transition(
    robot: Robot,
    layout: Layout,
    index: int,
    track: TrunkTrack,
    raw_w: Array,
    contact: Flags,
    own: tuple[Cycle, Cycle],
    rate_hz: float,
    config: RetargetConfig,
) -> tuple[Span, dict[str, Array], dict[str, Any]]:
    """Rebuilds the samples between segments `index` − 1 and `index`. `track` is the blended trunk of the whole, `raw_w`
    (n, 4, 3) are the feet under it, world, m (z of their centres), and `own` the cycles of the two motions. Returns the
    samples of the whole, their arrays by the names of `Motion`, and figures of the transition. Raises `MotionError` if
    a foot that never lifts off would have to move, or a segment is too short."""
    window, rebuilt, planned, fixed = _plan(layout, index, contact, own, round(_KEPT_S * rate_hz))
    part = slice(window.start, window.end)
    names = ("root_xy", "root_z", "heading", "tilt", "toe_from_hip", "toe_height")
    local = TrunkTrack(**{name: getattr(track, name)[part] for name in names}, cycle=None)
    height = float(local.root_z.mean())
    reach = Reach.of_robot(robot, height, config.reach_margin_rad)
    raw = np.array(raw_w[part])
    raw[..., 2] = np.maximum(raw[..., 2] - robot.foot_radius, 0.0)

    holds = footholds(raw, local, planned, reach, round(config.swing.linger_s * rate_hz))
    for leg in range(4):
        for k, at in enumerate(fixed[leg]):
            if at is not None:
                holds[leg][k] = raw_w[min(max(at, 0), layout.n - 1), leg, :2]
    feet = plant_feet(raw, local, planned, holds, reach.clearance, robot.foot_radius, rate_hz, config.swing)
    for leg, span in enumerate(rebuilt):  # the rest stays
        inside = np.arange(window.start, window.end)
        keep = (inside < span.start) | (inside >= span.end)
        feet[keep, leg] = raw_w[part][keep, leg]
    guess = motion_of(pose_at(robot, local, feet, height), local, contact[part], rate_hz)
    found = executable_between(robot, guess)
    motion = found.motion
    rows = ("root_pos_w", "root_quat_wxyz", "joint_pos", "joint_vel", "foot_pos_b", "root_lin_vel_w", "root_ang_vel_w")
    arrays = {name: getattr(motion, name) for name in rows}
    start = np.array([*guess.root_pos_w[0, :2], 0.0])  # the solution begins at x = y = 0
    arrays["root_pos_w"] = arrays["root_pos_w"] + start
    longest = max((s.duration for stances in planned for s in stances), default=0)
    measured = {
        "joint_speed_share": found.figures.peak["joint speed"],
        "torque_share": found.figures.peak["torque"],
        "friction": found.figures.peak["friction"],
        "duration_s": motion.n_samples / rate_hz,
        "longest_stance_s": longest / rate_hz,
        "least_feet": int(motion.contact.sum(axis=1).min()),
    }
    return window, arrays, measured


def put_transition(whole: dict[str, Array], span: Span, found: dict[str, Array], rate_hz: float) -> None:
    """Puts the samples of a transition into those of the whole. Between the nodes of its solution, legs that swing are
    some mrad off the motions that it joins: at either end it is blended with them for as long as they are kept."""
    t, kept = np.arange(span.start, span.end), round(_KEPT_S * rate_hz)
    begins, ends = Span(span.start, span.start + kept), Span(span.end - 1 - kept, span.end - 1)
    weight = begins.smooth_step(t) - ends.smooth_step(t)
    slope = np.gradient(weight) * rate_hz
    old = {name: whole[name][t] for name in found}
    for name, new in found.items():
        share, rate = (each.reshape(-1, *[1] * (new.ndim - 1)) for each in (weight, slope))
        if name == "root_quat_wxyz":
            old[name] *= np.sign(np.sum(old[name] * new, axis=-1, keepdims=True))
        mixed = (1.0 - share) * old[name] + share * new
        if name in _RATES:
            mixed += rate * (found[_RATES[name]] - old[_RATES[name]])
        if name == "root_quat_wxyz":
            mixed /= np.linalg.norm(mixed, axis=-1, keepdims=True)
        whole[name][t] = mixed


def _plan(
    layout: Layout, index: int, contact: Flags, own: tuple[Cycle, Cycle], kept: int
) -> tuple[Span, list[Span], Stances, list[list[int | None]]]:
    """A window of samples, with `kept` of the motions before and after what is rebuilt; the rebuilt samples of each
    leg; the stances, relative to the window; and for each a sample at which the foot is there, None if it is new."""
    before, segment = layout.segments[index - 1], layout.segments[index]
    trunk, feet = segment.trunk, segment.feet
    assert trunk is not None
    assert feet is not None
    rebuilt, known = [], []
    for leg in range(4):
        lifts = bool(own[0].stances[leg]), bool(own[1].stances[leg])
        if not any(lifts):
            said = f"'{before.name}' and '{segment.name}' cannot be joined"
            raise MotionError(f"{said}: the {LEGS[leg]} foot never lifts off in either")
        stances = stances_of(contact[:, leg], periodic=False)
        fixed: dict[Stance, int | None] = {}
        for s in stances:
            middle = (s.touch_down + s.lift_off) // 2
            merged = feet[leg].stands and s.touch_down < feet[leg].end and s.lift_off > feet[leg].start
            if merged and not lifts[0]:
                fixed[s] = min(trunk.start, feet[leg].start)
            elif merged and not lifts[1]:
                fixed[s] = max(trunk.end, feet[leg].end)
            elif merged or trunk.start < middle < trunk.end:
                fixed[s] = None
            else:  # the foot rolls: what is rebuilt begins where it lifts off, and ends where it touches down
                fixed[s] = s.lift_off - 1 if middle <= trunk.start else s.touch_down
        new = [k for k, at in enumerate(fixed.values()) if at is None]
        begin, end = trunk.start, trunk.end
        if not feet[leg].stands:
            begin, end = min(begin, feet[leg].start), max(end, feet[leg].end)
        if new:  # the swings before and after a new foothold are new, too
            begin = min(begin, stances[new[0] - 1].lift_off if new[0] > 0 else -1)
            end = max(end, stances[new[-1] + 1].touch_down if new[-1] + 1 < len(stances) else len(contact) + 1)
        if not lifts[0]:
            begin = min(begin, feet[leg].start)
            end = max(end, next((s.touch_down for s in stances if s.touch_down >= feet[leg].end), end))
        elif not lifts[1]:
            begin = min(begin, max((s.lift_off for s in stances if s.lift_off <= feet[leg].start), default=begin))
            end = max(end, feet[leg].end)
        known.append(fixed)
        rebuilt.append(Span(begin, end))
    first, last = min(trunk.start, *(s.start for s in rebuilt)), max(trunk.end, *(s.end for s in rebuilt))
    window = Span(first - kept, last + kept)
    if window.start < 0 or window.end > layout.n:
        raise too_short(before if window.start < 0 else segment)
    inside, seen_at = [], []
    for leg, fixed in enumerate(known):
        inside.append(stances_of(contact[window.start : window.end, leg], periodic=False))
        seen_at.append([at for s, at in fixed.items() if s.touch_down < window.end and s.lift_off > window.start])
    return window, rebuilt, inside, seen_at
