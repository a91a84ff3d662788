"""Motions by name: built-in synthetic gaits, and excerpts of the public data."""

import os
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from fastmimic.base.configuration import parse_pair
from fastmimic.base.errors import ClipError, check_path, did_you_mean, naming
from fastmimic.clips.clip import Clip
from fastmimic.clips.data import DATASETS, RECORDED, Dataset, data_folder, dataset_of, find_file
from fastmimic.clips.formats import ReadOptions, read_clip, suffixes, with_scale
from fastmimic.clips.formats.points import PointMap
from fastmimic.clips.synthesis import GAITS, JUMPS, GaitSpec, generate, jump
from fastmimic.robot.robot import Robot


@dataclass(frozen=True)
class MotionRow:
    """A row of the list of motions; `available` says whether its data has been fetched."""

    name: str
    about: str
    speed: str
    source: str
    licence: str
    available: bool


def motion_names() -> tuple[str, ...]:
    """All names that `open_clip` knows."""
    return (*GAITS, *JUMPS, *RECORDED)


def parse_frames(text: str, where: str) -> tuple[int, int]:
    """First frame and end, as `where` writes them; raises `ConfigError`."""
    takes = f"{where} takes FIRST:END, 0-based, end exclusive, such as 162:201"
    return parse_pair(text, r"(\d+)\s*:\s*(\d+)", takes)


def describe(folder: str | Path | None = None) -> list[MotionRow]:
    """One row for each name, the built-in ones first."""
    built = [(name, spec.about, _speed(spec)) for name, spec in GAITS.items()]
    built += [(name, about, "–") for name, about in JUMPS.items()]
    rows = [MotionRow(*row, "built in", "that of fastmimic", True) for row in built]
    for name, motion in RECORDED.items():
        fetched = find_file(motion.dataset, motion.file, folder) is not None
        licence = DATASETS[motion.dataset].licence
        rows.append(MotionRow(name, motion.about, motion.speed, motion.source, licence, fetched))
    return rows


def open_clip(
    name_or_path: str | Path,
    *,
    robot: Robot | None = None,
    fps: float | None = None,
    up: str | None = None,
    scale: float | None = None,
    frames: tuple[int, int] | None = None,
    speed: float | None = None,
    yaw_rate: float | None = None,
    duty: float | None = None,
    folder: str | Path | None = None,
    point_map: str | Path | PointMap | None = None,
    cycle: bool | None = None,
    travel: str | None = None,
) -> Clip:
    """Opens a motion by name, or reads a file. A name takes precedence over a file of the same name (use ./NAME).

    Args:
        name_or_path: one of `motion_names()`, or the path of a clip.
        robot, fps, up, scale, point_map, travel: see `fastmimic.clips.formats.ReadOptions`.
        frames: (first, end) 0-based, end exclusive; relative to the named clip.
        speed, yaw_rate, duty: of a built-in gait, m/s, rad/s and share of stance; its own if None.
        folder: the data folder (see `data_folder`).
        cycle: whether the clip is one period of a motion that repeats; None for what its source says, or shows.

    The clip has `name`, `source`, `licence` and `credit` in its `origin`. Raises `ClipError` for an unknown name (lists
    the closest), data not fetched, an unreadable file, or an option that does not apply.
    """
    check_path(name_or_path, "a clip is opened by its name or file", ClipError)
    name, options = str(name_or_path), ReadOptions(robot, fps, up, scale, frames, point_map, travel)
    gait_options = {"speed": speed, "yaw_rate": yaw_rate, "duty": duty}
    if name in motion_names() and point_map is not None:
        raise ClipError(f"a point map cannot be given for '{name}': its points are known")
    if name not in GAITS:
        _refuse(name, f"only the built-in gaits can be varied ({', '.join(GAITS)})", gait_options)
    if name in GAITS or name in JUMPS:
        read = {"frame rate": fps, "vertical axis": up, "travel": travel}
        _refuse(name, "it is generated, not read from a file", read)
        clip = generate(name, **gait_options) if name in GAITS else jump(name)
        clip = _cut(name, clip if scale is None else with_scale(clip, scale), frames)
    else:
        clip = _recorded(name, options, folder) if name in RECORDED else _file(name_or_path, options)
    return clip if cycle is None else replace(clip, is_cycle=cycle)


def open_parts(name_or_path: str | Path, **options: Any) -> list[tuple[int, Clip]]:
    """Opens all parts of a take that long gaps split, each with its first frame in the file; of other clips, and of
    given frames, the whole. Options and errors as `open_clip`."""
    clip = open_clip(name_or_path, **options)
    parts = clip.origin.parts
    if parts is None or options.get("frames") is not None:
        return [(0, clip)]
    return [(first, open_clip(name_or_path, **options, frames=(first, end))) for first, end in parts]


def check_name(name: str) -> None:
    """Raises `ClipError` for an unknown name (lists the closest), or data not fetched; reads nothing."""
    if name not in motion_names():
        raise _unknown(name)
    if name in RECORDED:
        _recording(name, None)


def _file(path: str | Path, options: ReadOptions) -> Clip:
    name = str(path)
    looks_like_path = "/" in name or "\\" in name or Path(name).suffix.lower() in suffixes()
    if not looks_like_path and not os.path.exists(path):
        raise _unknown(name)
    clip = read_clip(path, options)
    dataset = dataset_of(path)
    return clip if dataset is None else _of_dataset(clip, dataset)


def _of_dataset(clip: Clip, dataset: Dataset) -> Clip:
    return replace(clip, origin=replace(clip.origin, licence=dataset.licence, credit=dataset.credit))


def _recorded(name: str, options: ReadOptions, folder: str | Path | None) -> Clip:
    motion, path = RECORDED[name], _recording(name, folder)
    clip = read_clip(path, replace(options, robot=None, frames=motion.frames))
    dataset = DATASETS[motion.dataset]
    assumed = clip.origin.assumed
    if dataset_of(path) is None:
        assumed = (*assumed, f"{path} is not the published file (its SHA-256 differs)")
    origin = replace(clip.origin, name=name, source=motion.source, assumed=assumed)
    clip = _of_dataset(replace(clip, is_cycle=True, origin=origin), dataset)
    return _cut(name, clip, options.frames)


def _recording(name: str, folder: str | Path | None) -> Path:
    motion = RECORDED[name]
    path = find_file(motion.dataset, motion.file, folder)
    if path is None:
        said = f"'{name}' needs {motion.dataset}/{motion.file}, which is not in {data_folder(folder)}"
        raise ClipError(f"{said}: run 'fastmimic data fetch', or set FASTMIMIC_DATA to a folder that has it")
    return path


def _unknown(name: str) -> ClipError:
    names = motion_names()
    hint = did_you_mean(name, names) or f"; the names are {', '.join(names)}"
    return ClipError(f"'{name}' is neither the name of a motion nor a file{hint}")


def _cut(name: str, clip: Clip, frames: tuple[int, int] | None) -> Clip:
    with naming(name, ClipError):
        return clip if frames is None else clip.cut(*frames)


def _refuse(name: str, why: str, options: Mapping[str, float | str | None]) -> None:
    given = [option for option, value in options.items() if value is not None]
    if given:
        raise ClipError(f"{' and '.join(given)} cannot be set for '{name}': {why}")


def _speed(spec: GaitSpec) -> str:
    sideways = f"{spec.lateral_speed:.3g} m/s sideways" if spec.lateral_speed else ""
    turning = f"{spec.yaw_rate:+.2g} rad/s" if spec.yaw_rate else ""
    forward = "" if (sideways or turning) and not spec.speed else f"{spec.speed:.3g} m/s"
    return ", ".join(part for part in (forward, sideways, turning) if part)
