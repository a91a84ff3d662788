"""A motion in its own moving frame. Each sample is in the heading frame of the reference's root, and the root's path is
the step to the next sample. A cycle is then periodic, a motion continuous into a transition, and gaits can be mixed.
Stitching's transitions between motions are courses, too."""

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from fastmimic.base.errors import MotionError
from fastmimic.base.jit import floats, integers, record_dtype
from fastmimic.base.rotations import (
    quat_from_yaw,
    quat_multiply,
    quat_rotate,
    turned_about_z,
    yaw_from_quat,
)
from fastmimic.motion.motion import Motion
from fastmimic.reference.regulator import motion_gains
from fastmimic.reference.regulator_config import RegulatorConfig
from fastmimic.reference.table import reference_table
from fastmimic.retargeting.track import steps
from fastmimic.robot import Robot
from fastmimic.stitching.join import default_cycles, stitch_motions
from fastmimic.stitching.transition import Layout

COURSE: Final = record_dtype(
    [
        *floats(step=2, turn=(), root_z=(), tilt=4, lin_vel=3, ang_vel=3, lin_acc=3, ang_acc=3),
        *floats(leg_lin_acc=3, leg_ang_acc=3, foot=(4, 3)),
        ("contact", "i8", 4),
        *integers(sync=(), gain=()),
    ]
)
"""One sample, heading frame of the root, SI units: `step` and `turn` of the root to the next sample; `tilt` heading →
body; velocities and accelerations, also those of the legs (`SAMPLE`); `foot` from the root on the ground, z of its
centre; `gain` of `SAMPLE`."""


def course_of(motion: Motion, robot: Robot) -> NDArray[Any]:
    """A cycle or stitched motion, at the controller's rate, as an array (t,) of `COURSE`."""
    table = reference_table(motion, robot)
    course = np.zeros(motion.n_samples, COURSE)
    yaw = np.unwrap(yaw_from_quat(table["root_quat"]))
    course["step"], course["turn"] = steps(table["root_pos"][:, :2], yaw, motion.cycle)
    course["root_z"] = table["root_pos"][:, 2]
    course["tilt"] = quat_multiply(quat_from_yaw(-yaw), table["root_quat"])
    for name in ("lin_vel", "ang_vel", "lin_acc", "ang_acc", "leg_lin_acc", "leg_ang_acc"):
        course[name] = turned_about_z(table[name], -yaw)
    course["foot"] = quat_rotate(course["tilt"][:, None], table["foot_pos"])
    course["foot"][..., 2] += course["root_z"][:, None]
    course["contact"] = table["contact"]
    course["sync"], course["gain"] = table["sync"], table["gain"]
    return course


_MARGIN: Final = 4  # rows of the motions before and after a transition, for interpolation
_OPTIMISED: Final = ("root_z", "lin_vel", "ang_vel", "foot")


@dataclass(frozen=True, eq=False)
class CourseTransition:
    """A transition between two cyclic motions: it leaves one before row `leave` ≥ 1 and enters the other at `arrive`.

    `course` (t,) of `COURSE` is for the controller, with `_MARGIN` rows of the motions at either end, `demonstration`
    for the score. Rows [first, last) are the transition itself. `gains` (g,) of `GAINS` are those that the rows name.
    """

    course: NDArray[Any]
    demonstration: NDArray[Any]
    first: int
    last: int
    leave: int
    arrive: int
    gains: NDArray[Any]


def make_course_transition(
    robot: Robot, before: Motion, after: Motion, regulator: RegulatorConfig
) -> CourseTransition | None:
    """The transition between two cyclic motions, optimised or not; None if no executable one joins them. It joins their
    demonstrations. An optimised motion's difference from its own is blended with the same weights."""
    try:
        stitched = stitch_motions(
            robot, [before.target, after.target], [max(2, default_cycles(m)) for m in (before, after)]
        )
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
        for name in _OPTIMISED:
            share = feet[i][..., None] if name == "foot" else trunk[i]
            change = (own[name] - target[name])[at]
            course[name] += (share if change.ndim in (1, 3) else share[:, None]) * change
    course, demonstration = course[rows], demonstration[rows]
    used = slice(int(course["gain"][0]), int(course["gain"][-1]) + 1)
    course["gain"] -= used.start
    return CourseTransition(
        course=course,
        demonstration=demonstration,
        first=start - int(rows[0]),
        last=end - int(rows[0]),
        leave=(start - 1) % before.n_samples + 1,
        arrive=(end - second.shift) % after.n_samples,
        gains=motion_gains(stitched, robot, regulator)[used],
    )
