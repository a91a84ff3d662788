"""Motions by name, whose transitions are made in the background, and what a robot follows live among them."""

from collections.abc import Mapping
from concurrent.futures import BrokenExecutor, Executor, Future
from dataclasses import dataclass
from functools import cache
from typing import Any, Final

import numpy as np

from fastmimic.base.arrays import Array, Records
from fastmimic.base.errors import MotionError
from fastmimic.base.registry import Registry
from fastmimic.clips.catalogue import open_clip
from fastmimic.motion.motion import Motion
from fastmimic.reference.course import (
    CourseTransition,
    advance_place,
    course_of,
    fill_table,
    make_course_transition,
    make_place,
    make_work,
)
from fastmimic.reference.regulator import motion_gains
from fastmimic.reference.regulator_config import RegulatorConfig
from fastmimic.reference.standing import STAND, standing
from fastmimic.retargeting.retarget import retarget
from fastmimic.robot import Robot, load_robot

IN_PLACE: Final = "in-place"


@dataclass(frozen=True, eq=False)
class Entry:
    """A motion of the set; `course` and `demonstration` (t,) of `COURSE` are for the controller and the score, `gains`
    (g,) of `GAINS` are those that the course names."""

    name: str
    motion: Motion
    course: Records
    demonstration: Records
    gains: Records


class MotionSet:
    """Motions by name. Getting up ends in "stand", and motions without a direct transition pass through "in-place";
    both are always there, all in `entries`. Raises `MotionError` for a motion that does not repeat, or is for another
    robot or rate. The processes of `executor` make transitions in the background, with the robot loaded from `source`,
    a file or its name; without it, transitions are made when they are needed. `regulator` is the controller's."""

    def __init__(
        self,
        robot: Robot,
        motions: Mapping[str, Motion],
        rate_hz: float = 500.0,
        *,
        executor: Executor | None = None,
        source: str | None = None,
        regulator: RegulatorConfig = RegulatorConfig(),
    ) -> None:
        self.robot = robot
        self._regulator = regulator
        self._executor, self._source = executor, source if source is not None else robot.name
        self._transitions: dict[tuple[str, str], Future[CourseTransition | None]] = {}
        self._busy: Future[Any] | None = None
        every = {name: make(robot) for name, make in ALWAYS.items() if name not in motions} | dict(motions)
        entries = (_entry(name, each, robot, rate_hz, self._regulator) for name, each in every.items())
        self.entries = Registry("motion", entries)

    @property
    def names(self) -> tuple[str, ...]:
        """The names in the order of display."""
        return tuple(self.entries)

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
        return bool(self.entries[name].motion.contact.all())

    def _future(self, before: str, after: str) -> Future[CourseTransition | None]:
        key = (before, after)
        known = self._transitions.get(key)
        if known is None or (known.done() and isinstance(known.exception(), BrokenExecutor)):
            self._transitions[key] = self._made(self.entries[before].motion, self.entries[after].motion)
        return self._transitions[key]

    def _made(self, before: Motion, after: Motion) -> Future[CourseTransition | None]:
        """Computed in another process, or in this one if there is none."""
        if self._executor is not None:
            try:
                return self._executor.submit(_made_there, self._source, before, after, self._regulator)
            except BrokenExecutor:
                self._executor = None
        future: Future[CourseTransition | None] = Future()
        future.set_result(make_course_transition(self.robot, before, after, self._regulator))
        return future


def _entry(name: str, motion: Motion, robot: Robot, rate_hz: float, regulator: RegulatorConfig) -> Entry:
    if motion.cycle is None:
        raise MotionError(f"motion '{name}' does not repeat; only cyclic motions can be played")
    motion.check_rate(rate_hz, MotionError)
    motion.check_robot(robot.name)
    course = course_of(motion, robot)
    demonstration = course if motion.demonstration is None else course_of(motion.demonstration, robot)
    return Entry(name, motion, course, demonstration, motion_gains(motion, robot, regulator))


def in_place(robot: Robot) -> Motion:
    """The built-in trot without travel."""
    return retarget(open_clip("trot", robot=robot, speed=0.0), robot)[0]


ALWAYS: Final = {STAND: standing, IN_PLACE: in_place}
"""What makes the motions that every set has."""

_robot_of = cache(load_robot)


def warm_up(source: str) -> None:
    """Reads a robot, by name or file, once for the process."""
    _robot_of(source)


def _made_there(source: str, *given: Any) -> CourseTransition | None:
    return make_course_transition(_robot_of(source), *given)


class LiveReference:
    """The reference of one robot at `rate_hz` control steps a second. `goal` is the motion requested, `start` at first;
    `trouble` why the robot does not reach it, None if it does; `place` that of the reference (`make_place`)."""

    def __init__(self, robot: Robot, motions: MotionSet, rate_hz: float, start: str) -> None:
        self._motions = motions
        self._work, self._scratch = make_work(robot, 1.0 / rate_hz), make_place()
        self.place = make_place()
        self._transition: CourseTransition | None = None
        self._armed: tuple[str, CourseTransition] | None = None
        self.trouble: str | None = None
        self._entry = self._following = motions.entries[start]
        self.goal = start

    @property
    def motion(self) -> str:
        """The present motion; during a transition the one before it."""
        return self._entry.name

    @property
    def state(self) -> str:
        if self.trouble is not None:
            return self.trouble
        if self._transition is not None:
            return f"{self._entry.name} → {self._following.name}"
        if self.goal != self._entry.name:
            return f"{self._entry.name}, going to {self.goal}" + ("" if self._armed else " (preparing)")
        return self._entry.name

    def switch(self, name: str) -> None:
        """Changes to another motion as soon as feet and phase allow; raises `ConfigError` for an unknown one."""
        _ = self._motions.entries[name]
        self.goal, self.trouble = name, None
        self._disarm()

    def begin(self, name: str, pose: Array, row: int = 0) -> None:
        """Starts a motion at a row of its course and a pose (3,) of its root: x, y, yaw, world, m and rad."""
        self._entry = self._motions.entries[name]
        self.put(*pose)
        self.place["position"] = row

    def put(self, x: float, y: float, yaw: float) -> None:
        """Starts the present motion here; drops a transition."""
        self._transition = None
        self._disarm()
        self.place[...] = make_place()
        self.place["pose"][0] = (x, y, yaw)

    def stand(self, x: float, y: float, yaw: float) -> None:
        """Starts standing here."""
        self.begin(STAND, np.array([x, y, yaw]))

    def fill(self, rows: Records, *, scored: bool = False) -> None:
        """Fills rows of `SAMPLE` with the reference from now on; if `scored`, with the demonstration."""
        self._scratch[0] = self.place[0]
        fill_table(*self._courses(scored), self._scratch[0], self._work[0], rows)

    @property
    def demonstration(self) -> Motion:
        """The present motion as the controller knows it; during a transition the one before it."""
        return self._entry.motion

    @property
    def gains(self) -> Records:
        """The gains (g,) of `GAINS` that the present rows name."""
        return self._transition.gains if self._transition is not None else self._entry.gains

    def advance(self, base_xy: Array, haste: float = 0.0) -> None:
        """Advances by a control step that ended with the base at (2,), world, m; `haste` is the controller's."""
        advance_place(*self._courses(), self.place[0], 1.0 + max(haste, 0.0), True, base_xy[0], base_xy[1])
        if self.place["left"][0]:
            self._arrived()

    def _courses(self, scored: bool = False) -> tuple[Records, Records]:
        """The present course and the next, the same if none is known; if `scored`, those of the demonstration."""
        armed = self._entry if self._armed is None else self._armed[1]
        now, after = (self._entry, armed) if self._transition is None else (self._transition, self._following)
        return (now.demonstration, after.demonstration) if scored else (now.course, after.course)

    def update(self) -> None:
        """Looks for a path to the goal, and starts it."""
        if self._transition is not None or self.goal == self._entry.name or self.trouble is not None:
            return
        if self._armed is None:
            try:
                hop = self._motions.next_hop(self._entry.name, self.goal)
            except MotionError as error:
                self.trouble, self.goal = str(error), self._entry.name
                return
            if hop is None:
                return
            self._armed = hop
        _, transition = self._armed
        self.place["exit"], self.place["entry"] = transition.leave, transition.first

    def _arrived(self) -> None:
        """Handles the start or end of a transition."""
        self.place["exit"] = -1
        if self._transition is not None:
            self._transition = None
            self._entry = self._following
            return
        assert self._armed is not None
        name, self._transition = self._armed
        self._following = self._motions.entries[name]
        self._armed = None
        self.place["exit"], self.place["entry"] = self._transition.last, self._transition.arrive

    def _disarm(self) -> None:
        if self._transition is None:
            self._armed = None
            self.place["exit"] = -1
