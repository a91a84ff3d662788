"""Uneven ground: a random height field, flat where episodes begin."""

from typing import Final

import numpy as np

from fastmimic.base.arrays import Array
from fastmimic.simulation.conditions import episode_generator

CELL_M: Final = 0.15
CELLS: Final = 400  # on each side: 60 m; episodes begin in the middle, and a robot that leaves the field falls
HALF_SIDE_M: Final = CELL_M * CELLS / 2
_FLAT_RADIUS_M: Final = 0.45
_FULL_RADIUS_M: Final = 0.9
_PURPOSE: Final = 71  # of the random stream
_TURN_PURPOSE: Final = 72


def rough_ground(roughness: float, seed: int) -> Array:
    """Heights (m) at the corners of the cells, (CELLS + 1, CELLS + 1), rows along y, columns along x. Uniform in ±
    `roughness`; zero within 0.45 m of the middle, rising to full height at 0.9 m."""
    heights = episode_generator(seed, 0, _PURPOSE).uniform(-roughness, roughness, (CELLS + 1, CELLS + 1))
    along = np.linspace(-HALF_SIDE_M, HALF_SIDE_M, CELLS + 1)
    radius = np.hypot(along[:, None], along[None])
    return heights * np.clip((radius - _FLAT_RADIUS_M) / (_FULL_RADIUS_M - _FLAT_RADIUS_M), 0.0, 1.0)


def turns(n: int, seed: int) -> Array:
    """Turn of the field about its middle for each episode, (n,) rad: each crosses different ground."""
    return np.array([episode_generator(seed, i, _TURN_PURPOSE).uniform(-np.pi, np.pi) for i in range(n)])
