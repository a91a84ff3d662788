"""Animated skeletons: trees of bones or joints, whose places follow from their parents'.

- BVH, Biovision hierarchies: joints with their offsets, and the angles of each frame. A joint's transform is its
  offset, or its position channels if it has any, followed by its rotations in channel order, each about the axis turned
  by the previous ones. Points are named after joints; `NAME.end` is a joint's end site.
- GLB, glTF 2.0's binary form: nodes, each with translation, rotation and scale against its parent, and for each of them
  samplers of keys (linear, step or cubic spline), sampled at the rate of the densest one. It is read with pygltflib.
- AI4AnimationPy (facebookresearch/ai4animationpy, `Motion.SaveToNPZ`): positions (t, k, 3) in the world, m, y up, with
  names and parents of the bones, and the frame rate. Objects in the file are not read, as that can run anything.
"""

import io
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np

from fastmimic.base.arrays import Array
from fastmimic.base.errors import ClipError
from fastmimic.base.files import open_arrays
from fastmimic.base.rotations import matrix_from_quat
from fastmimic.clips.formats.points import Tracks, extra_module, skeleton_of
from fastmimic.clips.formats.text_table import Row, is_number, to_array

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


def read_bvh(text: str) -> Tracks:
    """Reads the text of a BVH file; raises `ClipError`: malformed (says which line), or truncated."""
    lines = _lines(text)
    joints = _hierarchy(lines)
    declared, frame_s = _rate(lines)
    columns = [f"{j.name} {channel}" for j in sorted(joints, key=lambda j: j.first) for channel in j.channels]
    rows = [Row(number, words) for number, words in lines]
    values = to_array(rows, columns, "a BVH's channels")
    if declared != len(values):
        raise ClipError(f"the file says that it has {declared} frames; it has {len(values)}: it may be truncated")
    skeleton = skeleton_of([joint.parent for joint in joints])
    return Tracks([joint.name for joint in joints], _placed(joints, values), 1.0 / frame_s, skeleton=skeleton)


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
            elif word == "CHANNELS" and above and words and words[0].isdecimal() and not joints[above[-1]].channels:
                count = int(words.pop(0))
                channels = tuple(words[:count])
                del words[:count]
                if len(channels) != count or not set(channels) <= set(_CHANNELS) or len(set(channels)) != count:
                    expected = f"{count} different channels of {', '.join(_CHANNELS)}"
                    raise ClipError(f"line {number}: expected {expected}; found {' '.join(channels)[:60]}")
                joints[above[-1]].channels, joints[above[-1]].first = channels, columns
                columns += count
            elif word == "MOTION" and joints and not above and opening is None:
                return joints
            else:
                found = " ".join([word, *words])[:40]
                raise ClipError(f"line {number}: '{found}' is not expected in a BVH's hierarchy there")
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


def _placed(joints: list[_Joint], values: Array) -> Array:
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


_TYPES: Final = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_SIZES: Final = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}
_ROUNDING: Final = 0.01  # share of a frame: times are of single precision
_MOST: Final = 1_000_000  # frames
_REST: Final = {"translation": (0.0, 0.0, 0.0), "rotation": (0.0, 0.0, 0.0, 1.0), "scale": (1.0, 1.0, 1.0)}


def read_glb(data: bytes) -> Tracks:
    """Reads such a file. Raises `ClipError`: no pygltflib, or without an animation."""
    file = extra_module("pygltflib").GLTF2.load_from_bytes(data)
    blob = file.binary_blob() or b""
    if not file.animations:
        raise ClipError("a GLB file without an animation")
    animation = max(file.animations, key=lambda a: len(a.channels))
    keys = [_accessor(file, blob, sampler.input)[:, 0] for sampler in animation.samplers]
    step = min((float(np.median(np.diff(k))) for k in keys if len(k) > 1), default=0.0)
    first, last = min(k[0] for k in keys), max(k[-1] for k in keys)
    if not step > 0 or not last - first <= _MOST * step:
        raise ClipError("a GLB file whose animation has one frame, or keys that do not rise")
    times = np.linspace(first, last, round((last - first) / step) + 1)
    moved: dict[tuple[int, str], Array] = {}
    for channel in animation.channels:
        sampler, path = animation.samplers[channel.sampler], channel.target.path
        if path in _REST and channel.target.node is not None:
            values, how = _accessor(file, blob, sampler.output), sampler.interpolation
            how = "SLERP" if path == "rotation" and how == "LINEAR" else how
            moved[channel.target.node, path] = _sampled(times, keys[channel.sampler], values, how)
    parents = [-1] * len(file.nodes)
    for i, node in enumerate(file.nodes):
        for child in node.children or ():
            parents[child] = i
    joints = {joint for skin in file.skins or () for joint in skin.joints} or set(range(len(parents)))
    bones = [parent if {parent, i} <= joints else -1 for i, parent in enumerate(parents)]
    names = [node.name or f"node_{i}" for i, node in enumerate(file.nodes)]
    notes = (f"of {len(file.animations)} animations, '{animation.name}' is read",) if len(file.animations) > 1 else ()
    positions, rate = _positions(file.nodes, parents, moved, len(times)), 1.0 / float(times[1] - times[0])
    return Tracks(names, positions, rate, notes=notes, skeleton=skeleton_of(bones))


def _accessor(file: Any, blob: bytes, index: int) -> Array:
    """The elements of an accessor, (n, components), integers scaled to [-1, 1] if the file says so."""
    accessor = file.accessors[index]
    if accessor.sparse is not None or accessor.bufferView is None:
        raise ClipError("a GLB file with sparse accessors, which are not read: export it without")
    view = file.bufferViews[accessor.bufferView]
    kind, size = np.dtype(_TYPES[accessor.componentType]), _SIZES[accessor.type]
    strides = (view.byteStride or size * kind.itemsize, kind.itemsize)
    start = (view.byteOffset or 0) + (accessor.byteOffset or 0)
    found = np.ndarray((accessor.count, size), kind, blob, start, strides).astype(float)
    return np.maximum(found / np.iinfo(kind).max, -1.0) if accessor.normalized else found


def _sampled(times: Array, keys: Array, values: Array, how: str) -> Array:
    """A sampler's values (t, components) at `times`."""
    from scipy.spatial.transform import Rotation, Slerp

    triples = values.reshape(len(keys), -1, values.shape[1])  # of a spline: tangent before, value, tangent after
    value = triples[:, triples.shape[1] // 2]
    if len(keys) == 1:
        return np.repeat(value, len(times), axis=0)
    if how == "STEP":
        early = _ROUNDING * np.median(np.diff(keys))
        return np.asarray(value[np.clip(np.searchsorted(keys - early, times, side="right") - 1, 0, None)])
    if how == "SLERP":
        return np.asarray(Slerp(keys, Rotation.from_quat(value))(np.clip(times, keys[0], keys[-1])).as_quat())
    i = np.clip(np.searchsorted(keys, times, side="right") - 1, 0, len(keys) - 2)
    span = (keys[i + 1] - keys[i])[:, None]
    s = np.clip((times - keys[i])[:, None] / span, 0.0, 1.0)
    if how == "CUBICSPLINE":
        ends = (2 * s**3 - 3 * s**2 + 1) * value[i] + (3 * s**2 - 2 * s**3) * value[i + 1]
        return np.asarray(ends + span * ((s**3 - 2 * s**2 + s) * triples[i, 2] + (s**3 - s**2) * triples[i + 1, 0]))
    return np.asarray(value[i] + s * (value[i + 1] - value[i]))


def _positions(nodes: Sequence[Any], parents: Sequence[int], moved: dict[tuple[int, str], Array], n: int) -> Array:
    """Positions of all nodes in the scene, (t, k, 3)."""
    matrices: dict[int, Array] = {}

    def matrix(i: int) -> Array:
        if i not in matrices:
            own = _local(nodes[i], {path: moved[i, path] for path in _REST if (i, path) in moved}, n)
            matrices[i] = own if parents[i] < 0 else matrix(parents[i]) @ own
        return matrices[i]

    return np.stack([matrix(i)[:, :3, 3] for i in range(len(nodes))], axis=1)


def _local(node: Any, moved: dict[str, Array], n: int) -> Array:
    """A node's transform against its parent, (t, 4, 4)."""
    if node.matrix is not None and not moved:
        return np.broadcast_to(np.reshape(node.matrix, (4, 4)).T, (n, 4, 4))
    rest = {path: np.array(getattr(node, path) or default) for path, default in _REST.items()}
    move, turn, scale = (np.broadcast_to(moved.get(path, own), (n, len(own))) for path, own in rest.items())
    found = np.zeros((n, 4, 4))
    found[:, :3, :3] = matrix_from_quat((turn / np.linalg.norm(turn, axis=1, keepdims=True))[:, [3, 0, 1, 2]])
    found[:, :3, :3] *= scale[:, None]
    found[:, :3, 3] = move
    found[:, 3, 3] = 1.0
    return found


def read_ai4animation(data: bytes) -> Tracks:
    """Reads such a file; raises `ClipError` for other shapes."""
    with open_arrays(io.BytesIO(data)) as file:
        names = [str(name) for name in file["bone_names"]]
        parents = [int(i) for i in file["parent_indices"]] if "parent_indices" in file else []
        positions, rate = np.asarray(file["positions"], dtype=float), float(file["framerate"])
    if positions.shape[1:] != (len(names), 3) or len(parents) not in (0, len(names)):
        raise ClipError(f"positions of shape {positions.shape} for {len(names)} bones; expected (frames, bones, 3)")
    return Tracks(names, positions, rate, skeleton=skeleton_of(parents))
