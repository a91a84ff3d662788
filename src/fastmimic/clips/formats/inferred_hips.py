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
    """Fills in shoulders and hips of `points` (t, 10, 3), in the order of `POINT_NAMES`, z up, m, in which they are not
    read. Returns the points, the length of the legs, m, and a sentence that says what was assumed."""
    points = np.array(points)
    ahead = points[:, 1] - points[:, 0]
    heading = np.arctan2(ahead[:, 1], ahead[:, 0])[:, None]
    ground = float(np.percentile(points[:, 6:, 2], 10))
    heights = []
    for spine, hips, share in ((1, slice(2, 4), SHARE_OF_HEIGHT[0]), (0, slice(4, 6), SHARE_OF_HEIGHT[1])):
        above, toes = points[:, [spine]], points[:, hips.start + 4 : hips.stop + 4]
        right, left = np.median(rotate_planar(-heading, (toes - above)[..., :2]), axis=0)
        forward, half = 0.5 * (right + left)[0], 0.5 * (left - right)[1]
        offset = rotate_planar(heading, np.array([[forward, -half], [forward, half]]))
        points[:, hips, :2] = above[..., :2] + offset
        points[:, hips, 2] = above[..., 2] - (1.0 - share) * (above[..., 2].mean() - ground)
        heights.append(float(points[:, hips, 2].mean()) - ground)
    legs = LEGS_TO_HEIGHT * float(np.mean(heights))
    return (
        points,
        legs,
        (
            "shoulders and hips are not in the file: they are taken above the middle of the feet's places, as wide as"
            f" these, {heights[0]:.2f} and {heights[1]:.2f} m high, with legs of {legs:.2f} m, as a dog's"
        ),
    )
