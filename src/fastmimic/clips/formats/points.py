"""An animal's points from any file: their names, the vertical axis and the unit. A point map is a JSON object that
names a file's point for each of the ten of `POINT_NAMES`."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

import numpy as np

from fastmimic.base.arrays import Array
from fastmimic.base.errors import ClipError, did_you_mean
from fastmimic.clips.clip import POINT_NAMES, Clip
from fastmimic.clips.skeleton import KEYPOINTS, Skeleton

PointMap = Mapping[str, str]

AI4ANIMATION_DOG: Final[PointMap] = {
    "pelvis": "Hips",
    "neck": "Neck",
    "FR_hip": "RightShoulder",
    "FL_hip": "LeftShoulder",
    "RR_hip": "RightUpLeg",
    "RL_hip": "LeftUpLeg",
    "FR_toe": "RightHand.end",
    "FL_toe": "LeftHand.end",
    "RR_toe": "RightFoot.end",
    "RL_toe": "LeftFoot.end",
}
"""The dog of Zhang et al. (2018); `.end` is a joint's end site."""
OWN_NAMES: Final[PointMap] = {name: name for name in POINT_NAMES}
BUILT_IN: Final = {"AI4Animation's dog": AI4ANIMATION_DOG, "the common names": OWN_NAMES}
"""Default maps, tried in this order."""

_TO_Z_UP: Final = {"y": (2, 0, 1), "z": (0, 1, 2)}
_MIN_UPRIGHT: Final = 0.5  # least vertical share of the mean toe → hip vector; 0.95 in takes in which the dog also sits
_UNITS: Final = ((300.0, 1e-3, "millimetres"), (3.0, 1e-2, "centimetres"))
"""Units other than metres, with the least distance from toes to hips in the file's numbers (no leg is 3 m)."""


def read_point_map(path: str | Path) -> dict[str, str]:
    """Reads a point map. Raises `ClipError`: not a JSON object that gives each of the ten points a name."""
    try:
        found = json.loads(Path(path).read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or f"not JSON: {error}"
        raise ClipError(f"{path}: a point map that cannot be read ({reason})") from None
    if not isinstance(found, dict) or not all(isinstance(v, str) for v in found.values()):
        raise ClipError(f"{path}: a point map is a JSON object of names, such as {_example()}")
    unknown = sorted(found.keys() - set(POINT_NAMES))
    missing = [name for name in POINT_NAMES if name not in found]
    if unknown or missing:
        words = [f"does not know '{unknown[0]}'{did_you_mean(unknown[0], POINT_NAMES)}"] if unknown else []
        words += [f"lacks {', '.join(missing)}"] if missing else []
        raise ClipError(f"{path}: this point map {' and '.join(words)}; it needs {', '.join(POINT_NAMES)}")
    return found


def choose(names: Sequence[str], given: PointMap | None) -> tuple[list[int], str | None]:
    """Indices (10,) of the ten points among a file's `names`, and the name of the built-in map that fits. Raises
    `ClipError`: no map fits; the message lists the names."""
    maps = BUILT_IN if given is None else {"": given}
    for title, points in maps.items():
        if all(source in names for source in points.values()):
            return [names.index(points[name]) for name in POINT_NAMES], title or None
    if given is not None:
        lost = next(source for source in given.values() if source not in names)
        raise ClipError(
            f"the point map names '{lost}', which the file does not have{did_you_mean(lost, names)};"
            f" it has {_listed(names)}"
        )
    raise ClipError(
        f"its points are not known by name: it has {_listed(names)}; give a point map"
        f" (--point-map FILE.json), a JSON object such as {_example()}"
    )


def clip_of(
    body: Array,
    chosen: Sequence[int],
    rate_hz: float,
    *,
    up: str | None,
    assumed: Sequence[str],
    skeleton: Skeleton | None = None,
) -> Clip:
    """A clip of all points `body` (t, k, 3) of a file, in its axes and unit, with `chosen` (10,) indices of the ten.

    Args:
        up: 'y' or 'z'; if None, the axis along which the hips are above the toes.
        assumed: assumptions so far.
        skeleton: between the k points; only the ten are kept if None.

    Raises `ClipError` if it is not an upright, right-handed animal.
    """
    notes = list(assumed)
    points = body[:, list(chosen)]
    if up is None:
        up = _vertical_axis(points)
        notes.append(f"{up} is up: the hips lie above the toes along it")
    factor, unit = _unit(points)
    points = factor * np.ascontiguousarray(points[..., _TO_Z_UP[up]])
    _check_upright(points, up)
    _check_right_handed(points)
    height = float(np.mean(points[:, 2:6, 2] - points[:, 6:10, 2]))
    notes.append(f"coordinates are in {unit}: hips {height:.2f} m above the toes on average")
    if skeleton is None:
        return Clip(points_w=points, rate_hz=rate_hz, meta={"assumed": notes}, skeleton=KEYPOINTS)
    whole = factor * np.ascontiguousarray(body[..., _TO_Z_UP[up]])
    return Clip(points_w=points, rate_hz=rate_hz, meta={"assumed": notes}, body_w=whole, skeleton=skeleton)


def _listed(names: Sequence[str]) -> str:
    shown = ", ".join(names[:40])
    return shown + (f" and {len(names) - 40} more" if len(names) > 40 else "")


def _example() -> str:
    return json.dumps(AI4ANIMATION_DOG)


def _unit(points: Array) -> tuple[float, str]:
    legs = float(np.mean(np.linalg.norm(points[:, 2:6] - points[:, 6:10], axis=-1)))
    for least, factor, name in _UNITS:
        if legs > least:
            return factor, name
    return 1.0, "metres"


def _toe_to_hip(points: Array) -> Array:
    """Mean vector from the toes to the hips, (3,)."""
    return np.asarray(np.mean(points[:, 2:6] - points[:, 6:10], axis=(0, 1)))


def _vertical_axis(points: Array) -> str:
    vector = _toe_to_hip(points)
    return "y" if vector[1] >= vector[2] else "z"


def _check_upright(points: Array, up: str) -> None:
    vector = _toe_to_hip(points)
    if not vector[2] >= _MIN_UPRIGHT * np.linalg.norm(vector) > 0:
        raise ClipError(
            f"the hips do not lie above the toes along {up} (mean offset {vector[2]:.3g} m of"
            f" {np.linalg.norm(vector):.3g} m); the vertical axis must be y or z"
        )


def _check_right_handed(points: Array) -> None:
    """Raises `ClipError` for a mirrored file, which would swap left and right turns."""
    forward = points[:, 1] - points[:, 0]
    left = np.cross([0.0, 0.0, 1.0], forward)
    width = points[:, [3, 5]].sum(axis=1) - points[:, [2, 4]].sum(axis=1)
    if np.mean(np.sum(left * width, axis=-1)) < 0:
        raise ClipError(
            "the left hips lie on the right of the spine: the coordinates are left-handed or the"
            " points swapped; expected right-handed x, y, z"
        )
