"""`Clip`: an animal's motion as points in space, and the bones between them for drawing."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from fastmimic.base.arrays import Array
from fastmimic.base.conventions import LARGEST, LEGS
from fastmimic.base.errors import ClipError, check_positive
from fastmimic.base.files import packaged


@dataclass(frozen=True)
class Skeleton:
    """Bones between points, as pairs; `radii` are those of each bone with its flesh, m, at the animal's own size."""

    points: int
    bones: tuple[tuple[int, int], ...]
    radii: tuple[float, ...]


KEYPOINTS: Final = Skeleton(
    10, ((0, 1), (1, 2), (1, 3), (0, 4), (0, 5), (2, 6), (3, 7), (4, 8), (5, 9)), (0.075, *4 * (0.045,), *4 * (0.026,))
)
"""Of the ten points of `POINT_NAMES`: trunk, girdles, and a straight line for each leg."""

_DOG: Final = packaged("fastmimic.clips", "dog.json", dict[str, Any])
_BONES: Final = [bone for part in _DOG["bones"].values() for bone in part]
DOG: Final = Skeleton(_DOG["points"], tuple((a, b) for a, b, _ in _BONES), tuple(radius for *_, radius in _BONES))
"""Of the 27 points of the dog recordings: spine with head, four legs with their joints, tail."""
DOG_KEYPOINTS: Final[dict[str, int]] = _DOG["keypoints"]
"""Indices of the ten among them; left and right follow from the points' positions (up × forward)."""

POINT_NAMES: Final = ("pelvis", "neck", *(f"{leg}_hip" for leg in LEGS), *(f"{leg}_toe" for leg in LEGS))
"""`hip` is the shoulder of a front leg."""


def not_in_clip(frames: tuple[int, int], n_frames: int) -> ClipError:
    """The error for frames (first, end) that a clip does not have."""
    said = f"frames {frames[0]}:{frames[1]} are not in this clip of {n_frames} frames"
    return ClipError(f"{said} (0-based, end exclusive: 0:{n_frames} is all of it)")


@dataclass(frozen=True)
class ClipOrigin:
    """Where a clip comes from, and how it was read.

    Attributes:
        name: of the motion that it becomes.
        source: the file's name, or the place of a named recording.
        format: one of `fastmimic.clips.formats.FORMATS`, or "built-in".
        frames: (first, end) in the file of a part of it; the end is exclusive.
        parts: (first, end) of all parts of a take that long gaps split.
        robot: to which joint angles in the file belong.
        loop: what the file says of its repetition, in its own words.
        parameters: of a built-in gait, changed from its own ones.
        assumed: in reading it; sentences for the user.
        licence, credit: of the recording; None if unknown.
    """

    name: str | None = None
    source: str | None = None
    format: str | None = None
    frames: tuple[int, int] | None = None
    parts: tuple[tuple[int, int], ...] | None = None
    robot: str | None = None
    loop: Mapping[str, Any] | None = None
    parameters: Mapping[str, float] | None = None
    assumed: tuple[str, ...] = ()
    licence: str | None = None
    credit: str | None = None

    def __str__(self) -> str:
        return self.source or self.name or "the clip"


@dataclass(frozen=True, eq=False)
class Clip:
    """Keypoints of an animal (or of another robot) in the world, z up, metres.

    Attributes:
        points_w: (t, 10, 3) keypoints in the order of `POINT_NAMES`, world frame, m.
        rate_hz: frames a second.
        root_quat_wxyz: (t, 4) trunk orientation, if the source has it; else retargeting derives it from the keypoints.
        is_cycle: whether the clip is one period; None if the source does not say.
        leg_length_m: upper plus lower leg of the source's body, for scaling; None if unknown.
        scale: factor from the source's size to the robot's if the source fixes it (1.0 for a robot's own motion).
        origin: where it comes from.
        body_w: (t, k, 3) all points of the source's skeleton if it has more than the ten; only for drawing.
        skeleton: the bones between the drawn points.
    """

    points_w: Array
    rate_hz: float
    root_quat_wxyz: Array | None = None
    is_cycle: bool | None = None
    leg_length_m: float | None = None
    scale: float | None = None
    origin: ClipOrigin = ClipOrigin()
    body_w: Array | None = None
    skeleton: Skeleton = KEYPOINTS

    def __repr__(self) -> str:
        n, rate = len(self.points_w), self.rate_hz
        return f"<Clip {self.origin.source or 'without a source'}: {n} frames at {rate:g} Hz, {n / rate:.2f} s>"

    def __post_init__(self) -> None:
        shape = self.points_w.shape
        if len(shape) != 3 or shape[1:] != (len(POINT_NAMES), 3):
            raise ClipError(f"keypoints have shape {shape}; expected (frames, {len(POINT_NAMES)}, 3)")
        if shape[0] < 2:
            raise ClipError(f"a clip needs at least 2 frames, found {shape[0]}")
        if (wrong := ~(np.abs(self.points_w) <= LARGEST)).any():
            frame = int(np.argwhere(wrong)[0][0])
            raise ClipError(f"frame {frame} holds a value that is not finite, or beyond {LARGEST:g} m")
        check_positive(self.rate_hz, "frame rate", ClipError)
        if self.root_quat_wxyz is not None and self.root_quat_wxyz.shape != (shape[0], 4):
            raise ClipError(f"trunk quaternions have shape {self.root_quat_wxyz.shape}; expected ({shape[0]}, 4)")
        if self.drawn_w.shape != (drawn := (shape[0], self.skeleton.points, 3)):
            raise ClipError(f"the skeleton's points have shape {self.drawn_w.shape}; expected {drawn}")

    @property
    def n_frames(self) -> int:
        return self.points_w.shape[0]

    @property
    def drawn_w(self) -> Array:
        """The points that `skeleton` joins, (t, k, 3), world frame, m."""
        return self.points_w if self.body_w is None else self.body_w

    def point(self, name: str) -> Array:
        """Trajectory of one keypoint, (t, 3), world frame, m."""
        return self.points_w[:, POINT_NAMES.index(name)]

    @property
    def hips_w(self) -> Array:
        """Shoulders and hips, (t, 4, 3), legs in the common order, world frame, m."""
        return self.points_w[:, 2:6]

    @property
    def toes_w(self) -> Array:
        """Toes, (t, 4, 3), legs in the common order, world frame, m."""
        return self.points_w[:, 6:10]

    def named(self, name: str) -> "Clip":
        """The clip of a motion of that name."""
        return replace(self, origin=replace(self.origin, name=name))

    def cut(self, start: int, end: int) -> "Clip":
        """Frames [start, end), 0-based; raises `ClipError` if they are not in the clip."""
        if not 0 <= start < end <= self.n_frames:
            raise not_in_clip((start, end), self.n_frames)
        return replace(
            self,
            points_w=self.points_w[start:end],
            root_quat_wxyz=None if self.root_quat_wxyz is None else self.root_quat_wxyz[start:end],
            body_w=None if self.body_w is None else self.body_w[start:end],
            is_cycle=self.is_cycle if (start, end) == (0, self.n_frames) else None,
            origin=replace(self.origin, frames=(start, end)),
        )
