"""`Skeleton`: the bones between an animal's points, for drawing."""

from dataclasses import dataclass
from typing import Final


@dataclass(frozen=True)
class Skeleton:
    """Bones between points, as pairs; `radii` are those of each bone with its flesh, m, at the animal's own size."""

    points: int
    bones: tuple[tuple[int, int], ...]
    radii: tuple[float, ...]


_SPINE, _SHOULDER, _LIMB = 0.075, 0.045, 0.026

KEYPOINTS: Final = Skeleton(
    10,
    ((0, 1), (1, 2), (1, 3), (0, 4), (0, 5), (2, 6), (3, 7), (4, 8), (5, 9)),
    (_SPINE, *4 * (_SHOULDER,), *4 * (_LIMB,)),
)
"""Of the ten points of `POINT_NAMES`: trunk, girdles, and a straight line for each leg."""


def _chain(first: int, *radii: float) -> list[tuple[int, int, float]]:
    """Bones from each point to the next, starting at `first`."""
    return [(first + i, first + i + 1, radius) for i, radius in enumerate(radii)]


_FORELEG: Final = (0.050, 0.038, 0.027, 0.021)
_HIND_LEG: Final = (0.050, 0.034, 0.022)
_DOG: Final = (
    *_chain(0, 0.072, 0.078, 0.088, 0.050, 0.032),  # pelvis, two of the spine, neck, head, nose
    *((3, first, 0.062) for first in (6, 11)),
    *_chain(6, *_FORELEG),
    *_chain(11, *_FORELEG),
    *((0, first, 0.062) for first in (16, 20)),
    *_chain(16, *_HIND_LEG),
    *_chain(20, *_HIND_LEG),
    (0, 24, 0.020),
    *_chain(24, 0.014, 0.010),
)
DOG: Final = Skeleton(27, tuple((a, b) for a, b, _ in _DOG), tuple(radius for *_, radius in _DOG))
"""Of the 27 points of the dog recordings: spine with head, four legs with their joints, tail."""
