"""Makes a transition between two motions consistent: feet planted, trunk balanced, joints within limits."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from fastmimic.base.arrays import Array
from fastmimic.base.conventions import LEGS
from fastmimic.base.errors import MotionError
from fastmimic.motion.contacts import Stance, Stances, stances_of
from fastmimic.motion.motion import Motion
from fastmimic.motion.provenance import Span
from fastmimic.retargeting.config import RetargetConfig
from fastmimic.retargeting.feet import plant_feet
from fastmimic.retargeting.fidelity import slip
from fastmimic.retargeting.fit import Consistency
from fastmimic.retargeting.pose import Pose, joint_velocity, solve_pose
from fastmimic.retargeting.reach import Reach, footholds
from fastmimic.retargeting.track import TrunkTrack
from fastmimic.robot import Robot
from fastmimic.stitching.layout import Layout, too_short
from fastmimic.stitching.switch import Cycle

_PAD: Final = 4  # samples beyond the rebuilt ones, for derivatives
_LOWERING_SHARE: Final = 0.3  # share of a transition in which the trunk is lowered, and in which it is raised again


@dataclass(frozen=True, eq=False)
class Transition:
    """The rebuilt samples (`span` of the whole) between two segments, by the names of `Motion`, with JSON figures."""

    span: Span
    arrays: dict[str, Array]
    measured: dict[str, Any]


def make_transition(
    robot: Robot,
    layout: Layout,
    index: int,
    track: TrunkTrack,
    raw_w: Array,
    contact: NDArray[np.bool_],
    own: tuple[Cycle, Cycle],
    rate_hz: float,
    reach: Reach,
    config: RetargetConfig,
) -> Transition:
    """Rebuilds the samples between segments `index` − 1 and `index`. `track` is the blended trunk of the whole, `raw_w`
    (n, 4, 3) are the feet under it, world, m (z of their centres), and `own` the cycles of the two motions. Raises
    `MotionError` if a foot that never lifts off would have to move, or a segment is too short."""
    plan = _plan(layout, index, contact, own)
    window = plan.window
    if window.start < 0 or window.end > layout.n:
        raise too_short(layout.segments[index - 1 if window.start < 0 else index])
    part = slice(window.start, window.end)
    names = ("root_xy", "root_z", "heading", "tilt", "toe_from_hip", "toe_height")
    local = TrunkTrack(**{name: getattr(track, name)[part] for name in names}, cycle=None)
    height = float(local.root_z.mean())
    reach = replace(reach, hip_height=height + float(robot.hip_pos_b[:, 2].mean()) - robot.foot_radius)
    raw = np.array(raw_w[part])
    raw[..., 2] = np.maximum(raw[..., 2] - robot.foot_radius, 0.0)
    linger = round(config.swing.linger_s * rate_hz)

    def held(under: TrunkTrack) -> list[list[Array]]:
        holds = footholds(raw, under, plan.stances, reach, linger)
        for leg in range(4):
            for k, at in enumerate(plan.fixed[leg]):
                if at is not None:
                    holds[leg][k] = raw_w[min(max(at, 0), layout.n - 1), leg, :2]
        return holds

    def planted(holds: list[list[Array]], evenness: Array | None) -> Array:
        feet = plant_feet(
            raw, local, plan.stances, holds, reach.clearance, robot.foot_radius, rate_hz, config.swing, evenness
        )
        for leg, span in enumerate(plan.rebuilt):  # the rest stays
            inside = np.arange(window.start, window.end)
            keep = (inside < span.start) | (inside >= span.end)
            feet[keep, leg] = raw_w[part][keep, leg]
        return feet

    consistency = Consistency(robot, local, contact[part], rate_hz, config)
    balanced = consistency.balanced_over(planted(held(local), None))
    holds = held(balanced)
    lowered, pose = _within_limits(consistency, balanced, lambda evenness: planted(holds, evenness))
    motion = consistency.motion(pose, lowered)
    inner = slice(_PAD, motion.n_samples - _PAD)
    rows = ("root_pos_w", "root_quat_wxyz", "joint_pos", "joint_vel", "foot_pos_b", "root_lin_vel_w", "root_ang_vel_w")
    return Transition(
        span=Span(window.start + _PAD, window.end - _PAD),
        arrays={name: getattr(motion, name)[inner] for name in rows},
        measured=_measure(robot, motion, pose, local, lowered, plan, rate_hz),
    )


def _within_limits(
    consistency: Consistency, track: TrunkTrack, planted: Callable[[Array], Array]
) -> tuple[TrunkTrack, Pose]:
    """Trunk and joints with the fewest samples beyond limits, by more even swings and then a lower trunk."""
    robot, config = consistency.robot, consistency.config
    limit = config.speed_share * robot.joint_speed_limit
    n = len(track.root_z)
    edge = Span(0, max(1, round(_LOWERING_SHARE * n)))
    shape = edge.smooth_step(np.arange(n)) * edge.smooth_step(np.arange(n)[::-1])

    def beyond(pose: Pose) -> NDArray[np.int_]:
        speed = np.abs(joint_velocity(pose.joint_pos, consistency.rate_hz, False))
        joints = pose.limited | (speed > limit)
        joints[:_PAD] = joints[-_PAD:] = False
        return np.asarray(joints.reshape(-1, 4, 3).sum(axis=(0, 2)) + pose.unreachable.sum(axis=0))

    best: tuple[int, TrunkTrack, Pose] | None = None
    for lowering in np.arange(0.0, config.max_lowering_m + 1e-9, 0.005):
        lowered = replace(track, root_z=track.root_z - lowering * shape)
        height = float(lowered.root_z.mean())

        def solve(evenness: Array, lowered: TrunkTrack = lowered, height: float = height) -> Pose:
            return solve_pose(robot, lowered, planted(evenness), height, config)

        for pose, samples in consistency.attempts(solve, beyond):
            if best is None or samples.sum() < best[0]:
                best = (int(samples.sum()), lowered, pose)
        if best is not None and best[0] == 0:
            break
    assert best is not None
    return best[1:]


@dataclass(frozen=True, eq=False)
class _Plan:
    """The kept and the new footholds in a `window` of samples, with the `rebuilt` samples of each leg. `stances` are
    relative to the window; `fixed` is a sample of each at which the foot is at its foothold, or None if new."""

    window: Span
    rebuilt: tuple[Span, ...]
    stances: Stances
    fixed: list[list[int | None]]


def _plan(layout: Layout, index: int, contact: NDArray[np.bool_], own: tuple[Cycle, Cycle]) -> _Plan:
    before, segment = layout.segments[index - 1], layout.segments[index]
    trunk, feet = segment.trunk, segment.feet
    assert trunk is not None
    assert feet is not None
    spans, rebuilt, free = [], [], []
    for leg in range(4):
        lifts = bool(own[0].stances[leg]), bool(own[1].stances[leg])
        if not any(lifts):
            raise MotionError(
                f"'{before.name}' and '{segment.name}' cannot be joined: the {LEGS[leg]} foot never lifts off in either"
            )
        stances = stances_of(contact[:, leg], periodic=False)
        fixed: list[int | None] = []
        for s in stances:
            middle = (s.touch_down + s.lift_off) // 2
            merged = feet[leg].stands and s.touch_down < feet[leg].end and s.lift_off > feet[leg].start
            if merged and not lifts[0]:
                fixed.append(min(trunk.start, feet[leg].start))
            elif merged and not lifts[1]:
                fixed.append(max(trunk.end, feet[leg].end))
            elif merged or trunk.start < middle < trunk.end:
                fixed.append(None)
            else:
                fixed.append(middle)
        new = [k for k, at in enumerate(fixed) if at is None]
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
        spans.append(stances)
        free.append(fixed)
        rebuilt.append(Span(begin, end))
    window = Span(
        min(trunk.start, *(s.start for s in rebuilt)) - 2 * _PAD, max(trunk.end, *(s.end for s in rebuilt)) + 2 * _PAD
    )
    inside: Stances = []
    kept: list[list[int | None]] = []
    for stances, fixed in zip(spans, free, strict=True):
        seen = [
            (Stance(max(s.touch_down, window.start) - window.start, min(s.lift_off, window.end) - window.start), at)
            for s, at in zip(stances, fixed, strict=True)
            if s.touch_down < window.end and s.lift_off > window.start
        ]
        inside.append([s for s, _ in seen])
        kept.append([at for _, at in seen])
    return _Plan(window, tuple(rebuilt), inside, kept)


def _measure(
    robot: Robot, motion: Motion, pose: Pose, before: TrunkTrack, after: TrunkTrack, plan: _Plan, rate_hz: float
) -> dict[str, Any]:
    inner = slice(_PAD, motion.n_samples - _PAD)
    speed = np.abs(motion.joint_vel[inner]) / robot.joint_speed_limit
    acceleration = np.gradient(motion.root_lin_vel_w, motion.dt, axis=0)[inner]
    turning = np.gradient(motion.root_ang_vel_w, motion.dt, axis=0)[inner]
    moved = np.concatenate([after.root_xy - before.root_xy, (after.root_z - before.root_z)[:, None]], axis=1)
    longest = max((s.duration for stances in plan.stances for s in stances), default=0)
    return {
        "duration_s": (motion.n_samples - 2 * _PAD) / rate_hz,
        "joint_speed_share": float(speed.max()),
        "slip_m": float(slip(motion.foot_pos_w, after, plan.stances).max()),
        "lowered_m": float((before.root_z - after.root_z).max()),
        "longest_stance_s": longest / rate_hz,
        "acceleration_m_per_s2": float(np.linalg.norm(acceleration[:, :2], axis=1).max()),
        "turn_acceleration_rad_per_s2": float(np.abs(turning[:, 2]).max()),
        "least_feet": int(motion.contact.sum(axis=1).min()),
        "unreachable": int(pose.unreachable[inner].sum()),
        "joint_limited": int(pose.limited[inner].sum()),
        "trunk_change_m": float(np.linalg.norm(moved, axis=1).max()),
        "trunk_change_deg": float(np.degrees(np.abs(after.tilt - before.tilt).max())),
    }
