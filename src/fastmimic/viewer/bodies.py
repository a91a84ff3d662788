"""The robot's meshes and kinematics, from the MuJoCo model of the videos, so that both look alike."""

from typing import TYPE_CHECKING, Any, Final, NamedTuple

import mujoco
import numpy as np

from fastmimic.base.arrays import Array
from fastmimic.base.rotations import quat_rotate
from fastmimic.render.video_scene import GHOST_GROUP, build_video_scene
from fastmimic.robot import Robot
from fastmimic.simulation.terrain import Terrain

if TYPE_CHECKING:
    from trimesh import Trimesh

Rgb = tuple[int, int, int]

_SLICES: Final = 20
_SHARP_RAD: Final = np.radians(30.0)  # edges above this angle are not shaded smoothly
_VISIBLE_GROUPS: Final = 2
SEEN_M: Final = 16.0


class BodyMesh(NamedTuple):
    """A moving body; its parts have one colour each (0 to 255) and are in the body's frame, m."""

    name: str
    parts: "tuple[tuple[Trimesh, Rgb], ...]"


class Placed(NamedTuple):
    """The places of a robot's bodies in the world: position (b, 3), m, wxyz (b, 4), and centre of mass (3,), m."""

    position: Array
    wxyz: Array
    com: Array


class Puppet:
    """A robot and its ghost in any pose; `bodies` and `ghost_bodies` are in the order of `Placed`."""

    def __init__(self, robot: Robot) -> None:
        video_scene = build_video_scene(robot, ghost=True, size=(64, 64), floor=np.zeros((2, 2)))
        assert video_scene.ghost_qpos is not None
        self._model, self._data = video_scene.model, mujoco.MjData(video_scene.model)
        self._qpos = (video_scene.robot_qpos, video_scene.ghost_qpos)
        model = self._model
        trunks = [model.jnt_bodyid[np.flatnonzero(model.jnt_qposadr == qpos[0])[0]] for qpos in self._qpos]
        self._ids = [np.flatnonzero(model.body_rootid == trunk) for trunk in trunks]  # of each, the trunk first
        self.bodies, self.ghost_bodies = (
            tuple(_body(model, int(body), ghost=ghost) for body in ids)
            for ids, ghost in zip(self._ids, (False, True), strict=True)
        )

    def place(self, pose: Array, reference: Array | None = None) -> tuple[Placed, Placed | None]:
        """Places robot and ghost at a pose (19,) each: root position, quaternion, joints."""
        self._data.qpos[self._qpos[0]] = pose
        if reference is not None:
            self._data.qpos[self._qpos[1]] = reference
        mujoco.mj_kinematics(self._model, self._data)
        mujoco.mj_comPos(self._model, self._data)
        robot, ghost = (
            Placed(self._data.xpos[ids], self._data.xquat[ids], self._data.subtree_com[ids[0]].copy())
            for ids in self._ids
        )
        return robot, None if reference is None else ghost


def _rgba(model: mujoco.MjModel, geom: int) -> Array:
    material = model.geom_matid[geom]
    return np.asarray(model.mat_rgba[material] if material >= 0 else model.geom_rgba[geom], dtype=np.float64)


def _body(model: mujoco.MjModel, body: int, *, ghost: bool) -> BodyMesh:
    """Merges a body's visible geoms colour by colour."""
    group = model.geom_group
    shown = group == GHOST_GROUP if ghost else (group <= _VISIBLE_GROUPS)
    by_colour: dict[Rgb, list[Trimesh]] = {}
    for geom in np.flatnonzero((model.geom_bodyid == body) & shown).tolist():
        mesh = surface(model, geom) if ghost or _rgba(model, geom)[3] > 0 else None
        if mesh is not None:
            mesh.vertices = model.geom_pos[geom] + quat_rotate(model.geom_quat[geom], mesh.vertices)
            r, g, b = (round(255 * float(c)) for c in _rgba(model, geom)[:3])
            by_colour.setdefault((r, g, b), []).append(mesh)
    name = str(model.body(body).name).rpartition("/")[2]
    return BodyMesh(name, tuple((sum(meshes[1:], meshes[0]), rgb) for rgb, meshes in by_colour.items()))


def ground_surface(terrain: Terrain) -> "Trimesh":
    """The ground's surface, of a plane or a field the part within `SEEN_M` of the origin; world, m."""
    from trimesh import Trimesh, creation, transformations, util

    if len(terrain.boxes):
        places = [transformations.translation_matrix(box[:3]) for box in terrain.boxes]
        sizes = 2.0 * terrain.boxes[:, 3:]
        boxes: Any = util.concatenate([creation.box(*each) for each in zip(sizes, places, strict=True)])
        return Trimesh(boxes.vertices, boxes.faces, process=False)
    half, cell = (SEEN_M, 1.0) if terrain.field is None else (min(SEEN_M, *terrain.field.half), terrain.field.cell)
    along = cell * np.arange(-round(half / cell), round(half / cell) + 1)
    x, y = np.meshgrid(along, along)
    n = len(along)
    corner = n * np.arange(n - 1)[:, None, None, None] + np.arange(n - 1)[:, None, None]
    faces = corner + np.array([[0, 1, n + 1], [0, n + 1, n]])
    return Trimesh(np.stack([x, y, terrain.height(x, y)], axis=-1).reshape(-1, 3), faces.reshape(-1, 3), process=False)


def surface(model: mujoco.MjModel, geom: int) -> "Trimesh | None":
    """A geom's surface in its own frame, m; None for kinds without one (planes, height fields)."""
    from trimesh import Trimesh, creation
    from trimesh.graph import smooth_shade

    kind, size = int(model.geom_type[geom]), model.geom_size[geom]
    types: Any = mujoco.mjtGeom
    if kind == types.mjGEOM_MESH:
        of = model.mesh(model.geom_dataid[geom])
        v, f = int(of.vertadr[0]), int(of.faceadr[0])
        vertices, faces = model.mesh_vert[v : v + int(of.vertnum[0])], model.mesh_face[f : f + int(of.facenum[0])]
        return Trimesh(vertices, faces, process=False)
    if kind == types.mjGEOM_BOX:
        mesh = creation.box(2 * size)
    elif kind == types.mjGEOM_CAPSULE:
        mesh = creation.capsule(2 * size[1], size[0], count=[_SLICES, _SLICES])
    elif kind == types.mjGEOM_CYLINDER:
        mesh = creation.cylinder(size[0], 2 * size[1], sections=_SLICES)
    elif kind in (types.mjGEOM_SPHERE, types.mjGEOM_ELLIPSOID):
        mesh = creation.icosphere(subdivisions=2)
        mesh.apply_scale(size if kind == types.mjGEOM_ELLIPSOID else size[0])
    else:
        return None
    return smooth_shade(mesh, _SHARP_RAD, facet_minarea=None)
