"""What the controller sees with sensors only: readings, the estimate from them, and a clock of its own."""

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from fastmimic.base.arrays import Array, Records
from fastmimic.base.jit import floats, kernel, record_dtype
from fastmimic.base.vectors import quat_to_matrix
from fastmimic.estimation.estimator import Estimator
from fastmimic.reference.table import advance_clocks
from fastmimic.robot import Robot
from fastmimic.simulation.conditions import Conditions, episode_generator, make_world
from fastmimic.simulation.sensors import Sensors

MIN_DISTANCE: Final = 0.5  # m; a robot that stays where it is has no drift per distance
_SENSORS: Final = 1  # number of the sensors' random stream

_ERRORS: Final = record_dtype(
    [("steps", "i8"), *floats(velocity_sq=(), height_sq=(), tilt_sq=(), heading=(), offset=2, distance=(), last=2)]
)  # running sums of one robot's errors until the fall; `heading` and `offset` (x, y) are the present ones


@dataclass(frozen=True, eq=False)
class EstimationErrors:
    """Estimate against truth in n episodes, until the fall or the end, (n,) each: errors of the base's velocity vector,
    m/s, and height, m; the angle between the true and the estimated vertical, rad; at the end the heading's error, rad,
    and the horizontal one in % of the distance travelled, NaN if that is less than 0.5 m; and (n, 4) whether each foot
    sensor counts at the end."""

    velocity_rmse: Array
    position_drift: Array
    height_rmse: Array
    tilt_rmse: Array
    heading_error: Array
    foot_sensors: NDArray[np.bool_]


@kernel
def _compare(truths: Any, estimates: Any, tallies: Any, errors: Any, work: Array) -> None:
    """Adds the present errors of the robots that have not fallen; `work` (2, 3, 3) is scratch."""
    for i in range(truths.shape[0]):
        if tallies[i].fallen == 1:
            continue
        e, truth, estimate = errors[i], truths[i], estimates[i]
        e.steps += 1
        for k in range(3):
            d = estimate.lin_vel[k] - truth.lin_vel[k]
            e.velocity_sq += d * d
        d = estimate.root_pos[2] - truth.root_pos[2]
        e.height_sq += d * d
        quat_to_matrix(truth.root_quat, work[0])
        quat_to_matrix(estimate.root_quat, work[1])
        up = work[0, 2, 0] * work[1, 2, 0] + work[0, 2, 1] * work[1, 2, 1] + work[0, 2, 2] * work[1, 2, 2]
        e.tilt_sq += np.arccos(min(max(up, -1.0), 1.0)) ** 2
        d = np.arctan2(work[1, 1, 0], work[1, 0, 0]) - np.arctan2(work[0, 1, 0], work[0, 0, 0])
        e.heading = np.arctan2(np.sin(d), np.cos(d))
        x, y = truth.root_pos[0], truth.root_pos[1]
        e.offset[0], e.offset[1] = estimate.root_pos[0] - x, estimate.root_pos[1] - y
        e.distance += np.hypot(x - e.last[0], y - e.last[1])
        e.last[0], e.last[1] = x, y


class Observer:
    """Sensors and estimator of n robots, and their controllers' clocks."""

    def __init__(self, robot: Robot, n: int, rate_hz: float, conditions: Conditions) -> None:
        world = make_world(conditions.disturbances, n, conditions.simulator)
        self.sensors = Sensors(robot, n, rate_hz, conditions.sensors, world)
        self.estimator = Estimator(robot, n, rate_hz, conditions.estimator)
        self._seed = conditions.seed
        self._errors = np.zeros(n, _ERRORS)
        self._work = np.zeros((2, 3, 3))
        self.clocks = np.zeros(0)

    def reset(
        self, truth: Records, starts: Records, planned: NDArray[np.int64], episodes: NDArray[np.int64], clocks: Records
    ) -> Records:
        """Begins n episodes; returns the controller's first observation, (n,) of `OBSERVATION`, as is `truth`, which
        the sensors measure. `starts` (n,) of `START` are the robots' known starts; `planned` (n, 4) says whether each
        leg should stand; `episodes` (n,) are the numbers of the episodes' random streams, and `clocks` (n,) of `CLOCK`
        the initial state of the controller's own."""
        self.clocks = clocks.copy()
        self._errors[...] = np.zeros((), _ERRORS)
        self._errors["last"] = truth["root_pos"][:, :2]
        generators = [episode_generator(self._seed, int(e), _SENSORS) for e in episodes]
        return self.estimator.reset(self.sensors.reset(generators, truth), starts, planned)

    def look(self, truth: Records, memory: Records, tables: Records) -> Records:
        """The observation after a control step, with the controller's clocks advanced. `memory` (n,) of `MEMORY` is the
        controller's; other arguments as for `reset`."""
        told = self.estimator.step(self.sensors.measure(truth, self.sensors.command), memory["stance"])
        advance_clocks(self.clocks, tables, told["root_pos"], memory["haste"])
        return told

    def compare(self, truth: Records, tallies: Records) -> None:
        """Adds the present errors of the robots that have not fallen by their `TALLY`."""
        _compare(truth, self.estimator.observation, tallies, self._errors, self._work)

    def errors(self) -> EstimationErrors:
        """The errors since the reset."""
        e = self._errors
        steps = np.maximum(e["steps"], 1)
        far = e["distance"] >= MIN_DISTANCE
        percent = 100.0 * np.hypot(e["offset"][:, 0], e["offset"][:, 1]) / np.where(far, e["distance"], 1.0)
        return EstimationErrors(
            velocity_rmse=np.sqrt(e["velocity_sq"] / steps),
            position_drift=np.where(far, percent, np.nan),
            height_rmse=np.sqrt(e["height_sq"] / steps),
            tilt_rmse=np.sqrt(e["tilt_sq"] / steps),
            heading_error=e["heading"].copy(),
            foot_sensors=self.estimator.believed,
        )
