"""The motion sequence from standing to standing: blend in, the motion, blend out, as reference tables.

Blending in stands, steps in place and enters the motion by the transitions of `fastmimic.reference`; blending out
reverses this. All tables are made before the first command; the motion's is that of every closed loop. A passage is
entered and left by the strides with which it begins and ends, as cycles.
"""

import math
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fastmimic.base.arrays import Array
from fastmimic.base.errors import MotionError
from fastmimic.base.rotations import quat_from_yaw, quat_multiply, rotate_planar, yaw_from_quat
from fastmimic.control.config import ControllerConfig
from fastmimic.control.controller import constant_gains_of, gains_of
from fastmimic.motion.motion import Motion
from fastmimic.reference.course import CourseTransition, course_of
from fastmimic.reference.motion_set import MotionSet
from fastmimic.reference.standing import STAND, standing
from fastmimic.reference.stream import Stream, make_place
from fastmimic.reference.table import (
    CLOCK,
    SAMPLE,
    advance_clocks,
    make_clocks,
    place_clocks,
    reference_table,
    world_root,
)
from fastmimic.robot import Robot
from fastmimic.stitching.transition import Layout

STAND_S: Final = 1.0  # standing under the controller at start and end
_SAME_POSTURE: Final = 0.05
_VECTORS: Final = ("lin_vel", "ang_vel", "lin_acc", "ang_acc", "leg_lin_acc", "leg_ang_acc")
LEAST_S: Final = 1.0  # of a passage with room for a stride at either end
_STRIDES_S: Final = (0.3, 1.5)  # shortest and longest stride
_NEARLY: Final = 1.3
_ARRAYS: Final = (
    *("root_pos_w", "root_quat_wxyz", "root_lin_vel_w", "root_ang_vel_w"),
    *("joint_pos", "joint_vel", "foot_pos_b", "contact"),
)
_RESTS_S: Final = 0.2  # standing on all feet for so long is rest


@dataclass(frozen=True, eq=False)
class SequencePart:
    """A part of the sequence; if its clock repeats, it ends after `Follower.leaving` is set."""

    text: str  # what the robot does in it
    table: NDArray[Any]  # (1, t) of `SAMPLE`
    first: int  # sample
    last: int  # sample; in a cyclic motion it may be below `first`
    clock: NDArray[Any]  # (1,) of `CLOCK`, at the table's start
    gains: NDArray[Any]  # (1, g) of `GAINS`, those of the table's samples


@dataclass(frozen=True, eq=False)
class MotionSequence:
    """From standing to standing: the motion, its three parts, and `stand`, (12,) standing joints in rad."""

    motion: Motion
    blend_in: SequencePart
    main: SequencePart
    blend_out: SequencePart
    stand: Array


class _CourseSlice(NamedTuple):
    """Rows `first` to `last`, exclusive, of a cyclic course; `last` may be beyond its end."""

    course: NDArray[Any]
    gains: NDArray[Any]
    first: int
    last: int


class Follower:
    """The position in a sequence, `clock` (1,) of `CLOCK` in `table` (t,) of `SAMPLE`. `steps` counts control steps in
    the motion itself; `leaving`: it ends at its next last sample; `done`: blending out has ended."""

    def __init__(self, sequence: MotionSequence) -> None:
        self.sequence = sequence
        self.begin(np.zeros(3))

    def begin(self, pose: Array) -> None:
        """Starts where the robot stands: (3,) x, y, yaw in the world, m and rad."""
        self.steps, self.leaving, self.done = 0, False, False
        self.enter(self.sequence.blend_in, pose)

    @property
    def in_motion(self) -> bool:
        """Whether the current part is the motion itself."""
        return self.part is self.sequence.main

    def advance(self, observation: NDArray[Any], haste: Array) -> bool:
        """Advances by one control step; returns whether another part has begun. Where a cycle starts, x and y are set
        by the `observation` (1,) of `OBSERVATION`. `haste` (1,) is the controller's; a part is left in its own time."""
        if self.done:
            return False
        way, part = self.sequence, self.part
        if part is way.main:
            self.steps += 1
        if (int(self.clock["sample"][0]) + 1) % part.table.shape[1] == part.last:
            haste = np.minimum(haste, 0.0)
        advance_clocks(self.clock, part.table, observation["root_pos"], haste)
        sample = int(self.clock["sample"][0])
        if part is way.blend_out:
            self.done = sample >= part.last
            return False
        left = sample == part.last and (self.leaving or not part.clock["repeats"][0])
        if left:
            following = way.main if part is way.blend_in else way.blend_out
            position, quat = world_root(part.table[0], self.clock["sample"], self.clock["origin"])
            self.enter(following, np.array([*position[0, :2], yaw_from_quat(quat)[0]]))
        return left

    def enter(self, part: SequencePart, pose: Array) -> None:
        """Begins a part with its first sample's root at (3,) x, y, yaw in the world, m and rad."""
        self.part, self.table, self.clock = part, part.table[0], part.clock.copy()
        place_clocks(self.clock, np.array([part.first]), self.table, pose[None])


def make_sequence(robot: Robot, motion: Motion, config: ControllerConfig) -> MotionSequence:
    """The sequence of a motion. A passage is entered and left as the strides at its ends were cycles. `config` is the
    controller's, which may plan ahead. Raises `MotionError` for another robot or rate, or without a transition from or
    to standing."""
    (first, first_shift), (last, last_shift) = _ends(robot, motion, config.rate_hz)
    if motion.contact.all():
        return _standing(robot, motion, config)
    start, end = f"{motion.name} (start)", f"{motion.name} (end)"
    library = MotionSet(robot, {start: first, end: last}, config.rate_hz, regulator=config.regulator)
    ahead = config.samples_ahead
    hold = max(1, round(STAND_S * config.rate_hz))
    stand = library.entry(STAND)

    hops = _way(library, STAND, start)
    whole = course_of(motion, robot)
    arrive = (hops[-1][1].arrive + first_shift) % first.n_samples
    blend_in = _slices(library, STAND, hops, 0, hold)
    own = gains_of(motion, robot, config)
    blend_in.append(_CourseSlice(whole, own, arrive, arrive + ahead))
    table, gains, at = _table(robot, blend_in, config)
    into = _blending("into", motion, table, gains, at[-1])

    hops = _way(library, end, STAND)
    n = last.n_samples
    # early enough for a controller that plans ahead to see the transition
    begins = (hops[0][1].leave - ahead) % n
    ends = begins
    if motion.target.parts:
        begins, ends = (motion.n_samples - 1 - last_shift) % n, motion.n_samples - 1
    elif motion.cycle is None:  # within its last stride
        begins = max(0, hops[0][1].leave % n - ahead)
        ends = last_shift + begins
    blend_out = _slices(library, end, hops, begins, 0)
    blend_out.append(_CourseSlice(stand.course, stand.gains, hops[-1][1].arrive, hops[-1][1].arrive + hold + ahead))
    table, gains, at = _table(robot, blend_out, config)
    out = _blending("out of", motion, table, gains, at[-1] + hold)

    text = motion.name
    if motion.cycle is None and not motion.target.parts:
        text = _passage(motion, arrive, ends)
    clock = make_clocks(motion, 1)
    main = SequencePart(text, reference_table(motion, robot)[None], arrive, ends, clock, own[None])
    return MotionSequence(motion, into, main, out, np.array(stand.motion.joint_pos[0]))


def _passage(motion: Motion, first: int, last: int) -> str:
    """Which part of a passage is done; `MotionError` if none is left."""
    begins, ends = first * motion.dt, last * motion.dt
    if first >= last:
        raise MotionError(
            f"motion '{motion.name}' can be entered from standing by {begins:.2f} s only, and left until {ends:.2f} s;"
            " choose a longer passage"
        )
    return f"{motion.name} from {begins:.2f} s to {ends:.2f} s of {motion.period_s:.2f} s"


def _standing(robot: Robot, motion: Motion, config: ControllerConfig) -> MotionSequence:
    """The sequence of a standing motion; raises `MotionError` if it does not begin and end in the standing posture."""
    hold = max(1, round(STAND_S * config.rate_hz))
    stand = standing(robot)
    off = float(np.abs(motion.joint_pos[[0, -1]] - stand.joint_pos[0]).max())
    if off > _SAME_POSTURE:
        raise MotionError(
            f"motion '{motion.name}' never lifts a foot and begins or ends {off:.2f} rad off the standing posture:"
            " the robot cannot reach it without a step"
        )
    course = course_of(stand, robot)
    gains = gains_of(stand, robot, config)
    table, gains, _ = _table(robot, [_CourseSlice(course, gains, 0, hold + config.samples_ahead)], config)
    into, out = _blending("into", motion, table, gains, hold), _blending("out of", motion, table, gains, hold)
    clock, own = make_clocks(motion, 1), gains_of(motion, robot, config)
    main = SequencePart(motion.name, reference_table(motion, robot)[None], 0, 0, clock, own[None])
    return MotionSequence(motion, into, main, out, stand.joint_pos[0].copy())


def _ends(robot: Robot, motion: Motion, rate_hz: float) -> list[tuple[Motion, int]]:
    """The cyclic motions at start and end, each with a shift: sample t of the whole is its sample (t − shift) mod n."""
    motion.check_robot(robot.name)
    if abs(motion.rate_hz - rate_hz) > 1e-9:
        raise MotionError(
            f"motion '{motion.name}' has {motion.rate_hz:g} samples a second and the controller runs at {rate_hz:g} Hz;"
            " retarget the clip with that rate"
        )
    if motion.cycle is not None:
        return [(motion, 0), (motion, 0)]
    parts = motion.target.parts
    if not parts:
        if motion.period_s < LEAST_S:
            raise MotionError(
                f"motion '{motion.name}' does not repeat and lasts {motion.period_s:.2f} s, too short to be entered"
                f" from standing and left again; choose a passage of {LEAST_S:g} s or more"
            )
        return [first_stride(motion), last_stride(motion)]
    segments = Layout.of(motion.target).segments
    return [(parts[s.part], s.shift) for s in (segments[0], segments[-1])]


def _way(library: MotionSet, start: str, goal: str) -> list[tuple[str, CourseTransition]]:
    """The motions and transitions from one motion of the set to another."""
    hops: list[tuple[str, CourseTransition]] = []
    now = start
    while now != goal:
        hop = library.next_hop(now, goal)
        if hop is None or len(hops) > len(library.names):
            raise MotionError(f"no way was found from '{start}' to '{goal}'")
        hops.append(hop)
        now = hop[0]
    return hops


def _slices(
    library: MotionSet, start: str, hops: list[tuple[str, CourseTransition]], first: int, hold: int
) -> list[_CourseSlice]:
    """The slices of `hops`, from row `first` of the first motion, which lasts at least `hold` rows."""
    found, name, row, least = [], start, first, hold
    for following, transition in hops:
        entry = library.entry(name)
        n = len(entry.course)
        last = row + (transition.leave - row) % n
        last += n if last == row else 0
        last += n * math.ceil(max(0, least - (last - row)) / n)
        found.append(_CourseSlice(entry.course, entry.gains, row, last))
        found.append(_CourseSlice(transition.course, transition.gains, transition.first, transition.last))
        name, row, least = following, transition.arrive, 0
    return found


def _table(
    robot: Robot, slices: list[_CourseSlice], config: ControllerConfig
) -> tuple[NDArray[Any], NDArray[Any], list[int]]:
    """Consecutive slices as a table (t,) of `SAMPLE` from the heading frame of row 0, its gains (g,), each's start."""
    stream, place, row = Stream(robot, config.rate_hz), make_place(), np.zeros(1, SAMPLE)
    rows: list[Any] = []
    poses: list[Array] = []
    begins: list[int] = []
    pose, known = np.zeros(3), 0
    for piece, following in pairwise([*slices, slices[-1]]):
        course = piece.course
        n = len(course)
        begins.append(len(rows))
        for i in range(piece.first, piece.last):
            at = i % n
            place["position"] = at
            # interpolation looks a few rows beyond the end, into what follows
            place["exit"] = at + piece.last - i if piece is not following else -1
            place["entry"] = following.first % len(following.course)
            stream.fill(course, following.course, place, row)
            row["sync"], row["gain"] = course["sync"][at], course["gain"][at] + known
            rows.append(row[0].copy())
            poses.append(pose.copy())
            pose[:2] += rotate_planar(float(pose[2]), course["step"][at])
            pose[2] += course["turn"][at]
        known += len(piece.gains)
    table, where = np.array(rows, SAMPLE), np.array(poses)
    table["root_pos"][:, :2] = where[:, :2]
    table["root_quat"] = quat_multiply(quat_from_yaw(where[:, 2]), table["root_quat"])
    for name in _VECTORS:
        table[name][:, :2] = rotate_planar(where[:, 2], table[name][:, :2])
    if config.stance.feedback == "constant":
        return table, constant_gains_of(config.stance), begins
    return table, np.concatenate([piece.gains for piece in slices]), begins


def _blending(way: str, motion: Motion, table: NDArray[Any], gains: NDArray[Any], last: int) -> SequencePart:
    return SequencePart(f"blending {way} {motion.name}", table[None], 0, last, np.zeros(1, CLOCK), gains[None])


def first_stride(motion: Motion) -> tuple[Motion, int]:
    """The beginning of a passage as a cycle, and the sample at which it begins: until joints and contacts are about as
    near to those at its start as they come; its first pose, if it begins at rest."""
    rest = round(_RESTS_S * motion.rate_hz)
    if motion.contact[:rest].all():
        return _as_cycle(motion, 0, rest), 0
    return _as_cycle(motion, 0, _stride(motion, 0, 1)), 0


def last_stride(motion: Motion) -> tuple[Motion, int]:
    """Likewise its end."""
    rest, last = round(_RESTS_S * motion.rate_hz), motion.n_samples - 1
    if motion.contact[-rest:].all():
        return _as_cycle(motion, last - rest, rest), last - rest
    n = _stride(motion, last, -1)
    return _as_cycle(motion, last - n, n), last - n


def _stride(motion: Motion, start: int, way: int) -> int:
    """Samples from `start`, forwards or backwards, to the first pose that is nearly as near to it as any."""
    least, most = (round(s * motion.rate_hz) for s in _STRIDES_S)
    most = min(most, motion.n_samples - 1)
    at = start + way * np.arange(min(least, most), most + 1)
    apart = np.linalg.norm(motion.joint_pos[at] - motion.joint_pos[start], axis=1)
    apart += (motion.contact[at] != motion.contact[start]).sum(axis=1)
    return int(abs(at[int(np.argmax(apart <= _NEARLY * apart.min()))] - start))


def _as_cycle(motion: Motion, first: int, n: int) -> Motion:
    """Samples of a passage as one period."""
    part = slice(first, first + n)
    yaw = yaw_from_quat(motion.root_quat_wxyz[[first, first + n]])
    moved = motion.root_pos_w[first + n, :2] - motion.root_pos_w[first, :2]
    cycle = np.array([*rotate_planar(-yaw[0], moved), np.angle(np.exp(1j * (yaw[1] - yaw[0])))])
    arrays = {name: getattr(motion, name)[part] for name in _ARRAYS}
    return replace(motion, **arrays, cycle=cycle, demonstration=None, animal=None)
