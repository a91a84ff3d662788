"""The robot's meshes and kinematics, from the MuJoCo model of the videos, so that both look alike."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from fastmimic.base.arrays import Array
from fastmimic.base.rotations import quat_rotate
from fastmimic.render.video_scene import GHOST_GROUP, build_video_scene
from fastmimic.robot import Robot

if TYPE_CHECKING:
    import mujoco


Rgb = tuple[int, int, int]

_SLICES: Final = 20
_ARC: Final = 7  # points of a quarter circle
_VISIBLE_GROUPS: Final = 2


@dataclass(frozen=True, eq=False)
class Part:
    """Geoms of one body that have one colour, in the body's frame.

    Attributes:
        vertices: (v, 3) m.
        faces: (f, 3) indices, counter-clockwise seen from outside.
        rgb: 0 to 255.
    """

    vertices: Array
    faces: NDArray[np.int64]
    rgb: Rgb


@dataclass(frozen=True, eq=False)
class BodyMesh:
    """A moving body and its visible parts."""

    name: str
    parts: tuple[Part, ...]


@dataclass(frozen=True, eq=False)
class Placed:
    """The places of a robot's bodies.

    Attributes:
        position: (b, 3) world, m.
        wxyz: (b, 4) body → world.
        com: (3,) centre of mass of the whole robot, world, m.
    """

    position: Array
    wxyz: Array
    com: Array


class Puppet:
    """A robot and its ghost in any pose; `bodies` and `ghost_bodies` are in the order of `Placed`."""

    def __init__(self, robot: Robot) -> None:
        import mujoco

        video_scene = build_video_scene(robot, ghost=True, width=64, height=64, floor=np.zeros((2, 2)))
        assert video_scene.ghost_qpos is not None
        self._model, self._data = video_scene.model, mujoco.MjData(video_scene.model)
        self._qpos = (video_scene.robot_qpos, video_scene.ghost_qpos)
        roots = [self._root(qpos) for qpos in self._qpos]
        self._roots = roots
        self._ids = [[b for b in range(1, self._model.nbody) if self._model.body_rootid[b] == root] for root in roots]
        self.bodies = tuple(_body(self._model, b, _seen(self._model, b)) for b in self._ids[0])
        self.ghost_bodies = tuple(_body(self._model, b, _ghostly(self._model, b)) for b in self._ids[1])

    def _root(self, qpos: NDArray[np.int64]) -> int:
        free = int(np.flatnonzero(self._model.jnt_qposadr == qpos[0])[0])
        return int(self._model.jnt_bodyid[free])

    def place(self, pose: Array, reference: Array | None = None) -> tuple[Placed, Placed | None]:
        """Places robot and ghost at a pose (19,) each: root position, quaternion, joints."""
        import mujoco

        self._data.qpos[self._qpos[0]] = pose
        if reference is not None:
            self._data.qpos[self._qpos[1]] = reference
        mujoco.mj_kinematics(self._model, self._data)
        mujoco.mj_comPos(self._model, self._data)
        return self._placed(0), None if reference is None else self._placed(1)

    def _placed(self, which: int) -> Placed:
        ids = self._ids[which]
        com = self._data.subtree_com[self._roots[which]]
        return Placed(self._data.xpos[ids].copy(), self._data.xquat[ids].copy(), com.copy())


def _seen(model: "mujoco.MjModel", body: int) -> list[int]:
    return [
        g
        for g in range(model.ngeom)
        if model.geom_bodyid[g] == body and model.geom_group[g] <= _VISIBLE_GROUPS and _rgba(model, g)[3] > 0
    ]


def _ghostly(model: "mujoco.MjModel", body: int) -> list[int]:
    return [g for g in range(model.ngeom) if model.geom_bodyid[g] == body and model.geom_group[g] == GHOST_GROUP]


def _rgba(model: "mujoco.MjModel", geom: int) -> Array:
    material = model.geom_matid[geom]
    return np.asarray(model.mat_rgba[material] if material >= 0 else model.geom_rgba[geom], dtype=np.float64)


def _body(model: "mujoco.MjModel", body: int, geoms: list[int]) -> BodyMesh:
    """Merges a body's geoms colour by colour."""
    by_colour: dict[Rgb, list[tuple[Array, NDArray[np.int64]]]] = {}
    for geom in geoms:
        mesh = _geom_mesh(model, geom)
        if mesh is not None:
            r, g, b = (round(255 * float(c)) for c in _rgba(model, geom)[:3])
            by_colour.setdefault((r, g, b), []).append(mesh)
    name = str(model.body(body).name).rpartition("/")[2]
    return BodyMesh(name, tuple(Part(*_merged(meshes), rgb) for rgb, meshes in by_colour.items()))


def _merged(meshes: list[tuple[Array, NDArray[np.int64]]]) -> tuple[Array, NDArray[np.int64]]:
    first = np.cumsum([0, *(len(v) for v, _ in meshes)])
    faces = [f + start for (_, f), start in zip(meshes, first, strict=False)]
    return np.concatenate([v for v, _ in meshes]), np.concatenate(faces)


def _geom_mesh(model: "mujoco.MjModel", geom: int) -> tuple[Array, NDArray[np.int64]] | None:
    """A geom's surface in its body's frame; None for kinds without one (planes, height fields)."""
    local = surface(model, geom)
    if local is None:
        return None
    vertices, faces = local
    return model.geom_pos[geom] + quat_rotate(model.geom_quat[geom], vertices), faces


def surface(model: "mujoco.MjModel", geom: int) -> tuple[Array, NDArray[np.int64]] | None:
    """A geom's surface in its own frame: vertices (v, 3), m, and faces (f, 3); None for kinds without one."""
    import mujoco

    kind, (a, b, c) = model.geom_type[geom], (float(s) for s in model.geom_size[geom])
    types: Any = mujoco.mjtGeom
    if kind == types.mjGEOM_BOX:
        return box(a, b, c)
    if kind == types.mjGEOM_SPHERE:
        return revolved(_arc(a, 0.0, 0.0))
    if kind == types.mjGEOM_CAPSULE:
        return revolved(_arc(a, b, b))
    if kind == types.mjGEOM_CYLINDER:
        return revolved(np.array([[0, -b], [a, -b], [a, -b], [a, b], [a, b], [0, b]]))
    if kind == types.mjGEOM_ELLIPSOID:
        vertices, faces = revolved(_arc(1.0, 0.0, 0.0))
        return vertices * np.array([a, b, c]), faces
    if kind == types.mjGEOM_MESH:
        mesh = model.geom_dataid[geom]
        v0, nv = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
        f0, nf = model.mesh_faceadr[mesh], model.mesh_facenum[mesh]
        return np.array(model.mesh_vert[v0 : v0 + nv], np.float64), np.array(model.mesh_face[f0 : f0 + nf], np.int64)
    return None


def box(a: float, b: float, c: float) -> tuple[Array, NDArray[np.int64]]:
    """Surface of a box of half sizes a, b, c, m: (24, 3) vertices, for sharp edges, and (12, 3) faces."""
    vertices: list[Array] = []
    faces: list[tuple[int, int, int]] = []
    for axis in range(3):
        for sign in (-1.0, 1.0):
            u, v = (axis + 1) % 3, (axis + 2) % 3
            corners = [(-1, -1), (1, -1), (1, 1), (-1, 1)] if sign > 0 else [(-1, -1), (-1, 1), (1, 1), (1, -1)]
            first = len(vertices)
            for s, t in corners:
                corner = np.zeros(3)
                corner[axis], corner[u], corner[v] = sign, s, t
                vertices.append(corner)
            faces += [(first, first + 1, first + 2), (first, first + 2, first + 3)]
    return np.array(vertices) * np.array([a, b, c]), np.array(faces, dtype=np.int64)


def revolved(profile: Array, slices: int = _SLICES) -> tuple[Array, NDArray[np.int64]]:
    """Surface of revolution about z of a profile (k, 2): radius, height, m, upwards; equal points make a sharp edge."""
    angle = 2 * np.pi * np.arange(slices) / slices
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    rings = profile[:, None, :1] * circle[None]
    heights = np.broadcast_to(profile[:, None, 1:], (*rings.shape[:2], 1))
    vertices = np.concatenate([rings, heights], axis=-1).reshape(-1, 3)
    faces = []
    for k in range(len(profile) - 1):
        if np.array_equal(profile[k], profile[k + 1]):
            continue
        for i in range(slices):
            j = (i + 1) % slices
            low, high = k * slices, (k + 1) * slices
            if profile[k, 0] > 0:
                faces.append((low + i, low + j, high + i))
            if profile[k + 1, 0] > 0:
                faces.append((low + j, high + j, high + i))
    return vertices, np.array(faces, dtype=np.int64)


def _arc(radius: float, below: float, above: float) -> Array:
    """Profile of a sphere's two halves, `below` and `above` the origin, m."""
    quarter = np.linspace(0.0, np.pi / 2, _ARC)
    upper = quarter if below + above > 0 else quarter[1:]  # a sphere has one equator
    angle = np.concatenate([-quarter[::-1], upper])
    offset = np.concatenate([np.full(_ARC, -below), np.full(len(upper), above)])
    radii = radius * np.cos(angle)
    radii[[0, -1]] = 0.0
    return np.stack([radii, radius * np.sin(angle) + offset], axis=-1)
