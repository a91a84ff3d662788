"""A field of gaits: one gait at many velocities, each made executable, to be interpolated between.

The gait is an animal's, one period of it, or built in. What is changed is the trunk's mean velocity; the feet land
where the animal puts them under the trunk. So at equal phase the same feet stand: any mixture of neighbours is a gait
again, at the velocity between theirs, and the velocity can change in every control step. The axes of the grid are the
velocities forwards and to the left and the turn rate. The greatest turn rate depends on the forward velocity, as the
ground has to give their product as centripetal acceleration.
"""

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from itertools import product
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from fastmimic.base.arrays import Array
from fastmimic.base.errors import ClipError, MotionError
from fastmimic.clips.clip import Clip
from fastmimic.clips.synthesis import GAITS, keypoints
from fastmimic.episode.loop import share_of_falls
from fastmimic.executors import Report
from fastmimic.executors.local import LocalExecutor
from fastmimic.motion.motion import Motion
from fastmimic.reference.course import COURSE, course_of
from fastmimic.reference.regulator import GAINS, motion_gains
from fastmimic.reference.regulator_config import RegulatorConfig
from fastmimic.reference.standing import standing
from fastmimic.retargeting.retarget import is_one_cycle, retarget
from fastmimic.robot import Robot, load_robot
from fastmimic.trajectory.config import TrajectoryConfig
from fastmimic.trajectory.executable import falls_with, nearest_executable
from fastmimic.trajectory.solved import Remembered

RATE_HZ: Final = 500.0
_GAIT: Final = dataclasses.replace(GAITS["trot"], speed=0.5, duty=0.55, half_width=0.04, lift=0.09)
_SHARES: Final = (1.0, 0.8, 0.6, 0.4)  # of a velocity that are tried
_KEPT: Final = (
    TrajectoryConfig(keep_time=True, keep_speed=True),
    TrajectoryConfig(keep_speed=True),
    TrajectoryConfig(keep_time=True),
)
_SAME_CONTACT: Final = 0.97  # share of a gait's contacts that stay
_A1_LEG_M: Final = 0.4


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

    def velocities(self) -> list[tuple[float, float, float]]:
        """Those of all gaits (k = a · b · 3): turning to the right, not, and to the left."""
        pairs = zip(self.forwards, self.turning, strict=True)
        return [(x, y, side * most) for (x, most), y, side in product(pairs, self.sideways, (-1.0, 0.0, 1.0))]


@dataclass(frozen=True, eq=False)
class GaitField:
    """The gaits of one robot, at `RATE_HZ` control steps a second. The grid's axes are `forwards` (a,) and `sideways`
    (b,), m/s, and turn rates to the right, none, and to the left, of `turning` (a,), rad/s. `rows` (k + 1, t) of
    `COURSE` are one period of each gait in the order of the axes, and last of standing; `gains` (k + 1, g) of `GAINS`
    are theirs, one for each `GAIN_SAMPLES` rows."""

    robot: Robot
    forwards: Array
    sideways: Array
    turning: Array
    rows: NDArray[Any]
    gains: NDArray[Any]

    def nearest(self, velocity: Array) -> Array:
        """The velocity (3,) of the field that is nearest to one: forwards, to the left, m/s, and turning, rad/s."""
        forwards = np.clip(velocity[0], self.forwards[0], self.forwards[-1])
        sideways = np.clip(velocity[1], self.sideways[0], self.sideways[-1])
        most = np.interp(forwards, self.forwards, self.turning)
        return np.array([forwards, sideways, np.clip(velocity[2], -most, most)])


def gait_field(
    source: str,
    clip: Clip | None = None,
    progress: Callable[[int, int], None] = lambda done, count: None,
    *,
    grid: Grid = Grid(),
    workers: int | None = 1,
) -> GaitField:
    """The field of a robot, whose name or file is `source`, from one period of an animal's gait, or by default of a
    built-in trot. It is made once and kept in the user's cache folder: in a minute or two, or in seconds where its
    solutions are in the package, as those of the A1 and the Go2 with the built-in trot. `progress` is told how many of
    the gaits are done, and of how many. `workers` processes make it, as many as there are cores if None; a script that
    asks for several needs `if __name__ == "__main__":`. Raises `MotionError` if there is no executable motion near a
    gait, `ClipError` for a clip that does not repeat."""
    clip = clip if clip is not None else keypoints(_GAIT, {"name": "trot"})
    if not is_one_cycle(clip):
        name = clip.meta.get("name", "the clip")
        raise ClipError(f"{name} is not one period of a gait; 'fastmimic segment' finds those of a recording")
    robot = load_robot(source)
    grid = grid.sized(robot.leg_length / _A1_LEG_M)
    given = [np.array(grid.velocities()), clip.points_w]
    if clip.root_quat_wxyz is not None:
        given.append(clip.root_quat_wxyz)
    known = Remembered(repr(("gait field", robot, clip.rate_hz, clip.scale)), given, outcome=True)
    found = known.read()
    if found is None:
        found = _made(source, clip, robot, grid, progress, LocalExecutor(workers))
        known.keep(found, packaged=False)  # it is large, and made of what is
    rows, gains = (found[name].view(kind)[..., 0] for name, kind in (("rows", COURSE), ("gains", GAINS)))
    return GaitField(robot, np.array(grid.forwards), np.array(grid.sideways), np.array(grid.turning), rows, gains)


def _made(
    source: str, clip: Clip, robot: Robot, grid: Grid, progress: Callable[[int, int], None], executor: LocalExecutor
) -> dict[str, Array]:
    """Rows and gains of all gaits, as bytes."""
    jobs = [(source, clip, velocity) for velocity in grid.velocities()]
    made: dict[int, tuple[NDArray[Any], NDArray[Any]]] = {}
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


def make_gait(
    job: tuple[str, Clip, tuple[float, float, float]], report: Report = lambda share: None
) -> tuple[NDArray[Any], NDArray[Any]]:
    """The rows (t,) of `COURSE` and gains (g,) of `GAINS` of a robot's gait at a velocity; if there is none, those of a
    slower one."""
    source, clip, wanted = job
    robot = load_robot(source)
    for share in _SHARES:
        animal, _ = retarget(clip, robot, velocity=share * np.array(wanted), cycle=True, executable=False)
        motion = _executable(robot, animal)
        if motion is not None:
            return course_of(motion, robot), motion_gains(motion, robot, RegulatorConfig())
    at = "{:g} m/s, {:g} m/s to the left, {:g} rad/s".format(*wanted)
    raise MotionError(f"{robot.name} cannot be steered by {clip.meta.get('name', 'this clip')}: no motion at {at}")


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
