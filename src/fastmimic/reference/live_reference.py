"""What a robot follows live: motions of a set, and the transitions between them."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from fastmimic.base.arrays import Array
from fastmimic.base.errors import MotionError
from fastmimic.motion.motion import Motion
from fastmimic.reference.course import CourseTransition
from fastmimic.reference.motion_set import MotionSet
from fastmimic.reference.standing import STAND
from fastmimic.reference.stream import Stream, make_place
from fastmimic.robot import Robot


class LiveReference:
    """The reference of one robot at `rate_hz` control steps a second. `goal` is the motion requested, `start` at first;
    `trouble` why the robot does not reach it, None if it does; `place` that of the reference, one record of
    `make_place`."""

    def __init__(self, robot: Robot, library: MotionSet, rate_hz: float, start: str) -> None:
        self._library = library
        self._stream = Stream(robot, rate_hz)
        self.place = make_place()
        self._transition: CourseTransition | None = None
        self._armed: tuple[str, CourseTransition] | None = None
        self.trouble: str | None = None
        self._entry = self._following = library.entry(start)
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
        self._library.entry(name)
        self.goal, self.trouble = name, None
        self._disarm()

    def begin(self, name: str, pose: Array, row: int = 0) -> None:
        """Starts a motion at a row of its course and a pose (3,) of its root: x, y, yaw, world, m and rad."""
        self._entry = self._library.entry(name)
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

    def fill(self, rows: NDArray[Any], *, scored: bool = False) -> None:
        """Fills rows of `SAMPLE` with the reference from now on; if `scored`, with the demonstration."""
        self._stream.fill(*self._courses(scored), self.place, rows)

    @property
    def demonstration(self) -> Motion:
        """The present motion as the controller knows it; during a transition the one before it."""
        return self._entry.motion

    @property
    def gains(self) -> NDArray[Any]:
        """The gains (g,) of `GAINS` that the present rows name."""
        return self._transition.gains if self._transition is not None else self._entry.gains

    def advance(self, base_xy: Array, haste: float = 0.0) -> None:
        """Advances by a control step that ended with the base at (2,), world, m; `haste` is the controller's."""
        self._stream.advance(*self._courses(), self.place, base_xy, haste)
        if self.place["left"][0]:
            self._arrived()

    def _courses(self, scored: bool = False) -> tuple[NDArray[Any], NDArray[Any] | None]:
        """The present course and the next, if known; if `scored`, those of the demonstration."""
        armed = None if self._armed is None else self._armed[1]
        now, after = (self._entry, armed) if self._transition is None else (self._transition, self._following)
        kind = "demonstration" if scored else "course"
        return getattr(now, kind), None if after is None else getattr(after, kind)

    def update(self) -> None:
        """Looks for a path to the goal, and starts it."""
        if self._transition is not None or self.goal == self._entry.name or self.trouble is not None:
            return
        if self._armed is None:
            try:
                hop = self._library.next_hop(self._entry.name, self.goal)
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
        self._following = self._library.entry(name)
        self._armed = None
        self.place["exit"], self.place["entry"] = self._transition.last, self._transition.arrive

    def _disarm(self) -> None:
        if self._transition is None:
            self._armed = None
            self.place["exit"] = -1
