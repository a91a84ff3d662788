"""Stitching's transitions between motions, as courses for a running robot."""

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from fastmimic.base.errors import MotionError
from fastmimic.motion.motion import Motion
from fastmimic.reference.course import course_of
from fastmimic.robot import Robot
from fastmimic.stitching.join import stitch_motions
from fastmimic.stitching.layout import Layout

_MARGIN: Final = 4  # rows of the motions before and after a transition, for interpolation
_JOINT_SPEED_SHARE: Final = 1.15
_SLIP_M: Final = 0.02
_UNREACHABLE: Final = 0.02  # share of the transition's samples with a foot out of reach
_MODULATED: Final = ("root_z", "lin_vel", "ang_vel", "foot")


@dataclass(frozen=True, eq=False)
class CourseTransition:
    """A transition between two cyclic motions, which leaves the first before row `leave` ≥ 1 and enters the second at
    `arrive`.

    `course` (t,) of `COURSE` is for the controller, with `_MARGIN` rows of the motions at either end, `demonstration`
    for the score. Rows [first, last) are the transition itself. `measured` holds figures as a stitched motion
    records them.
    """

    course: NDArray[Any]
    demonstration: NDArray[Any]
    first: int
    last: int
    leave: int
    arrive: int
    measured: dict[str, Any]

    @property
    def sound(self) -> bool:
        """Whether a robot can run it: feet in reach without slip, joints within their speeds."""
        m, rows = self.measured, self.last - self.first
        return bool(
            m["joint_speed_share"] <= _JOINT_SPEED_SHARE
            and m["slip_m"] <= _SLIP_M
            and m["unreachable"] <= _UNREACHABLE * rows
        )


def make_course_transition(robot: Robot, before: Motion, after: Motion) -> CourseTransition | None:
    """The transition between two cyclic motions, optimised or not; None if stitching finds none. It joins their
    demonstrations. An optimised motion's difference from its own is blended with the same weights."""
    try:
        stitched = stitch_motions(robot, [before.target, after.target], [_cycles(before), _cycles(after)])
    except MotionError:
        return None
    layout = Layout.of(stitched)
    first, second = layout.segments
    assert second.rebuilt is not None
    start, end = second.rebuilt.start, second.rebuilt.end
    rows = np.arange(max(start - _MARGIN, 0), min(end + _MARGIN, layout.n))
    demonstration = course_of(stitched, robot)
    course = demonstration.copy()
    trunk, feet = layout.trunk_weights(), layout.foot_weights()
    for i, (segment, motion) in enumerate(zip((first, second), (before, after), strict=True)):
        if motion.demonstration is None:
            continue
        at = (np.arange(layout.n) - segment.shift) % motion.n_samples
        own, target = course_of(motion, robot), course_of(motion.target, robot)
        for name in _MODULATED:
            share = feet[i][..., None] if name == "foot" else trunk[i]
            change = (own[name] - target[name])[at]
            course[name] += (share if change.ndim in (1, 3) else share[:, None]) * change
    return CourseTransition(
        course=course[rows],
        demonstration=demonstration[rows],
        first=start - int(rows[0]),
        last=end - int(rows[0]),
        leave=(start - 1) % before.n_samples + 1,
        arrive=(end - second.shift) % after.n_samples,
        measured=stitched.provenance.stitched.transitions[0],
    )


def _cycles(motion: Motion) -> int:
    """Enough cycles for any transition."""
    return max(2, round(3.0 / motion.period_s))
