"""Shoulders and hips of an animal of which only the spine and the feet were recorded.

They lie below the spine's points and above the middle of the feet's places, so that the legs swing evenly to both
sides. How far below, and how long the legs are, follows from the proportions of the dog of the public recordings.
"""

from typing import Final

import numpy as np

from fastmimic.base.arrays import Array
from fastmimic.base.rotations import rotate_planar

SHARE_OF_HEIGHT: Final = (0.85, 0.89)  # of shoulders below the withers and of hips below the croup, above the ground
LEGS_TO_HEIGHT: Final = 1.3  # upper and lower leg, straight, to the mean height of shoulders and hips


def with_hips(points: Array) -> tuple[Array, float, str]:
    """Fills in shoulders and hips.

    Args:
        points: (t, 10, 3) in the order of `POINT_NAMES`, z up, m; those of shoulders and hips are not read.

    Returns the points with them, the length of the legs, m, and a sentence that says what was assumed.
    """
    points = np.array(points)
    spine, toes = points[:, [1, 0]], points[:, 6:]
    ahead = points[:, 1] - points[:, 0]
    heading = np.arctan2(ahead[:, 1], ahead[:, 0])
    ground = float(np.percentile(toes[..., 2], 10))
    heights, widths = [], []
    for pair, share in enumerate(SHARE_OF_HEIGHT):
        feet = slice(6 + 2 * pair, 8 + 2 * pair)
        from_spine = rotate_planar(-heading[:, None], (points[:, feet] - spine[:, [pair]])[..., :2])
        forward = np.median(from_spine[..., 0])
        half = 0.5 * float(np.median(from_spine[:, 1, 1] - from_spine[:, 0, 1]))  # left less right
        drop = (1.0 - share) * float(np.mean(spine[:, pair, 2]) - ground)
        offset = np.array([[forward, -half], [forward, half]])
        hips = points[:, 2 + 2 * pair : 4 + 2 * pair]
        hips[..., :2] = spine[:, [pair], :2] + rotate_planar(heading[:, None], offset)
        hips[..., 2] = spine[:, [pair], 2] - drop
        heights.append(float(np.mean(hips[..., 2])) - ground)
        widths.append(2.0 * half)
    legs = LEGS_TO_HEIGHT * float(np.mean(heights))
    return (
        points,
        legs,
        (
            "shoulders and hips are not in the file: they are taken above the middle of the feet's places,"
            f" {widths[0]:.2f} and {widths[1]:.2f} m apart, {heights[0]:.2f} and {heights[1]:.2f} m high, with legs of"
            f" {legs:.2f} m, as a dog of that height has them"
        ),
    )
