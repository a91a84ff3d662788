"""An animal's or a robot's points from any file: their names, and from the file's axes and unit to the world's, z up
and metres, by the animal: its hips are above its toes, its left is on the left, and no leg is as long as three metres.
A point map is a JSON object that names a file's point for each of the ten of `POINT_NAMES`. `Tracks` are what a file of
tracked points or joints holds, in its own names, axes and unit."""

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from fastmimic.base.arrays import Array
from fastmimic.base.errors import ClipError, did_you_mean
from fastmimic.base.files import read_json
from fastmimic.base.machine import optional
from fastmimic.base.rotations import quat_continuous, quat_rotate, rotate_planar
from fastmimic.clips.clip import POINT_NAMES, Clip, ClipOrigin, Skeleton
from fastmimic.clips.formats.gaps import Part, bridged, fill_gaps, part_for
from fastmimic.clips.formats.point_names import BUILT_IN, HIP_NAMES, UNKNOWN, PointMap, guess
from fastmimic.clips.formats.text_table import check_rate

_EXAMPLE: Final = json.dumps(BUILT_IN["AI4Animation's dog"])

NORM_TOLERANCE: Final = 2e-3  # rounding to three decimals changes a unit quaternion's norm by up to 1e-3
SHARE_OF_HEIGHT: Final = (0.85, 0.89)  # of shoulders below the withers and of hips below the croup, above the ground
LEGS_TO_HEIGHT: Final = 1.3  # upper and lower leg, straight, to the mean height of shoulders and hips
_TO_Z_UP: Final = {"y": (2, 0, 1), "z": (0, 1, 2), "x": (1, 2, 0)}
"""Columns that make an axis of the file the vertical one, without a reflection; for its opposite, two are negated."""
UP_AXES: Final = (*_TO_Z_UP, *(f"-{axis}" for axis in _TO_Z_UP))
_MIN_UPRIGHT: Final = 0.5  # least vertical share of the mean toe → hip vector; 0.95 in takes in which the dog also sits
_UNITS: Final = ((3000.0, 0.0, "pixels"), (160.0, 1e-3, "millimetres"), (3.0, 1e-2, "centimetres"))
"""Units other than metres, with the least distance from toes to hips in the file's numbers (a horse's is 1.2 m)."""
_CROSSED: Final = 0.5  # share of the pairs' width; legs that cross under the body are narrow, not crossed on average
_STEP_S: Final = 0.4  # within which a toe that walks stands for a moment
_FLAT: Final = 0.3  # largest thickness of the ground as a share of its width, for a plane to be fitted
_LEAST_TILT_RAD: Final = np.radians(3.0)


def read_point_map(path: str | Path) -> dict[str, str]:
    """Reads a point map, which may lack all four hips; raises `ClipError` unless a JSON object names each point."""
    found = read_json(path, ClipError)
    if not all(isinstance(name, str) for name in found.values()):
        raise ClipError(f"{path}: a point map is a JSON object of names, such as {_EXAMPLE}")
    unknown = sorted(found.keys() - set(POINT_NAMES))
    missing = [name for name in POINT_NAMES if name not in found]
    if missing == list(HIP_NAMES):
        missing = []
    if unknown or missing:
        words = [f"does not know '{unknown[0]}'{did_you_mean(unknown[0], POINT_NAMES)}"] if unknown else []
        words += [f"lacks {', '.join(missing)}"] if missing else []
        raise ClipError(f"{path}: this point map {' and '.join(words)}; it needs {', '.join(POINT_NAMES)}")
    return found


def choose(names: Sequence[str], given: PointMap | None) -> tuple[list[int | None], list[str]]:
    """Indices (10,) of the ten points among a file's `names`, None for hips that it lacks, and a sentence on what was
    assumed: a known set of names, or a guess from their words. Raises `ClipError` with a map to complete: none fits."""
    maps = BUILT_IN if given is None else {"": given}
    if given is not None and len(set(given.values())) < len(given):
        twice = next(source for source in given.values() if [*given.values()].count(source) > 1)
        roles = " and ".join(name for name, source in given.items() if source == twice)
        raise ClipError(f"the point map names '{twice}' as {roles}; each point is one of them")
    for title, points in maps.items():
        if all(source in names for source in points.values()):
            return _indices(names, points), [f"points are named as {title}"] if title else []
    if given is not None:
        lost = next(source for source in given.values() if source not in names)
        said = f"the point map names '{lost}', which the file does not have{did_you_mean(lost, names)}"
        raise ClipError(f"{said}; it has {_listed(names)}")
    guessed = guess(names)
    known = {name: source for name, source in guessed.items() if source != UNKNOWN}
    if guessed.keys() - known.keys() not in (set(), set(HIP_NAMES)):
        said = f"some of the ten points are not known by name: it has {_listed(names)}"
        raise ClipError(f"{said}; complete this point map and give it as --point-map FILE.json: {json.dumps(guessed)}")
    listed = ", ".join(f"{name} {source}" for name, source in known.items())
    return _indices(names, known), [f"points are guessed by name ({listed}); --point-map says otherwise"]


def _indices(names: Sequence[str], points: PointMap) -> list[int | None]:
    return [names.index(points[name]) if name in points else None for name in POINT_NAMES]


@dataclass(frozen=True)
class FileAxes:
    """`up` is the file's vertical axis, with its sign; `unit` is `factor` metres; `tilt` (3, 3) levels the ground."""

    up: str
    unit: str
    factor: float
    tilt: Array | None = None
    notes: tuple[str, ...] = ()  # for the user

    def to_world(self, points: Array) -> Array:
        """Points (..., 3) in the world, m."""
        signs = np.array([1, -1, -1] if self.up.startswith("-") else [1, 1, 1])
        turned = self.factor * np.ascontiguousarray(points[..., _TO_Z_UP[self.up[-1]]]) * signs
        return turned if self.tilt is None else turned @ self.tilt.T


def find_axes(points: Array, rate_hz: float, up: str | None, unit_m: float | None, is_level: bool) -> FileAxes:
    """The axes and unit of the ten points (t, 10, 3) in a file, all finite; `up` and `unit_m` as known, or None. If not
    `is_level`, they are a camera's: standing toes show the ground. Raises `ClipError`: not upright, or too large."""
    notes = []
    if up is None:
        vector = _toe_to_hip(points)
        axis = int(np.argmax(np.abs(vector[[2, 1, 0]])))
        up = ("" if vector[2 - axis] > 0 else "-") + "zyx"[axis]
        notes.append(f"{up} is up: the hips lie above the toes along it")
    factor, unit = (unit_m, "the unit that it names") if unit_m is not None else _unit(points)
    axes = FileAxes(up, unit, factor)
    tilt = None if is_level else _levelling(axes.to_world(points), rate_hz)
    if tilt is not None:
        degrees = np.degrees(np.arccos(np.clip(tilt[2, 2], -1.0, 1.0)))
        notes.append(f"the ground under the standing toes is tilted by {degrees:.0f}° in the file: levelled")
    axes = FileAxes(up, unit, factor, tilt, tuple(notes))
    _check_upright(axes.to_world(points), up)
    return axes


def _unit(points: Array) -> tuple[float, str]:
    legs = float(np.mean(np.linalg.norm(points[:, 2:6] - points[:, 6:10], axis=-1)))
    factor, name = next(((factor, name) for least, factor, name in _UNITS if legs > least), (1.0, "metres"))
    if not factor:
        said = f"the legs are {legs:.0f} units long, more than any animal's in millimetres"
        raise ClipError(f"{said}; pixels have no unit of length: triangulate in that of the calibration board")
    return factor, name


def _toe_to_hip(points: Array) -> Array:
    """Mean vector from the toes to the hips, (3,)."""
    return np.asarray(np.mean(points[:, 2:6] - points[:, 6:10], axis=(0, 1)))


def _levelling(points: Array, rate_hz: float) -> Array | None:
    """The rotation (3, 3) that makes level the ground under the standing toes; None if it nearly is. Across a straight
    path, where a plane is too narrow, the hips lie above the toes."""
    from scipy.ndimage import minimum_filter1d

    toes = points[:, 6:10]
    speed = np.linalg.norm(np.gradient(toes, axis=0), axis=2)
    standing = toes[speed <= minimum_filter1d(speed, 2 * round(_STEP_S * rate_hz / 2) + 1, axis=0)]
    _, spread, directions = np.linalg.svd(standing - standing.mean(axis=0), full_matrices=False)
    above = _toe_to_hip(points)
    along = directions[0]
    normal = directions[2] if spread[2] < _FLAT * spread[1] else above - (above @ along) * along
    normal = normal * np.sign(normal @ above) / np.linalg.norm(normal)
    if np.arccos(np.clip(normal[2], -1.0, 1.0)) < _LEAST_TILT_RAD:
        return None
    from scipy.spatial.transform import Rotation

    axis = np.cross(normal, [0.0, 0.0, 1.0])
    angle = np.arctan2(np.linalg.norm(axis), normal[2])
    return np.asarray(Rotation.from_rotvec(angle * axis / np.linalg.norm(axis)).as_matrix())


def _check_upright(points: Array, up: str) -> None:
    vector = _toe_to_hip(points)
    if not vector[2] >= _MIN_UPRIGHT * np.linalg.norm(vector) > 0:
        offset = f"mean offset {vector[2]:.3g} m of {np.linalg.norm(vector):.3g} m"
        said = f"the hips do not lie above the toes along {up} ({offset})"
        raise ClipError(f"{said}; the vertical axis must be one of the file's")


def check_right_handed(points: Array) -> None:
    """Raises `ClipError` for a mirrored file, which would swap left and right turns."""
    if _widths(points)[:2].sum() < 0:
        said = "the left hips lie on the right of the spine: the coordinates are left-handed or the points swapped"
        raise ClipError(f"{said}; expected right-handed x, y, z")


def _widths(points: Array) -> Array:
    """How far left each pair's left point lies of its right one on average, (4,) m: `POINT_NAMES`' order, z up."""
    left = np.cross([0.0, 0.0, 1.0], points[:, 1] - points[:, 0])
    length = np.linalg.norm(left, axis=1, keepdims=True)
    if not length.all():
        frame = int(np.argmin(length))
        raise ClipError(f"neck and pelvis are above one another in frame {frame}: the animal has no heading there")
    left /= length
    return np.asarray(np.einsum("ta,tpa->p", left, points[:, 3::2] - points[:, 2::2]) / len(points))


def swapped_pairs(points: Array) -> list[int]:
    """Indices of the right points of the pairs whose sides are swapped, of ten points (t, 10, 3), z up: the left one
    lies on the right, against at least two pairs, by much of their width."""
    widths = _widths(points)
    usual = np.sort(widths)[-2]
    return [2 + 2 * int(pair) for pair in np.flatnonzero(widths < -_CROSSED * usual)] if usual > 0 else []


def _places(chosen: Sequence[int | None]) -> tuple[list[int], list[bool]]:
    """Indices (10,) in which the spine stands in for hips that are not in the file, and which are in it."""
    stand_in = {2: chosen[1], 3: chosen[1], 4: chosen[0], 5: chosen[0]}
    places = [stand_in[i] if place is None else place for i, place in enumerate(chosen)]
    return [int(place) for place in places if place is not None], [place is not None for place in chosen]


def with_hips(points: Array) -> tuple[Array, float, str]:
    """Fills in shoulders and hips of `points` (t, 10, 3) of `POINT_NAMES`, z up, m, of an animal whose spine and
    feet alone were recorded; returns the points, the length of the legs, m, and a sentence on what was assumed. They
    lie below the spine's points and above the middle of the feet's places, so that the legs swing evenly to both sides.
    How far below, and how long the legs are, follows from the proportions of the dog of the public recordings."""
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
    said = (
        "shoulders and hips are not in the file: they are taken above the middle of the feet's places, as wide as"
        f" these, {heights[0]:.2f} and {heights[1]:.2f} m high, with legs of {legs:.2f} m, as a dog's"
    )
    return points, legs, said


def _listed(names: Sequence[str]) -> str:
    shown = ", ".join(names[:40])
    return shown + (f" and {len(names) - 40} more" if len(names) > 40 else "")


def unit_wxyz_from_xyzw(xyzw: Array, where: Callable[[int], str]) -> Array:
    """Unit quaternions (t, 4) in the order w, x, y, z, without sign flips, from `xyzw` (t, 4). `where` gives a frame's
    position in the file, for messages. Raises `ClipError` for a norm that is not 1."""
    norm = np.linalg.norm(xyzw, axis=1)
    wrong = np.flatnonzero(np.abs(norm - 1) > NORM_TOLERANCE)
    if len(wrong):
        frame = int(wrong[0])
        raise ClipError(f"{where(frame)}: the root quaternion (x, y, z, w) has norm {norm[frame]:.4g}; expected 1")
    return quat_continuous((xyzw / norm[:, None])[:, [3, 0, 1, 2]])


def robot_points(root_pos_w: Array, root_quat_wxyz: Array, hip_pos_b: Array, foot_pos_b: Array) -> Array:
    """Keypoints (t, 10, 3) of `POINT_NAMES`, world frame, m, for a base pose in the world, abduction joint origins
    (4, 3) as hips and foot centres (t, 4, 3), body frame, m. Pelvis and neck are midpoints of rear and front hips."""
    hips = np.broadcast_to(hip_pos_b, foot_pos_b.shape)
    pelvis, neck = hips[:, 2:].mean(axis=1, keepdims=True), hips[:, :2].mean(axis=1, keepdims=True)
    points_b = np.concatenate([pelvis, neck, hips, foot_pos_b], axis=1)
    return np.asarray(root_pos_w)[:, None] + quat_rotate(np.asarray(root_quat_wxyz)[:, None], points_b)


_RADIUS: Final = 0.02  # m, of drawn bones
_FEW_HZ: Final = 20.0
_UNEVEN: Final = 0.25  # share of a frame's duration: times may be rounded to milliseconds


def skeleton_of(parents: Sequence[int]) -> Skeleton | None:
    """The bones of joints with these parents, -1 for a root; None without any."""
    bones = tuple((parent, joint) for joint, parent in enumerate(parents) if parent >= 0)
    return Skeleton(len(parents), bones, (_RADIUS,) * len(bones)) if bones else None


@dataclass(frozen=True, eq=False)
class Tracks:
    """Tracked points or joints; None for what the file does not say."""

    names: Sequence[str]
    positions: Array  # (t, k, 3); NaN where a point is missing
    rate_hz: float | None = None
    times: tuple[str, Array] | None = None  # name and values (t,), s, of a column of times, in place of the rate
    confidence: Array | None = None  # (t, k), 0 to 1
    unit_m: float | None = None  # the file's unit in metres
    is_level: bool = True  # whether an axis is vertical; not so in a camera's axes
    notes: tuple[str, ...] = ()  # what was assumed
    skeleton: Skeleton | None = None  # between all the points; of a clip without, only the ten are kept

    def clip(self, *, fps: float | None, up: str | None, point_map: PointMap | None, frames: Part | None) -> Clip:
        """The clip; the options are as in `ReadOptions`. Short gaps (NaN, or too low a confidence) are filled; longer
        ones cut the take: the clip is the part with `frames`, or the longest, and `origin.parts` lists all. Raises
        `ClipError`: no possible rate, unknown points, frames that hold a gap, or no upright, right-handed animal."""
        rate_hz = self._rate() if fps is None else float(fps)
        chosen, assumed = choose(self.names, point_map)
        check_rate(rate_hz)
        places, known = _places(chosen)
        confidence = None if self.confidence is None else self.confidence[:, places]
        filled = fill_gaps(self.positions[:, places], rate_hz, confidence)
        seen = filled.points[np.isfinite(filled.points).all(axis=(1, 2))]
        axes = find_axes(seen, rate_hz, up, self.unit_m, self.is_level)
        seen = axes.to_world(seen)
        notes = [*self.notes, *assumed, *filled.notes, *axes.notes]
        if rate_hz < _FEW_HZ:
            notes.append(f"{rate_hz:g} frames a second are enough to see feet touch down; 30 or more are advised")
        for right in swapped_pairs(seen) if all(known) else []:
            for each in (seen, filled.points):
                each[:, [right, right + 1]] = each[:, [right + 1, right]]
            pair = " and ".join(POINT_NAMES[right : right + 2])
            notes.append(f"{pair} are swapped in the file: the left one lies on the right; taken the other way round")
        check_right_handed(seen if all(known) else with_hips(seen)[0])
        n = len(self.positions)
        (first, end), left_out = part_for(filled.parts, frames, n)
        points, legs = axes.to_world(filled.points)[first:end], None
        if not all(known):
            points, legs, inferred = with_hips(points)
            notes.append(inferred)
            seen = points
        height = float(np.mean(seen[:, 2:6, 2] - seen[:, 6:10, 2]))
        notes.append(f"coordinates are in {axes.unit}: hips {height:.2f} m above the toes on average")
        origin = ClipOrigin(assumed=(*notes, *left_out))
        if filled.parts != [(0, n)]:
            origin = replace(origin, frames=(first, end), parts=tuple(filled.parts))
        clip = Clip(points_w=points, rate_hz=rate_hz, leg_length_m=legs, origin=origin)
        if self.skeleton is None:
            return clip
        drawn = axes.to_world(bridged(self.positions))[first:end]
        drawn[:, np.array(places)[known]] = points[:, known]
        return replace(clip, body_w=drawn, skeleton=self.skeleton)

    def _rate(self) -> float:
        if self.times is not None:
            column, times = self.times
            since = times - times[0]
            step = float(since[-1]) / (len(since) - 1)
            off = np.abs(since - step * np.arange(len(since)))
            if not step > 0 or off.max() > _UNEVEN * step:
                raise ClipError(f"the column '{column}' does not rise by equal steps; give the frame rate (--fps)")
            return 1.0 / step
        if self.rate_hz is None:
            raise ClipError("the file does not say how many frames a second it has; give the frame rate (--fps)")
        return self.rate_hz


def parse_tracks(read: Callable[[Any], Tracks], about: str, content: str | bytes, **options: Any) -> Clip:
    """The clip of a file whose text or bytes `read` reads, with the options of all tracks; `about` is the format's.
    Whatever a library says of damaged bytes becomes a `ClipError`."""
    try:
        tracks = read(content)
    except Exception as error:
        if isinstance(error, ClipError) or isinstance(content, str):
            raise
        # libraries raise a dozen kinds
        raise ClipError(f"a damaged file, or none of {about}: {str(error)[:200] or type(error).__name__}") from None
    return tracks.clip(**options)


def most_complete(individuals: Sequence[str], positions: Array) -> tuple[int, tuple[str, ...]]:
    """Of several animals' `positions` (n, t, k, 3), the one with the most points, and a sentence if there are more."""
    best = int(np.argmax(np.isfinite(positions).sum(axis=(1, 2, 3))))
    if len(individuals) == 1:
        return best, ()
    return best, (f"of {len(individuals)} animals, {individuals[best]} is read: it has the most points",)


def extra_module(module: str) -> Any:
    """A library of the extra `formats`; raises `ClipError` if it is not installed."""
    said = f"such files need {module}, which is not installed: pip install 'fastmimic[formats]'"
    return optional(module, ClipError(said))
