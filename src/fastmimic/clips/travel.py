"""The way of an animal whose recording does not travel: on a treadmill, or with the trunk's path taken out of it.

If the trunk moves over the ground by v and turns by ω, then v + ω × p + u = 0 for a standing foot at p from the trunk
whose velocity from it is u. Robust least squares over all low feet give v, and ω where the heading was taken out as
well. A paw rolls forward over its toes but hardly back while it carries weight, so feet that move back count more. A
trunk changes its speed slowly: that carries the solution over phases of flight.
"""

from dataclasses import replace
from typing import Final, NamedTuple

import numpy as np

from fastmimic.base.arrays import Array
from fastmimic.base.errors import ClipError, unknown
from fastmimic.base.rotations import quat_from_yaw, quat_multiply, rotate_planar
from fastmimic.clips.clip import Clip

TRAVEL: Final = ("auto", "recover", "as-is")

_LOW: Final = 0.4  # height of a standing foot, share of the greatest nearby
_SLIP: Final = 0.1  # speed of a standing foot over the ground, share of the fastest foot's nearby
_BACKWARDS: Final = 2.8  # weight of feet that move back over the ground
_NEARBY_S: Final = 0.75
_SWAY_S: Final = 0.2
_SMOOTH_S: Final = 0.2
_ROUNDS: Final = 15
_NO_HEADING_RAD: Final = 0.01  # standard deviation below which a heading was taken out: an animal's is above 0.02
_LEAST_FLOW: Final = 0.5  # of the ground below the low feet of an animal on the spot, share of all feet's speed
_LARGEST_WAY: Final = 0.2  # speed of a trunk that does not travel, share of the ground's below it


class _Feet(NamedTuple):
    """The velocities (t, 4, 2) of the feet in the recording and of the ground below them, `rows` (t, 4, 2, 3), for a
    unit of v and of ω; how low they are (t, 4), from 0 to 1; and their RMS distance from the trunk, m."""

    velocity: Array
    rows: Array
    low: Array
    size: float


def with_travel(clip: Clip, travel: str = "auto") -> Clip:
    """The clip with the way that its standing feet show, in place of a trunk that does not travel. `travel` "auto"
    recovers it where the recording lacks it, "recover" always, and "as-is" never; the clip's `assumed` says what was
    found. Raises `ClipError` for another word."""
    if travel not in TRAVEL:
        raise unknown("travel", travel, TRAVEL, ClipError)
    moving = _rms(np.gradient(clip.toes_w[..., :2], 1.0 / clip.rate_hz, axis=0))
    way = min(_speed(path, clip.rate_hz) for path in (_trunk(clip), clip.point("pelvis")[:, :2]))
    if travel == "as-is" or moving == 0 or (travel == "auto" and way > _LARGEST_WAY * moving):
        return clip
    still = np.concatenate([_trunk(clip), np.zeros((clip.n_frames, 1))], axis=1)[:, None]
    body = None if clip.body_w is None else clip.body_w - still
    recorded, clip = clip, replace(clip, points_w=clip.points_w - still, body_w=body)
    ahead = clip.point("neck") - clip.point("pelvis")
    no_heading = bool(np.unwrap(np.arctan2(ahead[:, 1], ahead[:, 0])).std() < _NO_HEADING_RAD)
    feet = _feet(clip, no_heading)
    twist = _twist(feet, clip.rate_hz)
    flow = _rms(np.einsum("tfia,ta->tfi", feet.rows, twist), feet.low)
    if travel == "auto" and (flow < _LEAST_FLOW * moving or way > _LARGEST_WAY * flow):
        return recorded
    moved = _moved(clip, twist)
    way, heading = _speed(_trunk(moved), clip.rate_hz), " and its heading" if no_heading else ""
    found = f"the way of the trunk{heading} ({way:.2f} m/s) is recovered from the standing feet"
    if travel != "recover":
        found += ": they run back while the trunk stays where it is (--travel as-is keeps it)"
    return replace(moved, meta=clip.meta | {"assumed": [*clip.meta.get("assumed", []), found]})


def _rms(vectors: Array, weight: Array | None = None) -> float:
    return float(np.sqrt(np.average(np.sum(vectors**2, axis=-1), weights=weight)))


def _trunk(clip: Clip) -> Array:
    """(t, 2) m."""
    return 0.5 * (clip.point("neck") + clip.point("pelvis"))[:, :2]


def _speed(path: Array, rate_hz: float) -> float:
    """Mean speed along a path (t, 2), m/s, without what sways within 0.2 s."""
    step = min(max(1, round(_SWAY_S * rate_hz)), len(path) - 1)
    steps = np.diff(path[::step], axis=0)
    return float(np.linalg.norm(steps, axis=1).mean() * rate_hz / step)


def _nearby(values: Array, rate_hz: float) -> Array:
    """The largest of (t, ...) within 0.75 s."""
    from scipy.ndimage import maximum_filter1d

    return np.asarray(maximum_filter1d(values, 2 * round(_NEARBY_S * rate_hz) + 1, axis=0, mode="nearest"))


def _feet(clip: Clip, no_heading: bool) -> _Feet:
    height = np.maximum(clip.toes_w[..., 2] - np.percentile(clip.toes_w[..., 2], 10, axis=0), 0.0)
    share = height / np.maximum(_nearby(height, clip.rate_hz), 1e-3)
    place = clip.toes_w[..., :2]
    rows = np.zeros((*place.shape, 3))
    rows[..., 0, 0] = rows[..., 1, 1] = 1.0
    if no_heading:
        rows[..., 2] = np.stack([-place[..., 1], place[..., 0]], axis=-1)
    return _Feet(np.gradient(place, 1.0 / clip.rate_hz, axis=0), rows, np.exp(-((share / _LOW) ** 2)), _rms(place))


def _twist(feet: _Feet, rate_hz: float) -> Array:
    """v and ω of the trunk, (t, 3), m/s and rad/s, in the recording's axes."""
    fastest = _nearby(np.linalg.norm(feet.velocity, axis=-1).max(axis=1), rate_hz)
    slip = _SLIP * np.maximum(fastest, feet.size)[:, None]
    weight, twist = feet.low, np.zeros((len(feet.low), 3))
    for k in range(_ROUNDS):
        twist = _smooth_fit(feet, weight, rate_hz)
        ground = np.einsum("tfia,ta->tfi", feet.rows, twist)
        rest = ground + feet.velocity
        tolerated = slip * max(1.0, 3.0 - k / 3)  # wide at first: the swings still pull the solution
        back = np.sum(rest * ground, axis=-1) < 0
        fits = 1.0 / (1.0 + np.sum(rest**2, axis=-1) / tolerated**2) ** 2
        weight = feet.low * fits * np.where(back, _BACKWARDS, 1.0)
    return twist


def _smooth_fit(feet: _Feet, weight: Array, rate_hz: float) -> Array:
    """The twist (t, 3) that makes weighted feet stand, with its changes at a price: a banded system."""
    from scipy.linalg import solveh_banded

    matrix = np.einsum("tf,tfia,tfib->tab", weight, feet.rows, feet.rows)
    right = -np.einsum("tf,tfia,tfi->ta", weight, feet.rows, feet.velocity)
    price = (_SMOOTH_S * rate_hz) ** 2 * np.array([1.0, 1.0, feet.size**2])
    matrix[:, [0, 1, 2], [0, 1, 2]] += 2.0 * price + np.maximum(1e-9, 1e-12 * price)  # also at 10 kHz definite
    matrix[[0, -1]] -= np.diag(price)  # which have one neighbour
    band = np.zeros((4, len(right), 3))  # the lower diagonals, frame by frame
    for a in range(3):
        for b in range(a + 1):
            band[a - b, :, b] = matrix[:, a, b]
    band[3] = -price
    return np.asarray(solveh_banded(band.reshape(4, -1), right.ravel(), lower=True).reshape(right.shape))


def _moved(clip: Clip, twist: Array) -> Clip:
    """The clip, whose trunk is at the origin, moved by the trunk's twist (t, 3)."""
    from scipy.integrate import cumulative_trapezoid

    dt = 1.0 / clip.rate_hz
    angle = cumulative_trapezoid(twist[:, 2], dx=dt, initial=0)
    place = cumulative_trapezoid(rotate_planar(angle, twist[:, :2]), dx=dt, axis=0, initial=0)

    def move(points: Array) -> Array:
        out = np.array(points)
        out[..., :2] = rotate_planar(angle[:, None], points[..., :2]) + place[:, None]
        return out

    quat = clip.root_quat_wxyz
    return replace(
        clip,
        points_w=move(clip.points_w),
        body_w=None if clip.body_w is None else move(clip.body_w),
        root_quat_wxyz=None if quat is None else quat_multiply(quat_from_yaw(angle), quat),
    )
