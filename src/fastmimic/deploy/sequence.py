"""The motion sequence from standing to standing: blend in, the motion, blend out.

Blending in stands, steps in place and enters the motion by the transitions of `fastmimic.reference`; blending out
reverses this. All are made before the first command; the motion's table is that of every closed loop. A passage is
entered and left by the strides with which it begins and ends, as cycles.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from fastmimic.base.arrays import Array, Records
from fastmimic.base.errors import MotionError
from fastmimic.base.rotations import rotate_planar, yaw_from_quat
from fastmimic.control.config import ControllerConfig
from fastmimic.control.controller import gains_of
from fastmimic.motion.motion import ARRAYS, Motion
from fastmimic.reference.course import CourseTransition
from fastmimic.reference.motion_set import LiveReference, MotionSet
from fastmimic.reference.standing import STAND
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
from fastmimic.steering.gait_field import RATE_HZ, GaitField
from fastmimic.steering.steered import Steered
from fastmimic.stitching.transition import Layout

STAND_S: Final = 1.0  # standing under the controller at start and end
_SAME_POSTURE: Final = 0.05
LEAST_S: Final = 1.0  # of a passage with room for a stride at either end
_STRIDES_S: Final = (0.3, 1.5)  # shortest and longest stride
_NEARLY: Final = 1.3
_RESTS_S: Final = 0.2  # standing on all feet for so long is rest
_STANDS_S: Final = 0.8  # after it was steered, before it sits down: its trunk comes over the middle of its feet


@dataclass(frozen=True, eq=False)
class MotionSequence:
    """From standing to standing: by `motions` to its motion `start`, whose row `enters` is sample `first` of `motion`,
    and from row `leaves` of its motion `end`, sample `last`, to standing; in a cycle `last` may be below `first`. Of
    the motion are `table` (1, t) of `SAMPLE` and `gains` (g,) of `GAINS`; `text` says what the robot does of it."""

    motion: Motion
    text: str
    table: Records
    gains: Records
    first: int
    last: int
    motions: MotionSet
    start: str
    enters: int
    end: str
    leaves: int
    stand: Array  # (12,) joints, rad
    ahead: int  # rows of the reference that the controller looks at


class Follower:
    """The position in a sequence: `clock` (1,) of `CLOCK` in `tables` (1, t) of `SAMPLE` with `gains` (1, g) of
    `GAINS`; in words, `text`. `steps` counts control steps in the motion itself, that is while `in_motion`; `leaving`:
    the motion ends at its next last sample; `done`: the robot stands again. `wanted` (3,) is the velocity of a robot
    that is `steered` instead."""

    steered = False

    def __init__(self, sequence: MotionSequence) -> None:
        self.sequence, self.wanted = sequence, np.zeros(3)
        self._live = LiveReference(sequence.motions.robot, sequence.motions, sequence.motion.rate_hz, STAND)
        self._rows, self._at_row = np.zeros((1, sequence.ahead), SAMPLE), np.zeros(1, CLOCK)
        self.begin(np.zeros(3))

    def begin(self, pose: Array) -> None:
        """Starts where the robot stands: (3,) x, y, yaw in the world, m and rad."""
        self.steps, self.leaving, self.done, self._left = 0, False, False, False
        self._go_live(STAND, pose, 0)

    @property
    def text(self) -> str:
        name = self.sequence.motion.name
        return self.sequence.text if self.in_motion else f"blending {'out of' if self._left else 'into'} {name}"

    def advance(self, observation: Records, memory: Records) -> bool:
        """Advances by one control step; returns whether the motion itself has begun or ended. Where a cycle starts, x
        and y are set by the `observation` (1,) of `OBSERVATION`. The haste is that of the controller's `memory` (1,) of
        `MEMORY`; the motion is left in its own time."""
        if self.done:
            return False
        if self.in_motion:
            self.steps += 1
            return self.advance_motion(observation, memory)
        way, live = self.sequence, self._live
        if live.motion == STAND:
            self._stood += 1
            if self._stood > STAND_S * way.motion.rate_hz:
                live.switch(STAND if self._left else way.start)
                self.done = self._left
        live.update()
        live.advance(observation["root_pos"][0, :2], float(memory["haste"][0]))
        if not self._left and live.goal == live.motion == way.start and self._stood > STAND_S * way.motion.rate_hz:
            passed = 0 if way.start == STAND else round(float(live.place["position"][0])) - way.enters
            self.enter_motion(live.place["pose"][0], passed)
            return True
        self._show(live)
        return False

    def enter_motion(self, pose: Array, passed: int = 0) -> None:
        """Begins the motion itself, so many samples after its first, with its root at (3,) x, y, yaw in the world."""
        way = self.sequence
        self.in_motion, self.tables, self.gains = True, way.table, way.gains[None]
        self.clock = make_clocks(way.motion, 1)
        place_clocks(self.clock, np.array([(way.first + passed) % way.motion.n_samples]), self.tables[0], pose[None])

    def advance_motion(self, observation: Records, memory: Records) -> bool:
        """A control step in the motion itself; returns whether it has ended."""
        way, clock, haste = self.sequence, self.clock, memory["haste"]
        if (int(clock["sample"][0]) + 1) % way.motion.n_samples == way.last:
            haste = np.minimum(haste, 0.0)
        advance_clocks(clock, self.tables, observation["root_pos"], haste)
        ended = bool(clock["sample"][0] == way.last and (self.leaving or not clock["repeats"][0]))
        if ended:
            position, quat = world_root(self.tables[0], clock["sample"], clock["origin"])
            self.leave_motion(np.array([*position[0, :2], yaw_from_quat(quat)[0]]))
        return ended

    def leave_motion(self, pose: Array) -> None:
        """Begins to blend out, with the root at (3,) x, y, yaw in the world."""
        self._left = True
        self._go_live(self.sequence.end, pose, self.sequence.leaves)

    def _go_live(self, name: str, pose: Array, row: int) -> None:
        self.in_motion, self.tables, self.clock, self._stood = False, self._rows, self._at_row, 0
        self._live.begin(name, pose, row)
        self._live.switch(STAND)
        self._show(self._live)

    def _show(self, reference: LiveReference | Steered) -> None:
        reference.fill(self.tables[0])
        self.clock["origin"], self.gains = reference.place["pose"], reference.gains[None]


class SteeredFollower(Follower):
    """The position in a sequence of standing, in whose middle the robot is steered. `commands` has the velocity (3,)
    wanted at a time since then, s: forwards, to the left, m/s, turning to the left, rad/s; None is as before. Once
    `leaving` is set the robot comes to stand."""

    steered = True

    def __init__(self, sequence: MotionSequence, gaits: GaitField, commands: Callable[[float], Array | None]) -> None:
        self._steered, self._commands = Steered(gaits), commands
        super().__init__(sequence)

    @property
    def text(self) -> str:
        return self._steered.state if self.in_motion else "standing"

    def enter_motion(self, pose: Array, passed: int = 0) -> None:
        self.in_motion, self._stood = True, 0
        self._steered.put(*pose)
        self._show(self._steered)

    def advance_motion(self, observation: Records, memory: Records) -> bool:
        """A control step while it is steered; it ends in standing."""
        memory["lag"] = 0.0  # in haste, too, feet that stand keep their places
        wanted = np.zeros(3) if self.leaving else self._commands(self.steps / RATE_HZ)
        if wanted is not None:
            self.wanted = self._steered.steer(wanted)
        self._steered.advance(observation["root_pos"][0, :2], float(memory["haste"][0]))
        self._show(self._steered)
        self._stood += int(self.leaving and self._steered.place["stands"][0] == 1.0)
        self.done = self._stood > _STANDS_S * RATE_HZ
        return False


def make_sequence(robot: Robot, motion: Motion, config: ControllerConfig) -> MotionSequence:
    """The sequence of a motion. A passage is entered and left as the strides at its ends were cycles. `config` is the
    controller's, which may plan ahead. Raises `MotionError` for another robot or rate, or without a transition from or
    to standing."""
    (first, first_shift), (last, last_shift) = _ends(robot, motion, config.rate_hz)
    table, own, ahead = reference_table(motion, robot)[None], gains_of(motion, robot, config), config.samples_ahead
    if motion.contact.all():
        motions = MotionSet(robot, {}, config.rate_hz, regulator=config.regulator)
        stand = _standing_joints(motions, motion)
        return MotionSequence(motion, motion.name, table, own, 0, 0, motions, STAND, 0, STAND, 0, stand, ahead)
    start, end = f"{motion.name} (start)", f"{motion.name} (end)"
    motions = MotionSet(robot, {start: first, end: last}, config.rate_hz, regulator=config.regulator)
    enters = _way(motions, STAND, start)[-1].arrive
    arrive = (enters + first_shift) % first.n_samples

    n, text = last.n_samples, motion.name
    # early enough for a controller that plans ahead to see the transition
    leaves = ends = (_way(motions, end, STAND)[0].leave - ahead) % n
    if motion.target.parts:
        leaves, ends = (motion.n_samples - 1 - last_shift) % n, motion.n_samples - 1
    elif motion.cycle is None:  # within its last stride
        leaves = max(0, (leaves + ahead) % n - ahead)
        ends = last_shift + leaves
        text = _passage(motion, arrive, ends)
    stand = np.array(motions.entries[STAND].motion.joint_pos[0])
    return MotionSequence(motion, text, table, own, arrive, ends, motions, start, enters, end, leaves, stand, ahead)


def _passage(motion: Motion, first: int, last: int) -> str:
    """Which part of a passage is done; `MotionError` if none is left."""
    begins, ends = first * motion.dt, last * motion.dt
    if first >= last:
        when = f"entered from standing by {begins:.2f} s only, and left until {ends:.2f} s"
        raise MotionError(f"motion '{motion.name}' can be {when}; choose a longer passage")
    return f"{motion.name} from {begins:.2f} s to {ends:.2f} s of {motion.period_s:.2f} s"


def _standing_joints(motions: MotionSet, motion: Motion) -> Array:
    """Those of standing (12,), rad; raises `MotionError` if a standing motion does not begin and end there."""
    stand = motions.entries[STAND].motion.joint_pos[0]
    off = float(np.abs(motion.joint_pos[[0, -1]] - stand).max())
    if off > _SAME_POSTURE:
        said = f"motion '{motion.name}' never lifts a foot and begins or ends {off:.2f} rad off the standing posture"
        raise MotionError(f"{said}: the robot cannot reach it without a step")
    return np.array(stand)


def _ends(robot: Robot, motion: Motion, rate_hz: float) -> list[tuple[Motion, int]]:
    """The cyclic motions at start and end, each with a shift: sample t of the whole is its sample (t − shift) mod n."""
    motion.check_robot(robot.name)
    motion.check_rate(rate_hz, MotionError)
    if motion.cycle is not None:
        return [(motion, 0), (motion, 0)]
    parts = motion.target.parts
    if not parts:
        if motion.period_s < LEAST_S:
            said = f"motion '{motion.name}' does not repeat and lasts {motion.period_s:.2f} s, too short to be entered"
            raise MotionError(f"{said} from standing and left again; choose a passage of {LEAST_S:g} s or more")
        return [_stride(motion, 0, 1), _stride(motion, motion.n_samples - 1, -1)]
    segments = Layout.of(motion.target).segments
    return [(parts[s.part], s.shift) for s in (segments[0], segments[-1])]


def _way(motions: MotionSet, start: str, goal: str) -> list[CourseTransition]:
    """The transitions from one motion of the set to another; they are made now."""
    hops: list[CourseTransition] = []
    now = start
    while now != goal:
        hop = motions.next_hop(now, goal)
        if hop is None or len(hops) > len(motions.names):
            raise MotionError(f"no way was found from '{start}' to '{goal}'")
        now, transition = hop
        hops.append(transition)
    return hops


def _stride(motion: Motion, start: int, way: int) -> tuple[Motion, int]:
    """The beginning of a passage (`way` 1 from its first sample) or its end (-1 from its last) as a cycle, and the
    sample at which that begins: until joints and contacts are about as near to those at `start` as they come; the pose
    there, if the robot rests."""
    n = round(_RESTS_S * motion.rate_hz)
    if not motion.contact[::way][:n].all():
        least, most = (round(s * motion.rate_hz) for s in _STRIDES_S)
        most = min(most, motion.n_samples - 1)
        at = start + way * np.arange(min(least, most), most + 1)
        apart = np.linalg.norm(motion.joint_pos[at] - motion.joint_pos[start], axis=1)
        apart += (motion.contact[at] != motion.contact[start]).sum(axis=1)
        n = int(abs(at[int(np.argmax(apart <= _NEARLY * apart.min()))] - start))
    first = start if way > 0 else start - n
    return _as_cycle(motion, first, n), first


def _as_cycle(motion: Motion, first: int, n: int) -> Motion:
    """Samples of a passage as one period."""
    part = slice(first, first + n)
    yaw = yaw_from_quat(motion.root_quat_wxyz[[first, first + n]])
    moved = motion.root_pos_w[first + n, :2] - motion.root_pos_w[first, :2]
    cycle = np.array([*rotate_planar(-yaw[0], moved), np.angle(np.exp(1j * (yaw[1] - yaw[0])))])
    arrays = {name: getattr(motion, name)[part] for name in ARRAYS}
    return replace(motion, **arrays, cycle=cycle, demonstration=None, animal=None)
