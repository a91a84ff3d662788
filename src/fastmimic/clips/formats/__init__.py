"""Animal and robot motion files, recognised by content, never by name. To add a format here, write its reader in a
module and name it in `formats.json`; a script registers its own (`examples/extend/motion_format.py`)."""

from dataclasses import replace
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any

from fastmimic.base.errors import ClipError, check_positive, naming
from fastmimic.base.files import packaged
from fastmimic.clips.clip import Clip
from fastmimic.clips.formats.format import FORMATS, Content, Format, ReadOptions, format_of, has, suffixes
from fastmimic.clips.formats.points import UP_AXES, parse_tracks, read_point_map
from fastmimic.clips.formats.text_table import check_rate
from fastmimic.clips.travel import with_travel

__all__ = ["FORMATS", "Content", "Format", "ReadOptions", "detect_format", "read_clip", "suffixes", "with_scale"]


def _entry(name: str, said: dict[str, Any]) -> Format:
    """A format as `formats.json` has it: `read` and `detect` are functions of its `module`. In place of the latter are
    the content's beginnings, arrays of an archive, or a number of columns. What takes a `point_map` reads `Tracks`."""
    module = import_module(f"{__name__}.{said.pop('module')}")
    read, detect = getattr(module, said.pop("read")), said.pop("detect", None)
    marks = {mark: said.pop(mark) for mark in ("starts", "arrays", "columns") if mark in said}
    parse = partial(parse_tracks, read, said["about"]) if "point_map" in said["takes"] else read
    return Format(name, detect=getattr(module, detect) if detect else partial(has, **marks), parse=parse, **said)


_Said = dict[str, str | bool | int | tuple[str, ...]]
for _name, _said in packaged("fastmimic.clips.formats", "formats.json", dict[str, _Said]).items():
    FORMATS.register(_entry(_name, _said))


def detect_format(path: str | Path) -> str:
    """The name of a file's format, by its content. Raises `ClipError`: missing, or none of the formats."""
    with naming(path, ClipError):
        return format_of(Content.of(path)).name


def read_clip(path: str | Path, options: ReadOptions | None = None) -> Clip:
    """Reads a clip in any of `FORMATS`; `clip.origin` holds its `format` and what was `assumed`. `Motion.load` reads a
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
        origin = replace(clip.origin, name=Path(path).stem, source=Path(path).name, format=form.name)
        clip = replace(clip, origin=origin)
        clip = with_travel(clip, options.travel or "auto")
        clip = clip if options.scale is None else with_scale(clip, options.scale)
        if options.frames is None:
            return clip
        start = (clip.origin.frames or (0, 0))[0]  # a clip may be a part of its file
        cut = clip.cut(options.frames[0] - start, options.frames[1] - start)
        return replace(cut, origin=replace(cut.origin, frames=options.frames))


def with_scale(clip: Clip, scale: float) -> Clip:
    """The clip with a given positive factor from its size to the robot's; raises `ClipError`."""
    check_positive(scale, "the scale", ClipError, f"{scale:g}")
    return replace(clip, scale=float(scale))
