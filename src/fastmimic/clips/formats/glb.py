"""Animated skeletons in glTF 2.0's binary form (.glb): a tree of nodes, each with translation, rotation and scale
against its parent, and for each of them samplers of keys (linear, step or cubic spline), which are sampled at the rate
of the densest one. The file is read with pygltflib."""

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from fastmimic.base.arrays import Array
from fastmimic.base.errors import ClipError
from fastmimic.base.rotations import matrix_from_quat
from fastmimic.clips.formats.tracked_points import Tracks, library, tracks_format

_MAGIC: Final = b"glTF"
_TYPES: Final = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_SIZES: Final = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}
_ROUNDING: Final = 0.01  # share of a frame: times are of single precision
_MOST: Final = 1_000_000  # frames
_REST: Final = {"translation": (0.0, 0.0, 0.0), "rotation": (0.0, 0.0, 0.0, 1.0), "scale": (1.0, 1.0, 1.0)}


def read(data: bytes) -> Tracks:
    """Reads such a file. Raises `ClipError`: no pygltflib, or without an animation."""
    file = library("pygltflib").GLTF2.load_from_bytes(data)
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
    return Tracks(names, positions, rate, notes=notes, parents=bones)


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


def _positions(
    nodes: Sequence[Any], parents: Sequence[int], moved: dict[tuple[int, str], Array], n: int
) -> NDArray[np.float64]:
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


FORMAT: Final = tracks_format(
    "glb",
    "animated skeleton in glTF's binary form (.glb)",
    (".glb",),
    lambda content: content.data.startswith(_MAGIC),
    read,
    binary=True,
)
