"""The log of a run: only what a robot's computer knows of it."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, eq=False)
class RunLog:
    """One run over t control steps, as the robot's computer saw it. There is no field for the truth."""

    robot: str
    motion: str
    rate_hz: float  # control steps a second
    latency_s: float  # age of the readings of IMU and joints on arrival
    reading: NDArray[Any]  # (t,) of `READING`, the latest at the end of each step
    command: NDArray[Any]  # (t,) of `COMMAND`, the motors' commands for the step
    estimate: NDArray[Any]  # (t,) of `OBSERVATION`, the estimator's result
    stance: NDArray[np.bool_]  # (t, 4) legs that the gait planner let stand in the step

    @property
    def duration_s(self) -> float:
        """Length, s."""
        return len(self.reading) / self.rate_hz
