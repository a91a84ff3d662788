"""Animal and robot motion files: one module a format, recognised by what is in the file, never by its name.

A format module offers `parse(text, ...) -> Clip`. Its errors say where in the text; the path is added here.
To add a format: write its module, then give it a line in `FORMATS`, in `detect_content` and in `_parse`.
"""

from dataclasses import replace
from pathlib import Path
from typing import Any, Final, Literal

from fastmimic.base.errors import ClipError
from fastmimic.clips.clip import Clip
from fastmimic.clips.formats import bvh, csv_motion, deepmimic, keypoints, named_points
from fastmimic.clips.formats.content import detect_content, read_content
from fastmimic.clips.formats.points import PointMap, read_point_map
from fastmimic.clips.formats.text_table import check_positive, check_rate
from fastmimic.robot.robot import Robot

FORMATS: Final = {
    "keypoints": "dog keypoints, 81 columns of text",
    "bvh": "BVH, a hierarchy of joints",
    "points": "keypoints by name, three columns each",
    "deepmimic": "DeepMimic-style JSON of the Laikago, or of the robot that it names, 19 numbers a frame",
    "csv": "retargeted robot motion, 19 columns of text: root xyz, quaternion xyzw, 12 joints",
    "npz": "FastMimic robot motion",
}
"""Name of each format → what it is."""

__all__ = ["FORMATS", "detect_format", "read_clip", "with_scale"]


def detect_format(path: str | Path) -> str:
    """Says which of `FORMATS` a file is, by its content.

    Raises:
        ClipError: missing, empty or binary, or none of the formats; says what was found.
    """
    try:
        return detect_content(read_content(path))
    except ClipError as error:
        raise ClipError(f"{path}: {error}") from None


def read_clip(
    path: str | Path,
    *,
    robot: Robot | None = None,
    fps: float | None = None,
    up: Literal["y", "z"] | str | None = None,
    scale: float | None = None,
    frames: tuple[int, int] | None = None,
    point_map: str | Path | PointMap | None = None,
) -> Clip:
    """Reads a clip in any of the text formats. `clip.meta` tells the `format` and what was `assumed`.

    Args:
        path: the file. For a FastMimic `.npz` use `Motion.load`.
        robot: whose joints a retargeted CSV holds; not needed for the other formats.
        fps: frames a second, in place of what the file or the format says.
        up: the vertical axis of the file's coordinates, in place of what the keypoints show.
        scale: factor from the size in the file to the robot's.
        frames: (first, end) 0-based, end exclusive; the whole file if None.
        point_map: which of a BVH's joints or of the points of a table by name the ten of
            `fastmimic.clips.clip.POINT_NAMES` are, or a JSON file that says so; those of AI4Animation's dog, or of the
            same names, if None.

    Raises:
        ClipError: the file cannot be read or used, or an option does not apply to its format.
    """
    try:
        points = read_point_map(point_map) if isinstance(point_map, str | Path) else point_map
        clip = _read(path, robot, fps, up, scale, points)
        return clip if frames is None else clip.cut(*frames)
    except ClipError as error:
        raise ClipError(f"{path}: {error}") from None


def _read(
    path: str | Path,
    robot: Robot | None,
    fps: float | None,
    up: str | None,
    scale: float | None,
    points: PointMap | None,
) -> Clip:
    if up not in (None, "y", "z"):
        raise ClipError(f"the vertical axis must be 'y' or 'z', found '{up}'")
    if fps is not None:
        check_rate(fps)
    content = read_content(path)
    name = detect_content(content)
    if name == "npz":
        raise ClipError("this is a robot motion (.npz), not a clip: nothing to retarget")
    assert isinstance(content, str)
    clip = _parse(name, content, robot, fps, up, points)
    meta: dict[str, Any] = {
        "name": Path(path).stem,
        "source": Path(path).name,
        "format": name,
        "licence": None,
    }
    clip = replace(clip, meta=meta | clip.meta)
    return clip if scale is None else with_scale(clip, scale)


def _parse(
    name: str, text: str, robot: Robot | None, fps: float | None, up: str | None, points: PointMap | None
) -> Clip:
    if name == "bvh":
        return bvh.parse(text, fps=fps, up=up, point_map=points)
    if name == "points":
        return named_points.parse(text, fps=fps, up=up, point_map=points)
    if points is not None:
        raise ClipError(f"a point map does not apply to {FORMATS[name]}; leave it out")
    if name == "keypoints":
        return keypoints.parse(text, fps=fps, up=up)
    if up == "y":
        raise ClipError(
            f"y up does not apply to {FORMATS[name]}: its trunk orientation is defined with z up;"
            " convert the file, or leave the vertical axis out"
        )
    if name == "deepmimic":
        return deepmimic.parse(text, robot=robot, fps=fps)
    if robot is None:
        raise ClipError("a retargeted CSV holds joint angles: the robot that they belong to is needed")
    return csv_motion.parse(text, robot=robot, fps=fps)


def with_scale(clip: Clip, scale: float) -> Clip:
    """The clip with the factor from its size to the robot's fixed.

    Raises:
        ClipError: the factor is not positive.
    """
    check_positive(scale, "the scale")
    return replace(clip, scale=float(scale), meta=clip.meta | {"scale_given": float(scale)})
