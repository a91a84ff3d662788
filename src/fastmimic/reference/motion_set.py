"""Motions by name; their transitions are made in the background."""

from collections.abc import Callable, Mapping
from concurrent.futures import BrokenExecutor, Executor, Future
from dataclasses import dataclass
from functools import cache
from typing import Any, Final, TypeVar

from numpy.typing import NDArray

from fastmimic.base.errors import MotionError, unknown
from fastmimic.clips.catalogue import open_clip
from fastmimic.motion.motion import Motion
from fastmimic.reference.course import CourseTransition, course_of, make_course_transition
from fastmimic.reference.regulator import motion_gains
from fastmimic.reference.regulator_config import RegulatorConfig
from fastmimic.reference.standing import STAND, standing
from fastmimic.retargeting.retarget import retarget
from fastmimic.robot import Robot, load_robot

_Result = TypeVar("_Result")

IN_PLACE: Final = "in-place"


@dataclass(frozen=True, eq=False)
class Entry:
    """A motion of the set; `course` and `demonstration` (t,) of `COURSE` are for the controller and the score, `gains`
    (g,) of `GAINS` are those that the course names."""

    name: str
    motion: Motion
    course: NDArray[Any]
    demonstration: NDArray[Any]
    gains: NDArray[Any]


class MotionSet:
    """Motions by name. Getting up ends in "stand", and motions without a direct transition pass through "in-place";
    both are always there. Raises `MotionError` for a motion that does not repeat, or is for another robot or rate. The
    processes of `executor` make transitions in the background, and load the robot from `source`, a file or by default
    the robot's name; without it they are made when they are needed. `regulator` is the controller's."""

    def __init__(
        self,
        robot: Robot,
        motions: Mapping[str, Motion],
        rate_hz: float = 500.0,
        *,
        executor: Executor | None = None,
        source: str | None = None,
        regulator: RegulatorConfig | None = None,
    ) -> None:
        self.robot = robot
        self._regulator = regulator if regulator is not None else RegulatorConfig()
        self._executor, self._source = executor, source if source is not None else robot.name
        self._transitions: dict[tuple[str, str], Future[CourseTransition | None]] = {}
        self._busy: Future[Any] | None = None
        every = {name: make(robot) for name, make in ALWAYS.items() if name not in motions} | dict(motions)
        self.entries = {name: _entry(name, each, robot, rate_hz, self._regulator) for name, each in every.items()}

    @property
    def names(self) -> tuple[str, ...]:
        """The names in the order of display."""
        return tuple(self.entries)

    def entry(self, name: str) -> Entry:
        """A motion; raises `ConfigError` for an unknown name."""
        if name not in self.entries:
            raise unknown("motion", name, self.names)
        return self.entries[name]

    def next_hop(self, now: str, goal: str) -> tuple[str, CourseTransition] | None:
        """The next motion on the way from `now` to `goal` and the transition to it; None while that is being made.
        Raises `MotionError`: no sequence of transitions leads there."""
        near = IN_PLACE in (now, goal)
        direct = near or not (self._stands(now) or self._stands(goal))  # from standing, step in place first
        for after in (*([goal] if direct else []), *([] if near else [IN_PLACE])):
            transition = self._future(now, after)
            if after != goal:
                self._future(after, goal)  # which is needed next
            if not transition.done():
                return None
            if (found := transition.result()) is not None:
                return after, found
        raise MotionError(f"no transitions lead from '{now}' to '{goal}'")

    def prepare(self, now: str) -> None:
        """Starts making a transition that may be needed next, unless one is still being made."""
        if self._executor is None or (self._busy is not None and not self._busy.done()):
            return
        hub = [] if now == IN_PLACE else [(now, IN_PLACE), *((IN_PLACE, other) for other in self.names)]
        direct = [] if self._stands(now) else [(now, other) for other in self.names if not self._stands(other)]
        for before, after in (*hub[:1], *direct, *hub[1:]):
            if before != after and (before, after) not in self._transitions:
                self._busy = self._future(before, after)
                return

    def _stands(self, name: str) -> bool:
        """Whether no foot ever lifts off."""
        return bool(self.entry(name).motion.contact.all())

    def _future(self, before: str, after: str) -> Future[CourseTransition | None]:
        key = (before, after)
        known = self._transitions.get(key)
        if known is None or (known.done() and isinstance(known.exception(), BrokenExecutor)):
            a, b = self.entry(before).motion, self.entry(after).motion
            self._transitions[key] = self._made(make_course_transition, a, b, self._regulator)
        return self._transitions[key]

    def _made(self, make: Callable[..., _Result], *given: Any) -> "Future[_Result]":
        """Computed in another process, or in this one if there is none."""
        if self._executor is not None:
            try:
                return self._executor.submit(_made_there, self._source, make, *given)
            except BrokenExecutor:
                self._executor = None
        future: Future[_Result] = Future()
        future.set_result(make(self.robot, *given))
        return future


def _entry(name: str, motion: Motion, robot: Robot, rate_hz: float, regulator: RegulatorConfig) -> Entry:
    if motion.cycle is None:
        raise MotionError(f"motion '{name}' does not repeat; only cyclic motions can be played")
    if abs(motion.rate_hz - rate_hz) > 1e-9:
        raise MotionError(f"motion '{name}' has {motion.rate_hz:g} samples a second; expected {rate_hz:g}")
    motion.check_robot(robot.name)
    course = course_of(motion, robot)
    demonstration = course if motion.demonstration is None else course_of(motion.demonstration, robot)
    return Entry(name, motion, course, demonstration, motion_gains(motion, robot, regulator))


def in_place(robot: Robot) -> Motion:
    """The built-in trot without travel."""
    motion, _ = retarget(open_clip("trot", robot=robot, speed=0.0), robot)
    return motion


ALWAYS: Final = {STAND: standing, IN_PLACE: in_place}
"""What makes the motions that every set has."""

_robot_of = cache(load_robot)


def warm_up(source: str) -> None:
    """Reads a robot, by name or file, once for the process."""
    _robot_of(source)


def _made_there(source: str, make: Callable[..., _Result], *given: Any) -> _Result:
    return make(_robot_of(source), *given)
