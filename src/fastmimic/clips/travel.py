"""The way of an animal whose recording does not travel: on a treadmill, or with the trunk's path taken out of it.

A standing foot stays where it is on the ground. If the recording's own frame moves over the ground by v and turns by ω,
then v + ω × p + u = 0 for a standing foot at p whose velocity in the recording is u. Least squares over all low feet
give v and ω; ω only where the heading was taken out as well. Weights of feet that do not fit fall away, so swings near
the ground do not count. A paw rolls forward over its toes but never back while it carries weight: feet that move back
count more. Smoothness in time carries the solution over phases of flight.
"""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from fastmimic.base.arrays import Array
from fastmimic.base.errors import ClipError, did_you_mean
from fastmimic.base.rotations import quat_from_yaw, quat_multiply, rotate_planar
from fastmimic.clips.clip import Clip

TRAVEL: Final = ("auto", "recover", "as-is")

_LOW: Final = 0.25  # height of a standing foot, share of the greatest nearby
_SLIP: Final = 0.1  # speed of a standing foot over the ground, share of the fastest foot's nearby
_BACKWARDS: Final = 6.0  # weight of feet that move back over the ground
_NEARBY_S: Final = 0.75
_SWAY_S: Final = 0.2
_SMOOTH_S: Final = 0.05
_SMOOTH_TURN: Final = 10.0  # how much more slowly the frame turns than it moves
_ROUNDS: Final = 15
_NO_HEADING_RAD: Final = 0.01  # standard deviation below which a heading was taken out: an animal's is above 0.02
_LEAST_FLOW: Final = 0.5  # of the ground below the low feet of an animal on the spot, share of all feet's speed
_LARGEST_WAY: Final = 0.2  # speed of a trunk that does not travel, share of the ground's below it


@dataclass(frozen=True, eq=False)
class _Recording:
    """Feet (t, 4, 2) from the mean of the trunk and velocities (t, 4, 2) in the recording, m and m/s, with the weights
    (t, 4) of their heights; `centre` (2,) is that mean, and `turns` whether the frame may turn."""

    feet: Array
    velocity: Array
    low: Array
    centre: Array
    turns: bool
    rate_hz: float

    @property
    def size(self) -> float:
        """RMS distance of the feet from the trunk, m."""
        return float(np.sqrt(np.mean(np.sum(self.feet**2, axis=-1))))

    @property
    def rows(self) -> Array:
        """(t, 4, 2, 3): velocity of the ground below each foot for a unit of v and of ω."""
        rows = np.zeros((*self.feet.shape, 3))
        rows[..., 0, 0] = rows[..., 1, 1] = 1.0
        rows[..., 2] = np.stack([-self.feet[..., 1], self.feet[..., 0]], axis=-1) * self.turns
        return rows


def with_travel(clip: Clip, travel: str = "auto") -> Clip:
    """The clip with the way that its standing feet show, in place of a trunk that does not travel.

    Args:
        travel: "auto" recovers it where the recording lacks it, "recover" always, and "as-is" never.

    The clip's `assumed` says what was found. Raises `ClipError` for another word.
    """
    if travel not in TRAVEL:
        raise ClipError(
            f"travel is {', '.join(TRAVEL[:-1])} or {TRAVEL[-1]}, found '{travel}'{did_you_mean(travel, TRAVEL)}"
        )
    moving = _rms(np.gradient(clip.toes_w[..., :2], 1.0 / clip.rate_hz, axis=0))
    way = min(_speed(path, clip.rate_hz) for path in (_trunk(clip), clip.point("pelvis")[:, :2]))
    if travel == "as-is" or moving == 0 or (travel == "auto" and way > _LARGEST_WAY * moving):
        return clip
    if travel == "recover":
        clip = _on_the_spot(clip)
    recording = _recording(clip)
    twist = _twist(recording)
    flow = _rms(np.einsum("tfia,ta->tfi", recording.rows, twist), recording.low)
    if travel == "auto" and (flow < _LEAST_FLOW * moving or way > _LARGEST_WAY * flow):
        return clip
    moved = _moved(clip, twist, recording.centre)
    found = f"the way of the trunk ({_speed(_trunk(moved), clip.rate_hz):.2f} m/s) is recovered from the standing feet"
    why = "" if travel == "recover" else ": they run back while the trunk stays where it is (--travel as-is keeps it)"
    heading = ", and its heading too" if recording.turns else ""
    return replace(moved, meta=clip.meta | {"assumed": [*clip.meta.get("assumed", []), found + heading + why]})


def _rms(vectors: Array, weight: Array | None = None) -> float:
    return float(np.sqrt(np.average(np.sum(vectors**2, axis=-1), weights=weight)))


def _heading(clip: Clip) -> Array:
    ahead = clip.point("neck") - clip.point("pelvis")
    return np.unwrap(np.arctan2(ahead[:, 1], ahead[:, 0]))


def _trunk(clip: Clip) -> Array:
    """(t, 2) m."""
    return 0.5 * (clip.point("neck") + clip.point("pelvis"))[:, :2]


def _speed(path: Array, rate_hz: float) -> float:
    """Mean speed along a path (t, 2), m/s, without what sways within 0.2 s."""
    step = min(max(1, round(_SWAY_S * rate_hz)), len(path) - 1)
    steps = np.diff(path[::step], axis=0)
    return float(np.linalg.norm(steps, axis=1).mean() * rate_hz / step)


def _on_the_spot(clip: Clip) -> Clip:
    """The clip without the way of its trunk."""
    way = np.concatenate([_trunk(clip), np.zeros((clip.n_frames, 1))], axis=1)[:, None]
    body = None if clip.body_w is None else clip.body_w - way
    return replace(clip, points_w=clip.points_w - way, body_w=body)


def _nearby(values: Array, rate_hz: float) -> Array:
    """The largest of (t, ...) within 0.75 s."""
    from scipy.ndimage import maximum_filter1d

    return np.asarray(maximum_filter1d(values, 2 * round(_NEARBY_S * rate_hz) + 1, axis=0, mode="nearest"))


def _recording(clip: Clip) -> _Recording:
    height = np.maximum(clip.toes_w[..., 2] - np.percentile(clip.toes_w[..., 2], 10, axis=0), 0.0)
    share = height / np.maximum(_nearby(height, clip.rate_hz), 1e-3)
    centre = _trunk(clip).mean(axis=0)
    feet = clip.toes_w[..., :2] - centre
    return _Recording(
        feet=feet,
        velocity=np.gradient(feet, 1.0 / clip.rate_hz, axis=0),
        low=np.exp(-((share / _LOW) ** 2)),
        centre=centre,
        turns=bool(_heading(clip).std() < _NO_HEADING_RAD),
        rate_hz=clip.rate_hz,
    )


def _twist(recording: _Recording) -> Array:
    """v and ω of the recording's frame, (t, 3), m/s and rad/s, in its own axes."""
    rows, weight = recording.rows, recording.low
    fastest = _nearby(np.linalg.norm(recording.velocity, axis=-1).max(axis=1), recording.rate_hz)
    slip = _SLIP * np.maximum(fastest, recording.size)[:, None]
    twist = np.zeros((len(rows), 3))
    for k in range(_ROUNDS):
        twist = _smooth_fit(recording, rows, weight)
        ground = np.einsum("tfia,ta->tfi", rows, twist)
        rest = ground + recording.velocity
        tolerated = slip * max(1.0, 3.0 - k / 3)  # wide at first: the swings still pull the solution
        back = np.sum(rest * ground, axis=-1) < 0
        fits = 1.0 / (1.0 + np.sum(rest**2, axis=-1) / tolerated**2) ** 2
        weight = recording.low * fits * np.where(back, _BACKWARDS, 1.0)
    return twist


def _smooth_fit(recording: _Recording, rows: Array, weight: Array) -> Array:
    """The twist (t, 3) that makes weighted feet stand, with its changes at a price: a banded system."""
    from scipy.linalg import solveh_banded

    n, k = len(rows), 3
    matrix = np.einsum("tf,tfia,tfib->tab", weight, rows, rows)
    right = -np.einsum("tf,tfia,tfi->ta", weight, rows, recording.velocity)
    price = (_SMOOTH_S * recording.rate_hz) ** 2 * np.array([1.0, 1.0, _SMOOTH_TURN * recording.size**2])
    neighbours = np.full(n, 2.0)
    neighbours[[0, -1]] = 1.0
    band = np.zeros((k + 1, n, k))  # the lower diagonals, frame by frame
    for a in range(k):
        for b in range(a + 1):
            band[a - b, :, b] = matrix[:, a, b]
    band[0] += price * neighbours[:, None] + 1e-9
    band[k] = -price
    solved = solveh_banded(band.reshape(k + 1, n * k), right.ravel(), lower=True)
    return np.asarray(solved.reshape(n, k))


def _moved(clip: Clip, twist: Array, centre: Array) -> Clip:
    """The clip in a frame that stays on the ground, from the twist (t, 3) of its own about `centre` (2,)."""

    def integral(rate: Array) -> Array:
        steps = 0.5 * (rate[1:] + rate[:-1]) / clip.rate_hz
        return np.concatenate([np.zeros((1, *rate.shape[1:])), np.cumsum(steps, axis=0)])

    angle = integral(twist[:, 2])
    place = centre + integral(rotate_planar(angle, twist[:, :2]))

    def move(points: Array) -> Array:
        out = np.array(points)
        out[..., :2] = rotate_planar(angle[:, None], points[..., :2] - centre) + place[:, None]
        return out

    quat = clip.root_quat_wxyz
    return replace(
        clip,
        points_w=move(clip.points_w),
        body_w=None if clip.body_w is None else move(clip.body_w),
        root_quat_wxyz=None if quat is None else quat_multiply(quat_from_yaw(angle), quat),
    )
