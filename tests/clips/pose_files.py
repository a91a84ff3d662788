"""The ten points (t, 10, 3) of a take, z up and metres, as other programs write them: their names, orders and types."""

import pickle
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from fastmimic.clips.formats.point_names import BUILT_IN

NAMES = tuple(BUILT_IN["SuperAnimal-Quadruped"].values())
JOINTS = tuple(name.replace(".end", "Site") for name in BUILT_IN["AI4Animation's dog"].values())
PARENTS = (-1, 0, 1, 1, 0, 0, 2, 3, 4, 5)


def to_camera(points: np.ndarray) -> np.ndarray:
    """Millimetres; x right, y down, z away from the camera."""
    return 1000 * np.stack([-points[..., 1], -points[..., 2], points[..., 0]], axis=-1)


def _csv(header: Sequence[Sequence[str]], rows: Sequence[Sequence[float | int]]) -> str:
    """As pandas writes it: NaN is empty, the shortest text that is exact."""

    def text(value: float | int) -> str:
        return "" if value != value else repr(value if isinstance(value, int) else float(value))

    return "\n".join([*(",".join(line) for line in header), *(",".join(map(text, row)) for row in rows)]) + "\n"


def deeplabcut_csv(
    animals: dict[str, np.ndarray], coordinates: str = "xyz", likelihood: float | None = None, scorer: str = "DLC_3D"
) -> str:
    """`DataFrame.to_csv` of `deeplabcut.triangulate`; individuals only if there are several animals. With
    `likelihood` and coordinates xy it is a file of points in a picture, also Lightning Pose's."""
    coords = [*coordinates, *([] if likelihood is None else ["likelihood"])]
    columns = [(scorer, who, name, c) for who in animals for name in NAMES for c in coords]
    levels = ["scorer", "individuals", "bodyparts", "coords"]
    header = [
        [level, *(column[i] for column in columns)] for i, level in enumerate(levels) if i != 1 or len(animals) > 1
    ]
    blocks = [to_camera(points)[..., : len(coordinates)] for points in animals.values()]
    if likelihood is not None:
        blocks = [np.concatenate([b, np.full((*b.shape[:2], 1), likelihood)], axis=2) for b in blocks]
    values = np.concatenate([b.reshape(len(b), -1) for b in blocks], axis=1)
    return _csv(header, [[i, *row] for i, row in enumerate(values)])


def anipose_csv(points: np.ndarray, score: np.ndarray | None = None) -> str:
    """`anipose triangulate`, without `reference_point` and `axes` in its settings."""
    seen = to_camera(points)
    header, columns = [], []
    for k, name in enumerate(NAMES):
        known = np.isfinite(seen[:, k, 0])
        header += [f"{name}_{what}" for what in ("x", "y", "z", "error", "ncams", "score")]
        columns += [*seen[:, k].T, np.where(known, 1.5, np.nan), np.where(known, 3.0, np.nan)]
        columns.append(np.where(known, 0.98, np.nan) if score is None else score[:, k])
    header += [f"M_{i}{j}" for i in range(3) for j in range(3)] + [f"center_{i}" for i in range(3)] + ["fnum"]
    columns += [np.full(len(points), v) for v in (*np.eye(3).ravel(), 0.0, 0.0, 0.0)]
    rows = np.stack(columns, axis=1)
    return _csv([header], [[*row, i] for i, row in enumerate(rows)])


def deeplabcut_h5(path: Path, points: np.ndarray) -> Path:
    """`DataFrame.to_hdf(key="df_with_missing", format="table")`, as PyTables lays it out."""
    import h5py

    columns = [("DLC_3D", name, c) for name in NAMES for c in "xyz"]
    table = np.zeros(len(points), dtype=[("index", "<i8"), ("values_block_0", "<f8", (len(columns),))])
    table["index"] = np.arange(len(points))
    table["values_block_0"] = to_camera(points).reshape(len(points), -1)
    with h5py.File(path, "w") as file:
        group = file.create_group("df_with_missing")
        group.attrs["pandas_type"] = np.bytes_(b"frame_table")
        group.attrs["non_index_axes"] = np.bytes_(pickle.dumps([(1, columns)], 0))
        data = group.create_dataset("table", data=table)
        data.attrs["values_block_0_kind"] = np.bytes_(pickle.dumps(columns, 0))
    return path


def deeplabcut_fixed_h5(path: Path, points: np.ndarray) -> Path:
    """`DataFrame.to_hdf(key="df_with_missing")`, as PyTables lays it out: pandas' default format, "fixed"."""
    import h5py

    levels = (["DLC_3D"], list(NAMES), list("xyz"))
    places = np.unravel_index(np.arange(3 * len(NAMES)), (1, len(NAMES), 3))
    with h5py.File(path, "w") as file:
        group = file.create_group("df_with_missing")
        group.attrs.update(pandas_type=np.bytes_(b"frame"), nblocks=1, block0_items_nlevels=len(levels))
        for i, (level, place) in enumerate(zip(levels, places, strict=True)):
            group[f"block0_items_level{i}"] = np.array(level, "S")
            group[f"block0_items_label{i}"] = place.astype(np.int8)
        group["block0_values"] = to_camera(points).reshape(len(points), -1)
    return path


def sleap_anipose_h5(path: Path, animals: Sequence[np.ndarray], names: bool = False) -> Path:
    """`points3d.h5` of `sleap_anipose.triangulate`: (frames, tracks, nodes, 3), without the names of the nodes."""
    import h5py

    tracks = np.stack([to_camera(points) for points in animals], axis=1)
    with h5py.File(path, "w") as file:
        file.create_dataset("tracks", data=tracks, chunks=True, compression="gzip", compression_opts=1)
        file["tracks"].attrs["Description"] = "Shape: (n_frames, n_tracks, n_nodes, 3)."
        if names:
            file.create_dataset("node_names", data=np.array(NAMES, dtype="S"))
    return path


def sleap_project(path: Path) -> Path:
    """A project's labels: tables of frames, instances and points of a picture."""
    import h5py

    with h5py.File(path, "w") as file:
        file.create_group("metadata").attrs["format_id"] = 1.2
        for name in ("frames", "instances", "points", "pred_points"):
            file[name] = np.zeros(3, dtype=[("x", "<f8"), ("y", "<f8")])
    return path


def sleap_analysis_h5(path: Path, points: np.ndarray) -> Path:
    """SLEAP's analysis export of one view: (tracks, 2, nodes, frames)."""
    import h5py

    with h5py.File(path, "w") as file:
        file.create_dataset("tracks", data=to_camera(points)[None, ..., :2].transpose(0, 3, 2, 1))
        file.create_dataset("node_names", data=np.array(NAMES, dtype="S"))
        file.create_dataset("track_names", data=np.array([b"track_0"]))
    return path


def c3d(path: Path, points: np.ndarray, rate_hz: float, unit: str = "mm") -> Path:
    """Through ezc3d: z up; a marker that is NaN is at the origin with residual -1, as recording programs write it."""
    import ezc3d

    file = ezc3d.c3d()
    file["parameters"]["POINT"]["RATE"]["value"] = [rate_hz]
    file["parameters"]["POINT"]["LABELS"]["value"] = tuple(f"Rex:{name}" for name in NAMES)
    file["parameters"]["POINT"]["UNITS"]["value"] = [unit]
    missing = np.isnan(points[..., 0]).T
    data = np.ones((4, points.shape[1], len(points)))
    data[:3] = np.nan_to_num(points).transpose(2, 1, 0) * {"mm": 1000.0, "m": 1.0}[unit]
    file["data"]["points"] = data
    file["data"]["meta_points"]["residuals"] = np.where(missing, -1.0, 0.0)[None]
    file.write(str(path))
    return path


def ai4animation_npz(path: Path, points: np.ndarray, rate_hz: float) -> Path:
    """`Motion.SaveToNPZ`: y up, float32; the names of the parents are an object array, for the root has none."""
    parents = np.array([None if p < 0 else JOINTS[p] for p in PARENTS], dtype=object)
    np.savez_compressed(
        path,
        name="Walk",
        framerate=rate_hz,
        positions=points[..., [1, 2, 0]].astype(np.float32),
        quaternions=np.tile(np.float32([0, 0, 0, 1]), (*points.shape[:2], 1)),
        bone_names=list(JOINTS),
        parent_names=parents,
        parent_indices=list(PARENTS),
    )
    return path


def glb(path: Path, points: np.ndarray, rate_hz: float, how: str = "LINEAR", every: int = 1) -> Path:
    """A skeleton under a node that scales centimetres to metres and turns z up to y up, as Blender exports it: hips
    that turn with the trunk, and joints that move in their frame, with a key at each `every`th frame."""
    import pygltflib as gl

    ahead = points[:, 1] - points[:, 0]
    yaw, pitch = np.arctan2(ahead[:, 1], ahead[:, 0]), -np.arcsin(ahead[:, 2] / np.linalg.norm(ahead, axis=1))
    trunk = Rotation.from_euler("ZY", np.stack([yaw, pitch], axis=1))
    blob, views, accessors = bytearray(), [], []

    def accessor(values: np.ndarray) -> int:
        raw = values.astype("<f4").tobytes()
        views.append(gl.BufferView(buffer=0, byteOffset=len(blob), byteLength=len(raw)))
        blob.extend(raw)
        kind = {1: "SCALAR", 3: "VEC3", 4: "VEC4"}[1 if values.ndim == 1 else values.shape[1]]
        accessors.append(gl.Accessor(bufferView=len(views) - 1, componentType=gl.FLOAT, count=len(values), type=kind))
        return len(accessors) - 1

    times = np.arange(len(points)) / rate_hz
    samplers, channels = [], []

    def animate(node: int, what: str, values: np.ndarray, how: str, every: int) -> None:
        keys = np.append(np.arange(0, len(times) - 1, every), len(times) - 1)
        output = values[keys]
        if how == "CUBICSPLINE":
            tangent = CubicSpline(times, values).derivative()(times[keys])
            output = np.stack([tangent, output, tangent], axis=1).reshape(-1, values.shape[1])
        samplers.append(gl.AnimationSampler(input=accessor(times[keys]), output=accessor(output), interpolation=how))
        target = gl.AnimationChannelTarget(node=node, path=what)
        channels.append(gl.AnimationChannel(sampler=len(samplers) - 1, target=target))

    nodes = [gl.Node(name="Armature", children=[1], scale=[0.01] * 3, rotation=[-0.5, -0.5, -0.5, 0.5])]
    nodes += [gl.Node(name=JOINTS[0], children=list(range(2, 11)))]
    nodes += [gl.Node(name=name) for name in JOINTS[1:]]
    animate(1, "translation", 100 * points[:, 0], "STEP" if how == "STEP" else "LINEAR", 1)
    animate(1, "rotation", trunk.as_quat(canonical=False), how, 1)
    for k in range(1, 10):
        animate(k + 1, "translation", 100 * trunk.inv().apply(points[:, k] - points[:, 0]), how, every)
    file = gl.GLTF2(
        scene=0,
        scenes=[gl.Scene(nodes=[0])],
        nodes=nodes,
        skins=[gl.Skin(joints=list(range(1, 11)))],
        animations=[gl.Animation(name="Walk", samplers=samplers, channels=channels)],
        buffers=[gl.Buffer(byteLength=len(blob))],
        bufferViews=views,
        accessors=accessors,
    )
    file.set_binary_blob(bytes(blob))
    file.save_binary(str(path))
    return path
