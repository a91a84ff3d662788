"""Animal and robot motion files, recognised by content, never by name. To add a format here, write its reader in a
module and name it in `formats.json` and below; a script registers its own (`examples/extend/motion_format.py`)."""

import io
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, Final

from fastmimic.base.errors import ClipError, check_positive, naming
from fastmimic.base.files import packaged
from fastmimic.clips.clip import Clip
from fastmimic.clips.formats import csv_motion, deepmimic, keypoints, skeletons
from fastmimic.clips.formats.format import (
    FORMATS,
    Content,
    Format,
    ReadOptions,
    format_of,
    holds_motion,
    refuse,
    suffixes,
)
from fastmimic.clips.formats.points import UP_AXES, parse_tracks, read_point_map
from fastmimic.clips.formats.text_table import check_rate
from fastmimic.clips.travel import with_travel

__all__ = ["FORMATS", "Content", "Format", "ReadOptions", "detect_format", "read_clip", "suffixes", "with_scale"]

_READERS: Final[dict[str, tuple[Callable[[Content], bool], Callable[..., Any]]]] = {
    "npz": (lambda content: holds_motion(io.BytesIO(content.data)), refuse),
    "csv": (csv_motion.detect, csv_motion.parse),
    "keypoints": (lambda content: keypoints.COLUMNS in content.columns, keypoints.parse),
    "points": (keypoints.names_points, keypoints.read_named),
    "anipose": (lambda content: set(content.table.header or ()) >= keypoints.ANIPOSE, keypoints.read_anipose),
    "deeplabcut": (keypoints.is_deeplabcut, keypoints.read_deeplabcut),
    "bvh": (lambda content: content.start.startswith(skeletons.KEYWORD), skeletons.read_bvh),
    "deepmimic": (lambda content: content.start[:1] in ("{", "["), deepmimic.parse),
    "trajectory": (lambda content: content.members >= {"q.npy", "dt.npy"}, csv_motion.parse_arrays),
    "hdf5": (lambda content: content.data.startswith(b"\x89HDF\r\n\x1a\n"), keypoints.read_hdf5),
    "c3d": (keypoints.is_c3d, keypoints.read_c3d),
    "glb": (lambda content: content.data.startswith(b"glTF"), skeletons.read_glb),
    "ai4animation": (lambda content: content.members >= skeletons.AI4ANIMATION, skeletons.read_ai4animation),
}
"""What tells the formats of `formats.json` by content, and what reads them: a clip, or `Tracks` with a `point_map`."""


_Said = dict[str, str | bool | tuple[str, ...]]
_SAID: Final[Any] = packaged("fastmimic.clips.formats", "formats.json", dict[str, _Said])
for _name, _said in _SAID.items():
    _detect, _read = _READERS[_name]
    _parse = partial(parse_tracks, _read, _said["about"]) if "point_map" in _said["takes"] else _read
    FORMATS.register(Format(_name, detect=_detect, parse=_parse, **_said))


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
    check_positive(scale, "the scale", ClipError, f"{scale:g}")
    return replace(clip, scale=float(scale), meta=clip.meta | {"scale_given": float(scale)})
