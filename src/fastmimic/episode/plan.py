"""How episodes begin, and how long they last."""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from fastmimic.base.arrays import Array
from fastmimic.motion.motion import Motion

JOINT_NOISE: Final = 0.05  # rad, of perturbed starts
VELOCITY_NOISE: Final = 0.1  # m/s


@dataclass(frozen=True, eq=False)
class Start:
    """Starts of n episodes."""

    sample: NDArray[np.int64]  # (n,) index into the motion
    joint_offset: Array  # (n, 12) rad, added to the demonstration's joints
    velocity_offset: Array  # (n, 3) m/s, added to its base velocity, world frame
    stream: NDArray[np.int64] | None = None  # (n,) numbers of the random streams (`Conditions.seed`); 0 … n − 1 if None

    @property
    def n(self) -> int:
        return len(self.sample)

    def part(self, rows: slice | NDArray[np.int64]) -> "Start":
        """Some of the episodes, by indices also repeatedly."""
        return Start(self.sample[rows], self.joint_offset[rows], self.velocity_offset[rows], self.streams[rows])

    @property
    def streams(self) -> NDArray[np.int64]:
        """(n,) numbers of the episodes' random streams."""
        return self.stream if self.stream is not None else np.arange(self.n)


def nominal_start(n: int) -> Start:
    """n episodes from the motion's start, unperturbed."""
    return Start(np.zeros(n, np.int64), np.zeros((n, 12)), np.zeros((n, 3)))


def perturbed_start(n: int, n_samples: int, rng: np.random.Generator) -> Start:
    """n episodes: the first nominal, the others at a random phase, with perturbed joints and velocity. `n_samples` is
    the number of samples at which an episode may begin (`start_room`)."""
    start = nominal_start(n)
    for i in range(1, n):
        start.sample[i] = rng.integers(n_samples)
        start.joint_offset[i] = rng.uniform(-JOINT_NOISE, JOINT_NOISE, 12)
        start.velocity_offset[i] = rng.uniform(-VELOCITY_NOISE, VELOCITY_NOISE, 3)
    return start


def episode_steps(duration_s: float, rate_hz: float) -> int:
    """Control steps of an episode, at least one."""
    return max(1, math.ceil(duration_s * rate_hz - 1e-9))


def start_room(motion: Motion, duration_s: float) -> int:
    """Number of samples at which an episode may begin; a motion that does not repeat has to hold all of it."""
    if motion.cycle is not None:
        return motion.n_samples
    return max(1, motion.n_samples - math.ceil(duration_s * motion.rate_hz - 1e-9))


def default_duration(motion: Motion, seconds: float) -> float:
    """Default length of an episode: `seconds`, or the whole of a motion that does not repeat, s."""
    return seconds if motion.cycle is not None else motion.period_s - motion.dt


def episode_duration(motion: Motion, seconds: float) -> float:
    """Length of an episode: `seconds`, at most to the end of a motion that does not repeat, s."""
    return min(seconds, default_duration(motion, seconds))
