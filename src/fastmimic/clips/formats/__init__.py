"""Animal and robot motion files, recognised by content, never by name. To add a format here, write its `Format` in a
module and name it below. A user's script registers one with `FORMATS.register(Format(…))`, see
`examples/extend/motion_format.py`."""

from dataclasses import replace
from pathlib import Path
from typing import Any

from fastmimic.base.errors import ClipError, naming
from fastmimic.clips.clip import Clip
from fastmimic.clips.formats import csv_motion, deepmimic, keypoints, pose_table, skeletons
from fastmimic.clips.formats.format import FORMATS, ROBOT_MOTION, Content, Format, ReadOptions, format_of, suffixes
from fastmimic.clips.formats.points import UP_AXES, read_point_map
from fastmimic.clips.formats.text_table import check_positive, check_rate
from fastmimic.clips.travel import with_travel

__all__ = ["FORMATS", "Content", "Format", "ReadOptions", "detect_format", "read_clip", "suffixes", "with_scale"]

_KEYPOINTS = (keypoints.FORMAT, keypoints.NAMED_FORMAT)
_TABLES = (csv_motion.FORMAT, *_KEYPOINTS, pose_table.ANIPOSE, pose_table.DEEPLABCUT)
_BINARY = (csv_motion.ARRAYS, pose_table.HDF5, pose_table.C3D, skeletons.GLB, skeletons.AI4ANIMATION)
for _format in (ROBOT_MOTION, *_TABLES, skeletons.BVH, deepmimic.FORMAT, *_BINARY):
    FORMATS.register(_format)


def detect_format(path: str | Path) -> str:
    """The name of a file's format, by its content. Raises `ClipError`: missing, or none of the formats."""
    with naming(path, ClipError):
        return format_of(Content.of(path)).name


def read_clip(path: str | Path, options: ReadOptions | None = None) -> Clip:
    """Reads a clip in any of `FORMATS`; `clip.meta` holds its `format` and what was `assumed`. `Motion.load` reads a
    FastMimic `.npz`. Raises `ClipError` for an unreadable file, or an option that does not apply to its format."""
    options = options if options is not None else ReadOptions()
    with naming(path, ClipError):
        if options.up is not None and options.up not in UP_AXES:
            raise ClipError(f"the vertical axis must be one of {', '.join(UP_AXES)}, found '{options.up}'")
        if options.fps is not None:
            check_rate(options.fps)
        if isinstance(options.point_map, str | Path):
            options = replace(options, point_map=read_point_map(options.point_map))
        content = Content.of(path)
        form = format_of(content)
        clip = form.read(content, options)
        meta: dict[str, Any] = {"name": Path(path).stem, "source": Path(path).name, "format": form.name}
        clip = replace(clip, meta={"licence": None, "assumed": []} | meta | clip.meta)
        clip = with_travel(clip, options.travel or "auto")
        clip = clip if options.scale is None else with_scale(clip, options.scale)
        if options.frames is None:
            return clip
        start = clip.meta.get("frames", [0])[0]  # a clip may be a part of its file
        cut = clip.cut(options.frames[0] - start, options.frames[1] - start)
        return replace(cut, meta=cut.meta | {"frames": list(options.frames)})


def with_scale(clip: Clip, scale: float) -> Clip:
    """The clip with a given positive factor from its size to the robot's; raises `ClipError`."""
    check_positive(scale, "the scale")
    return replace(clip, scale=float(scale), meta=clip.meta | {"scale_given": float(scale)})
