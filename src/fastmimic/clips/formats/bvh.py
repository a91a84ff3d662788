"""Biovision hierarchies (BVH): a skeleton of joints with their offsets, and the angles of each frame. A joint's
transform is its offset, or its position channels if it has any, followed by its rotations in channel order, each about
the axis turned by the previous ones. Points are named after joints; `NAME.end` is a joint's end site."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from fastmimic.base.arrays import Array
from fastmimic.base.errors import ClipError
from fastmimic.clips.formats.text_table import Row, is_number, to_array
from fastmimic.clips.formats.tracked_points import Tracks, tracks_format

KEYWORD: Final = "HIERARCHY"
_CHANNELS: Final = tuple(f"{axis}{kind}" for kind in ("position", "rotation") for axis in "XYZ")
_DEEPEST: Final = 500


@dataclass
class _Joint:
    """A joint or an end site; `parent` is an index, -1 for a root; its columns begin at `first`."""

    name: str
    parent: int
    offset: Array = field(default_factory=lambda: np.zeros(3))
    channels: tuple[str, ...] = ()
    first: int = 0


def read(text: str) -> Tracks:
    """Reads the text of a BVH file; raises `ClipError`: malformed (says which line), or truncated."""
    lines = _lines(text)
    joints = _hierarchy(lines)
    declared, frame_s = _rate(lines)
    columns = sum(len(joint.channels) for joint in joints)
    rows = [Row(number, words) for number, words in lines]
    values = to_array(rows, columns, lambda column: _column_name(joints, column), "a BVH's channels")
    if declared != len(values):
        raise ClipError(f"the file says that it has {declared} frames; it has {len(values)}: it may be truncated")
    parents = [joint.parent for joint in joints]
    return Tracks([joint.name for joint in joints], _positions(joints, values), 1.0 / frame_s, parents=parents)


def _lines(text: str) -> Iterator[tuple[int, list[str]]]:
    """Number and words of each line that is not blank; braces become words of their own."""
    for number, line in enumerate(text.splitlines(), start=1):
        words = line.replace("{", " { ").replace("}", " } ").split()
        if words:
            yield number, words


def _hierarchy(lines: Iterator[tuple[int, list[str]]]) -> list[_Joint]:
    """The joints in file order, up to the line MOTION."""
    joints: list[_Joint] = []
    above: list[int] = []  # open joints
    opening: int | None = None  # a joint before its brace
    columns = 0
    for number, words in lines:
        while words:
            word = words.pop(0)
            if word == KEYWORD and not joints:
                continue
            if word in ("ROOT", "JOINT", "End") and opening is None and words:
                named = words.pop(0)
                if (word == "ROOT") != (not above):
                    raise ClipError(f"line {number}: {word} {named} is not where one belongs")
                name = f"{joints[above[-1]].name}.end" if word == "End" else named.rpartition(":")[2]
                joints.append(_Joint(name, above[-1] if above else -1))
                opening = len(joints) - 1
            elif word == "{" and opening is not None:
                above.append(opening)
                opening = None
                if len(above) > _DEEPEST:
                    raise ClipError(f"line {number}: joints are nested more than {_DEEPEST} deep")
            elif word == "}" and above and opening is None:
                above.pop()
            elif word == "OFFSET" and above and len(words) >= 3 and all(map(is_number, words[:3])):
                joints[above[-1]].offset = np.array([float(words.pop(0)) for _ in "xyz"])
            elif word == "CHANNELS" and above and words and words[0].isdecimal():
                count = int(words.pop(0))
                channels = tuple(words[:count])
                del words[:count]
                if len(channels) != count or not set(channels) <= set(_CHANNELS) or len(set(channels)) != count:
                    raise ClipError(
                        f"line {number}: expected {count} different channels of {', '.join(_CHANNELS)}; found"
                        f" {' '.join(channels)[:60]}"
                    )
                joints[above[-1]].channels, joints[above[-1]].first = channels, columns
                columns += count
            elif word == "MOTION" and joints and not above and opening is None:
                return joints
            else:
                raise ClipError(
                    f"line {number}: '{' '.join([word, *words])[:40]}' is not expected in a BVH's hierarchy there"
                )
    raise ClipError("the file ends within the hierarchy: there is no line MOTION")


def _rate(lines: Iterator[tuple[int, list[str]]]) -> tuple[int, float]:
    """Number of frames and duration of one frame, s, from the header of MOTION."""
    number, words = next(lines, (0, []))
    if words[:1] != ["Frames:"] or len(words) != 2 or not words[1].isdecimal():
        raise ClipError(f"line {number}: expected 'Frames: N' after MOTION, found '{' '.join(words)[:40]}'")
    count = int(words[1])
    number, words = next(lines, (0, []))
    if words[:2] != ["Frame", "Time:"] or len(words) != 3 or not is_number(words[2]) or not float(words[2]) > 0:
        raise ClipError(f"line {number}: expected 'Frame Time: S' with S > 0, found '{' '.join(words)[:40]}'")
    return count, float(words[2])


def _column_name(joints: list[_Joint], column: int) -> str:
    joint = next(j for j in joints if j.first <= column < j.first + len(j.channels))
    return f"{joint.name} {joint.channels[column - joint.first]}"


def _positions(joints: list[_Joint], values: Array) -> Array:
    """Positions of all joints (t, k, 3), in the file's axes and unit."""
    from scipy.spatial.transform import Rotation

    n = len(values)
    positions, rotations = np.zeros((n, len(joints), 3)), np.zeros((len(joints), n, 3, 3))
    for i, joint in enumerate(joints):
        own = values[:, joint.first : joint.first + len(joint.channels)]
        translation = np.repeat(joint.offset[None], n, axis=0)
        for channel, column in zip(joint.channels, own.T, strict=True):
            if channel.endswith("position"):
                translation[:, "XYZ".index(channel[0])] = column
        turning = [k for k, channel in enumerate(joint.channels) if channel.endswith("rotation")]
        local = np.repeat(np.eye(3)[None], n, axis=0)
        if turning:
            order = "".join(joint.channels[k][0] for k in turning)
            local = Rotation.from_euler(order, own[:, turning], degrees=True).as_matrix()
        if joint.parent < 0:
            positions[:, i], rotations[i] = translation, local
        else:
            above = rotations[joint.parent]
            positions[:, i] = positions[:, joint.parent] + np.einsum("tij,tj->ti", above, translation)
            rotations[i] = above @ local
    return positions


FORMAT: Final = tracks_format(
    "bvh", "BVH, a hierarchy of joints", (".bvh",), lambda content: content.start.startswith(KEYWORD), read
)
