"""Stitching: cyclic motions one after another as one motion that does not repeat (paper, "Motion stitching").

ξ₁ ⊕ ξ₂: the retargeted cycles are repeated and laid end to end in the world. The legs switch contact schedules at the
phases that agree best (`switch`). The trunk's velocity, turn, height and tilt are blended within a bounded
acceleration. Feet, trunk and joints of a transition are then made consistent as in retargeting (`transition`). Outside
the transitions every sample is that of the retargeted cycle, moved in the plane.
"""

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any, Final

import numpy as np

from fastmimic.base.arrays import Array, Flags
from fastmimic.base.errors import ConfigError, MotionError
from fastmimic.base.rotations import quat_continuous, rotate_planar, trunk_quaternion, turned_about_z, yaw_from_quat
from fastmimic.clips.clip import ClipOrigin
from fastmimic.motion.motion import Motion
from fastmimic.motion.provenance import Provenance, Span, StitchedSegment, StitchRecord
from fastmimic.retargeting.config import RetargetConfig
from fastmimic.retargeting.feet import Reach
from fastmimic.retargeting.track import TrunkTrack, steps
from fastmimic.robot import Robot
from fastmimic.stitching.switch import Cycle, Switch, best_switch
from fastmimic.stitching.transition import Layout, make_transition, put_transition, too_short

SEGMENT_S: Final = 3.0  # default length of a segment, rounded to whole cycles
MAX_S: Final = 600.0


def default_cycles(motion: Motion) -> int:
    """Number of cycles that last about `SEGMENT_S`."""
    return max(1, round(SEGMENT_S / motion.period_s))


def stitch_motions(robot: Robot, motions: Sequence[Motion], cycles: Sequence[int] | None = None) -> Motion:
    """Joins two or more cyclic demonstrations of one rate into one that does not repeat. `cycles` are the repetitions
    of each; about `SEGMENT_S` each if None. The last segment ends with its cycle, the others within 0.6 s and half a
    cycle of it, where they fit the next one best. The result's `provenance.stitch` holds the segments, the cycles'
    starts and figures of the transitions, `parts` the motions. Raises `ConfigError` for a wrong number of motions or
    cycles, or more than `MAX_S`; `MotionError` for an unfit motion, a segment too short for its transitions, or a foot
    that never lifts off and would have to move."""
    config = RetargetConfig().for_robot(robot)  # of feet, reach and balance in the transitions
    counts = _check(robot, motions, cycles)
    parts = list({id(m): m for m in motions}.values())
    index = [next(k for k, part in enumerate(parts) if part is m) for m in motions]
    own = [Cycle.of(m) for m in motions]
    rate = motions[0].rate_hz
    height = float(np.mean([m.root_pos_w[:, 2].mean() for m in motions]))
    reach = Reach.of_robot(robot, height, config.reach_margin_rad)

    ends = [count * cycle.n for count, cycle in zip(counts, own, strict=True)]
    neighbours = zip(pairwise(own), ends[:-1], strict=True)
    switches = [best_switch(a, b, end, rate, reach, config.swing.linger_s) for (a, b), end in neighbours]
    layout = _layout(motions, index, counts, switches)

    track, raw_w, contact = _laid_end_to_end(parts, layout)
    arrays = _samples(parts, layout, track)
    transitions = []
    for i in range(1, len(motions)):
        cycles_of = own[i - 1], own[i]
        span, found, measured = make_transition(robot, layout, i, track, raw_w, contact, cycles_of, rate, config)
        transitions.append((span, measured))
        put_transition(arrays, span, found, rate)
    arrays["root_quat_wxyz"] = quat_continuous(arrays["root_quat_wxyz"])
    rebuilt = (replace(s, rebuilt=span) for s, (span, _) in zip(layout.segments[1:], transitions, strict=True))
    layout = Layout((layout.segments[0], *rebuilt), layout.n)
    _check_room(layout)
    licences = sorted({m.provenance.licence for m in motions if m.provenance.licence})
    credits = sorted({m.provenance.credit for m in motions if m.provenance.credit})
    assumed = dict.fromkeys(a for m in motions for a in m.provenance.assumed)
    return Motion(
        rate_hz=rate,
        contact=contact,
        **arrays,
        cycle=None,
        provenance=Provenance(
            name="+".join(m.name for m in motions),
            robot=robot.name,
            source=ClipOrigin(source="stitched", assumed=tuple(assumed)),
            licence="; ".join(licences) or None,
            credit="; ".join(credits) or None,
            stitch=StitchRecord(layout.segments, _cycle_starts(layout, parts), tuple(m for _, m in transitions)),
        ),
        parts=tuple(parts),
    )


def _check(robot: Robot, motions: Sequence[Motion], cycles: Sequence[int] | None) -> list[int]:
    if len(motions) < 2:
        raise ConfigError(f"stitching takes at least two motions, found {len(motions)}")
    for motion in motions:
        if motion.cycle is None:
            raise MotionError(f"motion '{motion.name}' does not repeat; only cyclic motions can be stitched")
        motion.check_robot(robot.name)
        motion.check_rate(motions[0].rate_hz, MotionError)
    if cycles is not None and len(cycles) != len(motions):
        raise ConfigError(f"{len(motions)} motions need as many numbers of cycles, found {len(cycles)}")
    counts = [default_cycles(m) for m in motions] if cycles is None else [int(c) for c in cycles]
    for motion, count in zip(motions, counts, strict=True):
        if count < 1:
            raise ConfigError(f"every motion needs at least one cycle, found {count} for '{motion.name}'")
    if sum(c * m.n_samples for c, m in zip(counts, motions, strict=True)) > MAX_S * motions[0].rate_hz:
        listed = ", ".join(map(str, counts))
        raise ConfigError(f"the stitched motion would be longer than {MAX_S:g} s: fewer cycles than {listed}")
    return counts


def _layout(motions: Sequence[Motion], index: list[int], counts: list[int], switches: list[Switch]) -> Layout:
    shifts, starts = [0], []
    for switch in switches:
        starts.append(shifts[-1] + switch.out)
        shifts.append(starts[-1] - switch.into)
    n = shifts[-1] + counts[-1] * motions[-1].n_samples
    bounds = [0, *starts, n]
    segments = []
    for i, motion in enumerate(motions):
        trunk, feet = None, None
        if i > 0:
            switch, at = switches[i - 1], starts[i - 1]
            trunk = Span(at - switch.half, at + switch.half)
            low, high = bounds[i - 1], bounds[i + 1]
            fr, fl, rr, rl = (Span(max(s.start + at, low), min(s.end + at, high), s.stands) for s in switch.feet)
            feet = (fr, fl, rr, rl)
        segments.append(
            StitchedSegment(motion.name, index[i], counts[i], bounds[i], bounds[i + 1], shifts[i], trunk, feet, None)
        )
    for segment in segments:
        if segment.last <= segment.first:
            raise too_short(segment)
    layout = Layout(tuple(segments), n)
    _check_room(layout)
    return layout


def _check_room(layout: Layout) -> None:
    """Raises `MotionError` if a transition overlaps the previous one or an end."""
    over = 0
    for before, segment in pairwise(layout.segments):
        spans = [s for s in (segment.trunk, segment.rebuilt) if s is not None]
        if any(s.start < over for s in spans):
            raise too_short(before)
        over = max(s.end for s in spans)
        if segment is layout.segments[-1] and over > layout.n:
            raise too_short(segment)


def _samples(parts: Sequence[Motion], layout: Layout, track: TrunkTrack) -> dict[str, Any]:
    """Arrays of the whole: each sample from its segment's part, the root from the track."""
    of_body, of_world = ("joint_pos", "joint_vel", "foot_pos_b"), ("root_lin_vel_w", "root_ang_vel_w")
    out: dict[str, Any] = {
        name: np.empty((layout.n, *getattr(parts[0], name).shape[1:])) for name in (*of_body, *of_world)
    }
    out["root_pos_w"] = np.column_stack([track.root_xy, track.root_z])
    out["root_quat_wxyz"] = quat_continuous(trunk_quaternion(track.heading, track.tilt))
    for segment in layout.segments:
        motion, t = parts[segment.part], np.arange(segment.first, segment.last)
        local = (t - segment.shift) % motion.n_samples
        for name in of_body:
            out[name][t] = getattr(motion, name)[local]
        turn = track.heading[t] - yaw_from_quat(motion.root_quat_wxyz)[local]
        for name in of_world:
            out[name][t] = turned_about_z(getattr(motion, name)[local], turn)
    return out


def _laid_end_to_end(parts: Sequence[Motion], layout: Layout) -> tuple[TrunkTrack, Array, Flags]:
    """The blended trunk, the feet's paths (n, 4, 3) under it (world; z above the ground) and the contacts (n, 4); the
    planar path integrates the blended velocity in the heading frame."""
    n, t = layout.n, np.arange(layout.n)
    trunk, feet = layout.trunk_weights(), layout.foot_weights()
    step, turn = np.zeros((n, 2)), np.zeros(n)
    root_z, tilt = np.zeros(n), np.zeros((n, 2))
    local_feet, contact = np.zeros((n, 4, 3)), np.zeros((n, 4), dtype=bool)
    for i, segment in enumerate(layout.segments):
        motion = parts[segment.part]
        body = TrunkTrack.of(motion)
        own_step, own_turn = steps(body.root_xy, body.heading, body.cycle)
        at = (t - segment.shift) % motion.n_samples
        w = trunk[i]
        between = 0.5 * (w + np.append(w[1:], w[-1]))
        step += between[:, None] * own_step[at]
        turn += between * own_turn[at]
        root_z += w * motion.root_pos_w[at, 2]
        tilt += w[:, None] * body.tilt[at]
        local_feet += feet[i][..., None] * _feet(body)[at]
        for leg in range(4):
            begins = 0
            if segment.feet is not None:
                span = segment.feet[leg]
                begins = span.end
                contact[span.start : span.end, leg] = span.stands
                if not span.stands:
                    _pass_in_swing(local_feet[:, leg], span, parts, layout.segments[i - 1], segment, leg)
            contact[begins:, leg] = motion.contact[at[begins:], leg]  # until the next segment overwrites it
    first = parts[layout.segments[0].part]
    heading = yaw_from_quat(first.root_quat_wxyz[0]) + np.concatenate([[0.0], np.cumsum(turn[:-1])])
    moved = np.cumsum(rotate_planar(heading[:-1], step[:-1]), axis=0)
    root_xy = first.root_pos_w[0, :2] + np.concatenate([np.zeros((1, 2)), moved])
    raw_w = np.array(local_feet)
    raw_w[..., :2] = root_xy[:, None] + rotate_planar(heading[:, None], local_feet[..., :2])
    track = TrunkTrack(root_xy, root_z, heading, tilt, local_feet[..., :2], local_feet[..., 2], None)
    return track, raw_w, contact


def _pass_in_swing(
    feet: Array, span: Span, parts: Sequence[Motion], before: StitchedSegment, after: StitchedSegment, leg: int
) -> None:
    """Blends a swing (n, 3), heading frame, of two motions, each stretched to the duration of the blend."""
    t = np.arange(span.start, span.end)
    paths = []
    for segment, lifts in ((before, True), (after, False)):
        motion = parts[segment.part]
        local = (span.start if lifts else span.end) - segment.shift
        n, contact = motion.n_samples, motion.contact[:, leg]
        away = np.arange(1, n)  # to the next touch-down, or back to the end of the last stance
        samples = int(np.argmax(contact[(local + away if lifts else local - away) % n])) + (1 if lifts else 0)
        at = local + samples * ((t - span.start) / (span.end - span.start) - (0 if lifts else 1))
        low = np.floor(at).astype(int)
        path, fraction = _feet(TrunkTrack.of(motion))[:, leg], (at - low)[:, None]
        paths.append((1 - fraction) * path[low % n] + fraction * path[(low + 1) % n])
    weight = span.smooth_step(t)[:, None]
    feet[t] = (1 - weight) * paths[0] + weight * paths[1]


def _feet(body: TrunkTrack) -> Array:
    """Feet (n, 4, 3): horizontally from the root in the heading frame, z above the ground, m."""
    return np.concatenate([body.toe_from_hip, body.toe_height[..., None]], axis=-1)


def _cycle_starts(layout: Layout, parts: Sequence[Motion]) -> tuple[int, ...]:
    """Samples at which a cycle of their segment starts."""
    return tuple(
        t
        for segment in layout.segments
        for t in range(segment.first, segment.last)
        if t > 0 and (t - segment.shift) % parts[segment.part].n_samples == 0
    )
