"""A field of gaits: a gait at many velocities, each made executable, to be interpolated between, and slower gaits.

The gait is an animal's, one period of it, or built in. What is changed is the trunk's mean velocity; the feet land
where the animal puts them under the trunk. So at equal phase the same feet stand: any mixture of neighbours is a gait
again, at the velocity between theirs, and the velocity can change in every control step. The axes of the grid are the
velocities forwards and to the left and the turn rate. The greatest turn rate depends on the forward velocity, as the
ground has to give their product as centripetal acceleration.

A gait that cannot be slow, such as a canter, or in which never the same feet stand as in the slower one, as in a trot
after a pace, is reached from the slower one by a passage, and left by another: the transition of stitched motions,
solved by optimal control, straight ahead at about the slower gait's top speed.
"""

import dataclasses
import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Final

import numpy as np

from fastmimic.base.arrays import Array, Flags, Records
from fastmimic.base.errors import ClipError, MotionError
from fastmimic.clips.clip import Clip, ClipOrigin
from fastmimic.clips.segment import find_segments
from fastmimic.clips.synthesis import GAITS, keypoints
from fastmimic.episode.loop import share_of_falls
from fastmimic.executors import Report
from fastmimic.executors.local import LocalExecutor
from fastmimic.motion.motion import Motion
from fastmimic.reference.course import COURSE, course_of, make_course_transition
from fastmimic.reference.regulator import GAINS, motion_gains
from fastmimic.reference.regulator_config import RegulatorConfig
from fastmimic.reference.standing import standing
from fastmimic.reference.table import GAIN_SAMPLES
from fastmimic.retargeting.retarget import is_one_cycle, retarget
from fastmimic.robot import Robot, load_robot
from fastmimic.robot.robot import length_ratio
from fastmimic.steering.change import rows_between
from fastmimic.trajectory.config import TrajectoryConfig
from fastmimic.trajectory.executable import falls_with, nearest_executable
from fastmimic.trajectory.solved import Remembered

RATE_HZ: Final = 500.0
_LOG: Final = logging.getLogger(__name__)
_BUILT_IN: Final = {
    "walk": dataclasses.replace(GAITS["walk"], half_width=0.04, lift=0.08),
    "trot": dataclasses.replace(GAITS["trot"], speed=0.5, duty=0.55, half_width=0.04, lift=0.09),
    "canter": GAITS["canter"],
}
_SHARES: Final = (1.0, 0.8, 0.6, 0.4)  # of a velocity that are tried
_KEPT: Final = (
    TrajectoryConfig(keep_time=True, keep_speed=True),
    TrajectoryConfig(keep_speed=True),
    TrajectoryConfig(keep_time=True),
)
_REPEATS: Final = 0.85  # a period of a take that is a gait, in `Segment.confidence`
_ABOUT: Final = 1.1  # by how much a gait's own speed may be beyond its grid
_SAME_CONTACT: Final = 0.97  # share of a gait's contacts that stay
_SEEN: Final = 0.01  # m/s or rad/s
_SAME: Final = 1e-6  # between the velocities of a passage, m/s or rad/s: all are the same

Velocity = tuple[float, float, float]  # forwards, to the left, m/s, and turning to the left, rad/s


@dataclass(frozen=True)
class Grid:
    """Velocities of the gaits at the A1's size: forwards and to the left, m/s, both ascending, and for each forward one
    the greatest turn rate to either side, rad/s."""

    forwards: tuple[float, ...] = (-0.5, 0.0, 0.5, 1.0, 1.5)
    sideways: tuple[float, ...] = (-0.4, 0.0, 0.4)
    turning: tuple[float, ...] = (2.0, 2.0, 2.0, 1.5, 0.9)

    def sized(self, size: float) -> "Grid":
        """That of a robot of another size than the A1's."""
        forwards, sideways = (tuple(size * v for v in axis) for axis in (self.forwards, self.sideways))
        return Grid(forwards, sideways, self.turning)

    @classmethod
    def up_to(cls, speed: float) -> "Grid":
        """That of a gait for low speeds: up to its own one, m/s."""
        return cls((-0.5 * speed, 0.0, 0.5 * speed, speed), (-speed / 3.0, 0.0, speed / 3.0), (1.0, 1.0, 1.0, 0.6))

    @classmethod
    def beyond(cls, speed: float) -> "Grid":
        """That of a gait for high speeds: around and up to its own one, m/s."""
        return cls((0.6 * speed, 0.8 * speed, speed), (-0.1 * speed, 0.0, 0.1 * speed), (0.8, 0.8, 0.6))

    def velocities(self) -> list[Velocity]:
        """Those of all gaits (k = a · b · 3): turning to the right, not, and to the left."""
        pairs = zip(self.forwards, self.turning, strict=True)
        return [(x, y, side * most) for (x, most), y, side in product(pairs, self.sideways, (-1.0, 0.0, 1.0))]


@dataclass(frozen=True, eq=False)
class Passage:
    """The way from one gait to another: it leaves the one before its row `leave`, at `before` m/s forwards, and enters
    the other at its row `arrive`, at `after` m/s, `n` rows later. `field` has its rows, and a period of the other gait
    after them, whatever the velocity."""

    field: "GaitField"
    n: int
    leave: int
    arrive: int
    before: float
    after: float


@dataclass(frozen=True, eq=False)
class GaitField:
    """A gait of one robot by velocity, at `RATE_HZ` control steps a second, and another one that is `slower`, with the
    passages from and to that one, if it needs them. The grid's axes are `forwards` (a,) and `sideways` (b,), m/s, and
    turn rates to the right, none, and to the left, of `turning` (a,), rad/s. `rows` (k + 1, t) of `COURSE` are one
    period of each gait in the order of the axes, and last of standing; `gains` (k + 1, g) of `GAINS` are theirs, one
    for each `GAIN_SAMPLES` rows."""

    name: str
    robot: Robot
    forwards: Array
    sideways: Array
    turning: Array
    rows: Records
    gains: Records
    slower: "GaitField | None" = None
    passages: tuple[Passage, Passage] | None = None

    def __repr__(self) -> str:
        return f"<GaitField {' over '.join(gait.name for gait in self.chain())} of {self.robot.name}>"

    @property
    def contact(self) -> Flags:
        """Which feet stand (t, 4), at any velocity."""
        return np.asarray(self.rows[len(self.rows) // 2 - 1]["contact"] != 0)

    @property
    def can_stand(self) -> bool:
        """Whether it can be as slow as one likes."""
        return bool(self.forwards[0] <= 0.0)

    def chain(self) -> "list[GaitField]":
        """This gait and all slower ones."""
        return [self, *(self.slower.chain() if self.slower is not None else ())]

    def straight(self, speed: float) -> int:
        """Which of its gaits goes straight ahead with one of its speeds, m/s."""
        k, middle = (int(np.argmin(np.abs(axis))) for axis in (self.forwards - speed, self.sideways))
        return (k * len(self.sideways) + middle) * 3 + 1

    def has(self, velocity: Array) -> bool:
        """Whether it has a velocity (3,), but for what nobody sees."""
        nearest, wanted = self.nearest(velocity).tolist(), velocity.tolist()
        return all(abs(a - b) < _SEEN for a, b in zip(nearest, wanted, strict=True))

    def nearest(self, velocity: Array) -> Array:
        """The velocity (3,) of this gait that is nearest to one: forwards, to the left, m/s, and turning, rad/s."""
        wanted = velocity.tolist()  # of so few numbers arrays would take four times as long, in each control step
        forwards = min(max(wanted[0], self.forwards[0]), self.forwards[-1])
        sideways = min(max(wanted[1], self.sideways[0]), self.sideways[-1])
        most = np.interp(forwards, self.forwards, self.turning)
        return np.array([forwards, sideways, min(max(wanted[2], -most), most)])

    def ends(self) -> Array:
        """The least and the greatest velocities of all gaits (2, 3)."""
        most = [(gait.forwards[-1], gait.sideways[-1], gait.turning.max()) for gait in self.chain()]
        least = [(gait.forwards[0], gait.sideways[0], -gait.turning.max()) for gait in self.chain()]
        return np.array([np.min(least, axis=0), np.max(most, axis=0)])


def gait_field(
    source: str,
    clips: Sequence[Clip] = (),
    progress: Callable[[int, int], None] = lambda done, count: None,
    *,
    grid: Grid = Grid(),
    slow: Callable[[float], Grid] = Grid.up_to,
    fast: Callable[[float], Grid] = Grid.beyond,
    workers: int | None = 1,
) -> GaitField:
    """The field of a robot, whose name or file is `source`, from one period each of an animal's gaits, the slowest
    first, or by default of a built-in walk, trot and canter. The last one whose own speed is within `grid` has the
    velocities of that (the first, if none is), those before it those of `slow` for their own speed, and those after it
    those of `fast`. It is made once and kept in the user's cache folder: in a minute or two for each gait, or in
    seconds where its solutions are in the package, as those of the A1 and the Go2 with the built-in gaits. `progress`
    is told how many velocities of a gait are done, and of how many. A gait after the one with the velocities of `grid`
    that the robot cannot do, or not reach, is left out with a warning. `workers` processes make it, as many as there
    are cores if None; a script that asks for several needs `if __name__ == "__main__":`. Raises `MotionError` if there
    is no executable motion near another gait, `ClipError` for a clip that does not repeat."""
    robot = load_robot(source)
    clips = clips or [keypoints(gait, ClipOrigin(name)) for name, gait in _BUILT_IN.items()]
    for clip in clips:
        if not is_one_cycle(clip):
            name = clip.origin.name or "the clip"
            raise ClipError(f"{name} is not one period of a gait; 'fastmimic segment' finds those of a recording")
    size, found, before = length_ratio(robot), None, clips[0]
    speeds = [_speed(clip, robot) / size for clip in clips]
    widest = max((k for k, speed in enumerate(speeds) if speed <= _ABOUT * grid.forwards[-1]), default=0)
    for k, (clip, speed) in enumerate(zip(clips, speeds, strict=True)):
        own = grid if k == widest else slow(speed) if k < widest else fast(speed)
        try:
            made = _field(source, clip, robot, own.sized(size), found, progress, LocalExecutor(workers))
            if found is not None:
                made = dataclasses.replace(made, passages=_passages(robot, (before, clip), (found, made)))
        except MotionError as error:
            if k <= widest:
                raise
            _LOG.warning("left out: %s", error)
            continue
        found, before = made, clip
    assert found is not None
    return found


def gaits_of(clips: Sequence[Clip], note: Callable[[str], None] = lambda line: None) -> list[Clip]:
    """One period of each gait in the clips. What is one period already is taken as it is; of all the others, takes, the
    periods that repeat best follow, one of each footfall, the slowest first; each is noted. Where nothing repeats well,
    the best there is."""
    found = [clip for clip in clips if is_one_cycle(clip)]
    takes = [clip for clip in clips if not is_one_cycle(clip)]
    periods = [(segment, take) for take in takes for segment in find_segments(take) if segment.cycle is not None]
    periods.sort(key=lambda each: each[0].confidence)
    best = {segment.footfall: (segment, take) for segment, take in periods}  # the later one of a footfall stays
    for segment, take in sorted(best.values(), key=lambda each: each[0].speed_m_per_s):
        if segment.confidence >= min(_REPEATS, periods[-1][0].confidence):
            first, end = segment.cycle or (0, 0)
            name = f"{take.origin.name or 'the clip'}[{first}:{end}]"
            note(f"{name} is a period of a {segment.footfall}, {segment.speed_m_per_s:.2f} m/s")
            cut = dataclasses.replace(take.cut(first, end), is_cycle=True)
            found.append(cut.named(segment.footfall or segment.gait))
    return found or takes


def _speed(clip: Clip, robot: Robot) -> float:
    """A gait's own speed, m/s, at the robot's size."""
    motion, _ = retarget(clip, robot, cycle=True, executable=False)
    assert motion.cycle is not None
    return float(np.hypot(*motion.cycle[:2]) / motion.period_s)


def _field(
    source: str,
    clip: Clip,
    robot: Robot,
    grid: Grid,
    slower: GaitField | None,
    progress: Callable[[int, int], None],
    executor: LocalExecutor,
) -> GaitField:
    given = [np.array(grid.velocities()), clip.points_w]
    if clip.root_quat_wxyz is not None:
        given.append(clip.root_quat_wxyz)
    known = Remembered(repr(("gait field", robot.said, clip.rate_hz, clip.scale)), given, outcome=True)
    found = known.read()
    if found is None:
        found = _made(source, clip, robot, grid, progress, executor)
        known.keep(found, packaged=False)  # it is large, and made of what is
    rows, gains = (found[name].view(kind)[..., 0] for name, kind in (("rows", COURSE), ("gains", GAINS)))
    axes = [np.array(axis) for axis in (grid.forwards, grid.sideways, grid.turning)]
    return GaitField(clip.origin.name or "gait", robot, axes[0], axes[1], axes[2], rows, gains, slower)


def _made(
    source: str, clip: Clip, robot: Robot, grid: Grid, progress: Callable[[int, int], None], executor: LocalExecutor
) -> dict[str, Array]:
    """Rows and gains of all gaits, as bytes."""
    jobs = [(source, clip, velocity) for velocity in grid.velocities()]
    made: dict[int, tuple[Records, Records]] = {}
    for outcome in executor.run(make_gait, jobs):
        if outcome.error is not None:
            raise outcome.error
        made[outcome.index] = outcome.result
        progress(len(made), len(jobs))
    rows, gains = ([made[index][part] for index in range(len(jobs))] for part in (0, 1))
    stand = standing(robot)
    rows.append(np.repeat(course_of(stand, robot)[:1], len(rows[0])))
    gains.append(np.repeat(motion_gains(stand, robot, RegulatorConfig())[:1], len(gains[0])))
    return {name: np.stack(each)[..., None].view("u1") for name, each in (("rows", rows), ("gains", gains))}


def _passages(
    robot: Robot, clips: tuple[Clip, Clip], fields: tuple[GaitField, GaitField]
) -> tuple[Passage, Passage] | None:
    """From a gait to a faster one, and back, between the top speed of the slower one and the other's nearest. None if
    they need none; where both can stand between them, none that fails."""
    if fields[1].can_stand and rows_between(fields[0].contact, fields[1].contact, RATE_HZ)[0].max() >= 0:
        return None
    top = float(fields[0].forwards[-1])
    speeds = top, min(fields[1].forwards.tolist(), key=lambda speed: abs(speed - top))
    given = [np.array(speeds), *(clip.points_w for clip in clips), *(field.rows["root_z"] for field in fields)]
    known = Remembered(repr(("passages", robot.said, [clip.rate_hz for clip in clips])), given, outcome=True)
    found = known.read()
    if found is None:
        motions = [motion_at(robot, clip, (speed, 0.0, 0.0)) for clip, speed in zip(clips, speeds, strict=True)]
        found = {}
        for name, (one, other) in (("up", (0, 1)), ("down", (1, 0))):
            way = make_course_transition(robot, motions[one], motions[other], RegulatorConfig())
            if way is None and fields[1].can_stand:
                return None
            if way is None:
                raise MotionError(f"{robot.name} cannot go over from {fields[one].name} to {fields[other].name}")
            part = way.course[way.first : way.last]
            found[name] = part[..., None].view("u1")
            found[f"{name} gains"] = way.gains[part["gain"][::GAIN_SAMPLES]][..., None].view("u1")
            found[f"{name} at"] = np.array([way.leave, way.arrive])
        known.keep(found, packaged=False)
    (slow, fast), (slower, faster) = fields, speeds
    return _passage(found, "up", slow, fast, slower, faster), _passage(found, "down", fast, slow, faster, slower)


def _passage(
    found: dict[str, Array], name: str, one: GaitField, other: GaitField, before: float, after: float
) -> Passage:
    own, gains = found[name].view(COURSE)[..., 0], found[f"{name} gains"].view(GAINS)[..., 0]
    leave, arrive = (int(row) for row in found[f"{name} at"])
    k = other.straight(after)
    then = (arrive + np.arange(other.rows.shape[1])) % other.rows.shape[1]
    ahead = then[-len(own) % GAIN_SAMPLES :: GAIN_SAMPLES] // GAIN_SAMPLES
    rows = _anywhere(np.concatenate([own, other.rows[k, then]]), other.rows[-1, :1])
    gains = _anywhere(np.concatenate([gains, other.gains[k, ahead]]), other.gains[-1, :1])
    same = np.array([0.0, _SAME])
    field = GaitField(f"{one.name} to {other.name}", other.robot, after + same, same, np.full(2, _SAME), rows, gains)
    return Passage(field, len(own), leave, arrive, before, after)


def _anywhere(course: Records, stand: Records) -> Records:
    """The same (n,) at the 12 velocities of a passage, and last that of standing (1,) throughout."""
    return np.stack([*[course] * 12, np.repeat(stand, len(course))])


def make_gait(job: tuple[str, Clip, Velocity], report: Report) -> tuple[Records, Records]:
    """The rows (t,) of `COURSE` and gains (g,) of `GAINS` of a robot's gait at a velocity, or at a lower one."""
    source, clip, wanted = job
    robot = load_robot(source)
    motion = motion_at(robot, clip, wanted)
    return course_of(motion, robot), motion_gains(motion, robot, RegulatorConfig())


def motion_at(robot: Robot, clip: Clip, wanted: Velocity) -> Motion:
    """A robot's executable motion of a gait's period at a velocity, or at a lower one; raises `MotionError` if none."""
    for share in _SHARES:
        animal, _ = retarget(clip, robot, velocity=share * np.array(wanted), cycle=True, executable=False)
        motion = _executable(robot, animal)
        if motion is not None:
            return motion
    at = "{:g} m/s, {:g} m/s to the left, {:g} rad/s".format(*wanted)
    raise MotionError(f"{robot.name} cannot be steered by {clip.origin.name or 'this clip'}: no motion at {at}")


def _executable(robot: Robot, animal: Motion) -> Motion | None:
    """The nearest executable motion with the gait's own contacts, with which the robot does not fall."""
    for config in _KEPT:
        try:
            motion = nearest_executable(robot, animal, config).motion
        except MotionError:
            continue
        own = motion.n_samples == animal.n_samples and np.mean(motion.contact == animal.contact) >= _SAME_CONTACT
        if own and falls_with(share_of_falls, robot, motion) == 0.0:
            return motion
    return None
