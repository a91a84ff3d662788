"""The way of an animal whose recording does not travel: on a treadmill, or with the trunk's path taken out of it.

If the trunk moves over the ground by v and turns by ω, then v + ω × p + u = 0 for a standing foot at p from the trunk
whose velocity from it is u. Robust least squares over all low feet give v, and ω where the heading was taken out as
well. A paw rolls forward over its toes but hardly back while it carries weight, so feet that move back count more.
A trunk's speed changes within a stride as the ground's force has it, which points from the feet that stand to the trunk
with the load that the trunk's height shows; other changes have a price. That carries the solution over phases of flight
and of push-off, when paws roll and the trunk is fastest.
"""

from dataclasses import replace
from typing import Final, NamedTuple

import numpy as np

from fastmimic.base.arrays import Array
from fastmimic.base.conventions import GRAVITY
from fastmimic.base.errors import ClipError, unknown
from fastmimic.base.rotations import quat_from_yaw, quat_multiply, rotate_planar
from fastmimic.clips.clip import Clip

TRAVEL: Final = ("auto", "recover", "as-is")

_LOW: Final = 0.35  # height of a standing foot, share of the greatest nearby
_SLIP: Final = 0.1  # speed of a standing foot over the ground, share of the fastest foot's nearby
_BACKWARDS: Final = 2.4  # weight of feet that move back over the ground
_NEARBY_S: Final = 0.75
_SWAY_S: Final = 0.2
_SMOOTH_S: Final = 0.2
_TURNS: Final = 0.13  # price of changes of ω, share of that of v
_STRIDE_S: Final = 0.1  # slower changes of the ground's force are not known: the centre of mass is not quite the trunk
_SHAKE_S: Final = 0.02
_MOST_LOAD: Final = 3.0  # on the feet, times the weight
_MASS_HEIGHT: Final = 0.88  # of the centre of mass, share of the trunk's between neck and pelvis
_ROUNDS: Final = 15
_NO_HEADING_RAD: Final = 0.01  # standard deviation below which a heading was taken out: an animal's is above 0.02
_LEAST_FLOW: Final = 0.5  # of the ground below the low feet of an animal on the spot, share of all feet's speed
_LARGEST_WAY: Final = 0.2  # speed of a trunk that does not travel, share of the ground's below it


class _Feet(NamedTuple):
    """The places (t, 4, 2) and velocities of the feet in the recording, and those of the ground below them, `rows`
    (t, 4, 2, 3), for a unit of v and of ω; how low they are (t, 4), from 0 to 1; their RMS distance from the trunk, m;
    and the trunk's acceleration (t,), for each metre that it is off the feet, m/s²."""

    place: Array
    velocity: Array
    rows: Array
    low: Array
    size: float
    load: Array


def with_travel(clip: Clip, travel: str = "auto") -> Clip:
    """The clip with the way that its standing feet show, if its trunk does not travel (`travel` "auto"), always
    ("recover") or never ("as-is"); its `assumed` says what was found. Raises `ClipError` for another word."""
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
    return replace(moved, origin=replace(clip.origin, assumed=(*clip.origin.assumed, found)))


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
    size, low = _rms(place), np.exp(-((share / _LOW) ** 2))
    trunk = 0.5 * (clip.point("neck") + clip.point("pelvis"))[:, 2]
    load = np.clip(GRAVITY + _smoothed(trunk, _SHAKE_S, clip.rate_hz, order=2), 0.0, _MOST_LOAD * GRAVITY)
    load /= np.maximum(_MASS_HEIGHT * (trunk - np.percentile(clip.toes_w[..., 2], 10)), 0.5 * size)
    return _Feet(place, np.gradient(place, 1.0 / clip.rate_hz, axis=0), rows, low, size, load)


def _smoothed(values: Array, sigma_s: float, rate_hz: float, order: int = 0) -> Array:
    """A Gaussian mean of (t, ...), or its derivative of that order."""
    from scipy.ndimage import gaussian_filter1d

    sigma = max(sigma_s * rate_hz, 0.5)
    return np.asarray(gaussian_filter1d(values, sigma, axis=0, order=order, mode="nearest")) * rate_hz**order


def _twist(feet: _Feet, rate_hz: float) -> Array:
    """v and ω of the trunk, (t, 3), m/s and rad/s, in the recording's axes."""
    fastest = _nearby(np.linalg.norm(feet.velocity, axis=-1).max(axis=1), rate_hz)
    slip = _SLIP * np.maximum(fastest, feet.size)[:, None]
    weight, twist = feet.low, np.zeros((len(feet.low), 3))
    for k in range(_ROUNDS):
        twist = _smooth_fit(feet, weight, _pushed(feet, weight, rate_hz), rate_hz)
        ground = np.einsum("tfia,ta->tfi", feet.rows, twist)
        rest = ground + feet.velocity
        tolerated = slip * max(1.0, 3.0 - k / 3)  # wide at first: the swings still pull the solution
        back = np.sum(rest * ground, axis=-1) < 0
        fits = 1.0 / (1.0 + np.sum(rest**2, axis=-1) / tolerated**2) ** 2
        weight = feet.low * fits * np.where(back, _BACKWARDS, 1.0)
    return twist


def _pushed(feet: _Feet, weight: Array, rate_hz: float) -> Array:
    """The quick part of the trunk's acceleration (t, 2) by the weighted feet, m/s²."""
    weight = weight[..., None] + 1e-3
    below = np.sum(weight * feet.place, axis=1) / np.sum(weight, axis=1)
    pushed = -feet.load[:, None] * below
    return pushed - _smoothed(pushed, _STRIDE_S, rate_hz)


def _smooth_fit(feet: _Feet, weight: Array, pushed: Array, rate_hz: float) -> Array:
    """The twist (t, 3) that makes weighted feet stand, with its changes, other than by `pushed` (t, 2), at a price: a
    banded system."""
    from scipy.linalg import solveh_banded

    matrix = np.einsum("tf,tfia,tfib->tab", weight, feet.rows, feet.rows)
    right = -np.einsum("tf,tfia,tfi->ta", weight, feet.rows, feet.velocity)
    price = (_SMOOTH_S * rate_hz) ** 2 * np.array([1.0, 1.0, _TURNS * feet.size**2])
    change = price[:2] * 0.5 * (pushed[1:] + pushed[:-1]) / rate_hz
    right[1:, :2] += change
    right[:-1, :2] -= change
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
