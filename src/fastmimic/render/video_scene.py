"""The MuJoCo scene of a video: the robot, its ghost, the light, and the ground, flat or a terrain; and one panel of it,
seen by a camera, with a shadow under the robot."""

from dataclasses import dataclass
from importlib import resources
from typing import TYPE_CHECKING, Final

import mujoco
import numpy as np
from matplotlib.colors import to_rgba
from numpy.typing import NDArray

from fastmimic.base.arrays import Array, Flags, Indices
from fastmimic.render.encoding import PREVIEW, Quality
from fastmimic.render.figure_style import DEMONSTRATION, LEG_LINES
from fastmimic.robot import Robot
from fastmimic.simulation.mujoco_sim import floor_shapes
from fastmimic.simulation.terrain import Terrain

if TYPE_CHECKING:
    from fastmimic.render.tracks import Shown

Rgba = tuple[float, float, float, float]

_ROBOT: Final = "robot/"
_GHOST: Final = "ghost/"
GHOST_GROUP: Final = 4
_HIDDEN_GROUP: Final = 5
_GHOST_SHRINK: Final = 0.97  # avoids flicker where the robot matches its demonstration
LIGHT_DIR: Final = (0.30, 0.40, -1.0)  # as in video.xml

_ELEVATION_DEG: Final = -19.0  # the ground fills the picture
_SHADOW_RGBA: Final = (0.30, 0.33, 0.37, 1.0)
_EVERYTHING: Final = mujoco.mjtCatBit.mjCAT_ALL.value
_GROUND_ONLY: Final = mujoco.mjtCatBit.mjCAT_STATIC.value
_GEOM: Final = mujoco.mjtObj.mjOBJ_GEOM
_FLATTEN: Final = np.array(
    [
        [1.0, 0.0, -LIGHT_DIR[0] / LIGHT_DIR[2]],
        [0.0, 1.0, -LIGHT_DIR[1] / LIGHT_DIR[2]],
        [0.0, 0.0, 1e-3],  # not quite flat: a singular matrix has no normals
    ]
)  # projects along the light onto the ground
_SHADOW_HEIGHT: Final = np.array([0.0, 0.0, 0.002])
_MARK_HEIGHT: Final = 0.004
_MARK_RADIUS: Final = 0.034
_TRAIL_WIDTH: Final = 3.0  # pixels in a picture of 720 lines; at least half of it
_LIGHT_DISTANCE: Final = 3.0  # m, from the point that the camera looks at
_ZERO: Final = np.zeros(3)
_UPRIGHT: Final = np.eye(3).ravel()
_MAX_MARKS: Final = 400  # bones, trails and contacts drawn at once, with their shadows

_CHECKER: Final = "checker"
_TILES: Final = ("light tiles", "dark tiles")
TILE_M: Final = 0.5  # edge of a ground tile
_TILED_M: Final = 8.0  # reach of the tiles; the fog hides the rest
_OVERLAP: Final = 0.05  # m
_GROUND_M: Final = 22.0  # reach of the ground; the fog hides its edge
_HAZE: Final = (0.93, 0.95, 0.97)
GHOST_RGBA: Final[Rgba] = to_rgba(DEMONSTRATION.color, 0.36)


def leg_rgba(leg: int, alpha: float) -> Rgba:
    return to_rgba(LEG_LINES[leg].color, alpha)


@dataclass(frozen=True, eq=False)
class VideoScene:
    """A model with the robot and perhaps its ghost, and their coordinates in `qpos`."""

    model: mujoco.MjModel
    robot_qpos: Indices  # (19,) of the robot's root position, quaternion and joints in the common order
    ghost_qpos: Indices | None  # (19,) those of the ghost; None without one
    casts_shadow: Flags  # (ngeom,) geoms with a shadow: the robot's main ones
    quality: Quality = PREVIEW
    tiles: tuple[int, ...] = ()  # geoms of the ground's pattern, which follow the camera; none with a texture
    tile: float = TILE_M  # edge of a tile, m
    terrain: Terrain | None = None  # in place of the flat ground


def build_video_scene(
    robot: Robot,
    *,
    ghost: bool,
    size: tuple[int, int],
    floor: Array,
    quality: Quality = PREVIEW,
    tile: float = TILE_M,
    terrain: Terrain | None = None,
) -> VideoScene:
    """Puts a robot, and if wanted its ghost, on a checkered ground with tiles of `tile` m, flat or a `terrain`, in a
    picture of `size`, width and height in pixels. `floor` (2, 2) is the least and greatest x and y of the robots, m."""
    spec = _studio(size, quality)
    if terrain is None:
        _add_ground(spec, floor, quality, tile)
    else:
        _add_terrain(spec, terrain, tile)
    for prefix in (_ROBOT, _GHOST)[: 1 + ghost]:
        spec.attach(_bare_robot(robot), prefix=prefix, frame=spec.worldbody.add_frame())
    model = spec.compile()
    robot_qpos, robot_geoms = _find(model, robot, _ROBOT)
    ghost_qpos = None
    if ghost:
        ghost_qpos, ghost_geoms = _find(model, robot, _GHOST)
        main = _main_geoms(model, ghost_geoms)
        model.geom_group[ghost_geoms] = np.where(main[ghost_geoms], GHOST_GROUP, _HIDDEN_GROUP)
        model.geom_matid[ghost_geoms] = -1
        model.geom_rgba[ghost_geoms] = GHOST_RGBA
        model.geom_size[ghost_geoms] *= _GHOST_SHRINK
    follow = terrain is None and not quality.textured
    tiles = tuple(int(model.geom(name).id) for name in _TILES) if follow else ()
    casts_shadow = _main_geoms(model, robot_geoms) & (terrain is None)
    return VideoScene(model, robot_qpos, ghost_qpos, casts_shadow, quality, tiles, tile, terrain)


def _studio(size: tuple[int, int], quality: Quality) -> mujoco.MjSpec:
    """A scene with light and haze only."""
    spec = mujoco.MjSpec.from_string(resources.files("fastmimic.render").joinpath("video.xml").read_text("utf-8"))
    visual, facets = spec.visual, spec.visual.quality
    visual.global_.offwidth, visual.global_.offheight = size
    facets.offsamples, facets.shadowsize = quality.samples, quality.shadow_map
    facets.numslices, facets.numstacks, facets.numquads = quality.facets, quality.facets // 2, 1
    visual.rgba.fog = [*_HAZE, 1]
    spec.lights[0].castshadow = quality.shadow_map > 0
    return spec


def _bare_robot(robot: Robot) -> mujoco.MjSpec:
    """The robot's model without floor, lights and cameras."""
    spec = robot.spec()
    for element in (*spec.worldbody.geoms, *spec.lights, *spec.cameras, *spec.keys):
        spec.delete(element)
    spec.nkey = 0
    return spec


def _find(model: mujoco.MjModel, robot: Robot, prefix: str) -> tuple[Indices, Flags]:
    """Indices in `qpos` (19,) and a mask of the geoms (ngeom,) of the copy of the robot with this prefix."""
    joints = [model.joint(prefix + name).id for name in robot.joint_names]
    root = model.body_rootid[model.jnt_bodyid[joints[0]]]
    geoms = model.body_rootid[model.geom_bodyid] == root
    if not _seen(model, geoms).any():  # a model that has only what collides
        model.geom_group[geoms & _solid(model)] = 0
    free = np.flatnonzero((model.jnt_type == mujoco.mjtJoint.mjJNT_FREE) & (model.jnt_bodyid == root))[0]
    first = int(model.jnt_qposadr[free])
    qpos = np.concatenate([np.arange(first, first + 7), model.jnt_qposadr[joints]]).astype(np.int64)
    return qpos, geoms


def _main_geoms(model: mujoco.MjModel, geoms: Flags) -> Flags:
    """A robot's geoms shown in its ghost and shadow: the visible colliding ones, or all visible ones if none."""
    seen = _seen(model, geoms)
    solid = seen & _solid(model)
    return solid if solid.any() else seen


def _seen(model: mujoco.MjModel, geoms: Flags) -> Flags:
    return geoms & (model.geom_group <= 2) & (model.geom_rgba[:, 3] > 0)


def _solid(model: mujoco.MjModel) -> Flags:
    return np.asarray((model.geom_contype != 0) | (model.geom_conaffinity != 0))


def _add_ground(spec: mujoco.MjSpec, floor: Array, quality: Quality, tile: float) -> None:
    """A textured plane, or tiles of two colours side by side, faster on a processor: nothing is drawn twice."""
    if quality.textured:
        half = float(np.max(floor[1] - floor[0])) / 2 + _GROUND_M
        spec.worldbody.add_geom(
            name="ground",
            type=mujoco.mjtGeom.mjGEOM_PLANE,
            pos=[*np.round(floor.mean(axis=0) / (2 * tile)) * (2 * tile), 0],
            size=[half, half, half],  # the third is the grid's spacing: one quad is enough without spotlights
            material=_CHECKER,
        )
        _lay_checker(spec, tile, quality.reflectance)
        return
    for parity, (name, rgb) in enumerate(zip(_TILES, _tile_colours(spec), strict=True)):
        vertices, faces = _checkered(tile, parity)
        if parity == 0:
            vertices, faces = _framed(vertices, faces)
        shell = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL
        spec.add_mesh(name=name, uservert=vertices.ravel(), userface=faces.ravel(), inertia=shell)
        spec.worldbody.add_geom(
            name=name, type=mujoco.mjtGeom.mjGEOM_MESH, meshname=name, rgba=[*rgb, 1], contype=0, conaffinity=0
        )
    spec.delete(spec.material(_CHECKER))
    spec.delete(spec.texture(_CHECKER))


def _add_terrain(spec: mujoco.MjSpec, terrain: Terrain, tile: float) -> None:
    """The simulation's ground, checkered, or steps and stones of two colours by turns; and a sky, where it ends."""
    sky, plain = mujoco.mjtTexture.mjTEXTURE_SKYBOX, mujoco.mjtBuiltin.mjBUILTIN_FLAT
    spec.add_texture(name="sky", type=sky, builtin=plain, rgb1=_HAZE, rgb2=_HAZE, width=8, height=48)
    _lay_checker(spec, tile, 0.0)
    for k, shape in enumerate(floor_shapes(spec, terrain).values()):
        look = {"rgba": [*_tile_colours(spec)[k % 2], 1]} if len(terrain.boxes) else {"material": _CHECKER}
        spec.worldbody.add_geom(**shape, **look)


def _lay_checker(spec: mujoco.MjSpec, tile: float, reflectance: float) -> None:
    """Gives the checkered material, of video.xml, the tiles' size and the ground's reflectance."""
    material = spec.material(_CHECKER)
    material.texrepeat = [1 / tile, 1 / tile]  # a plane's texture spans two units of length, and two tiles
    material.reflectance = reflectance


def _tile_colours(spec: mujoco.MjSpec) -> Array:
    """The light and the dark one, (2, 3), 0 to 1."""
    texture = spec.texture(_CHECKER)
    return np.array([texture.rgb1, texture.rgb2])


def _checkered(tile: float, parity: int) -> tuple[Array, NDArray[np.int32]]:
    """Every other tile of a square of ± `_TILED_M`: vertices (k, 4, 3) and triangles (k, 2, 3), facing up."""
    n = 2 * int(np.ceil(_TILED_M / (2 * tile)))
    column, row = np.meshgrid(np.arange(-n, n), np.arange(-n, n))
    low = np.stack([column, row], axis=-1)[(column + row) % 2 == parity] * tile
    return _quads(low, low + tile)


def _framed(vertices: Array, faces: NDArray[np.int32]) -> tuple[Array, NDArray[np.int32]]:
    """Extends a square of tiles by the ground around it, which overlaps their edge to hide cracks."""
    inner, outer = float(vertices[..., 0].max()) - _OVERLAP, _GROUND_M
    low = np.array([[-outer, inner], [-outer, -outer], [-outer, -inner], [inner, -inner]])
    high = np.array([[outer, outer], [outer, -inner], [-inner, inner], [outer, inner]])
    more, their_faces = _quads(low, high)
    more[..., 2] = -_OVERLAP / 10
    return np.concatenate([vertices, more]), np.concatenate([faces, their_faces + 4 * len(vertices)])


def _quads(low: Array, high: Array) -> tuple[Array, NDArray[np.int32]]:
    """Rectangles on the ground between corners (k, 2) as vertices (k, 4, 3) and triangles (k, 2, 3), facing up."""
    vertices = np.zeros((len(low), 4, 3))
    vertices[:, :, 0] = np.stack([low[:, 0], high[:, 0], high[:, 0], low[:, 0]], axis=1)
    vertices[:, :, 1] = np.stack([low[:, 1], low[:, 1], high[:, 1], high[:, 1]], axis=1)
    first = 4 * np.arange(len(low))[:, None, None]
    return vertices, (first + np.array([[0, 1, 2], [0, 2, 3]])).astype(np.int32)


class CameraView:
    """One panel of a video: poses the robots as `shown`, frame by frame, and collects what to draw. The camera looks
    along `azimuth_deg`, from the world's x axis, at `look_at` (n, 3), in `distance`, m."""

    def __init__(
        self, video_scene: VideoScene, shown: "Shown", look_at: Array, *, azimuth_deg: float, distance: float
    ) -> None:
        self.video_scene, self._shown, self._look_at = video_scene, shown, look_at
        self._trail_width = _TRAIL_WIDTH * max(video_scene.model.vis.global_.offheight / 720, 0.5)
        self._data = mujoco.MjData(video_scene.model)
        self.scene = mujoco.MjvScene(video_scene.model, maxgeom=2 * video_scene.model.ngeom + _MAX_MARKS)
        self.scene.flags[mujoco.mjtRndFlag.mjRND_SHADOW] = video_scene.quality.shadow_map > 0
        self.scene.flags[mujoco.mjtRndFlag.mjRND_REFLECTION] = video_scene.quality.reflectance > 0
        # it is by vertex, and steps are long
        self.scene.flags[mujoco.mjtRndFlag.mjRND_FOG] = video_scene.terrain is None
        self._option = mujoco.MjvOption()
        self._camera = mujoco.MjvCamera()
        self._camera.azimuth, self._camera.elevation = azimuth_deg, _ELEVATION_DEG
        self._camera.distance = distance
        self._shadows: list[tuple[mujoco.MjvGeom, mujoco.MjvGeom]] | None = None

    def frame(self, number: int) -> mujoco.MjvScene:
        """The scene of a frame, valid until the next one. The first settles whether robot and ghost are shown."""
        model, data, video_scene, shown = self.video_scene.model, self._data, self.video_scene, self._shown
        if shown.robot is not None:
            data.qpos[video_scene.robot_qpos] = shown.robot[number]
        if video_scene.ghost_qpos is not None and shown.ghost is not None:
            data.qpos[video_scene.ghost_qpos] = shown.ghost[number]
        self._option.geomgroup[GHOST_GROUP] = shown.ghost is not None
        mujoco.mj_kinematics(model, data)
        mujoco.mj_camlight(model, data)
        self._camera.lookat[:] = look_at = self._look_at[number]
        drawn = _GROUND_ONLY if shown.robot is None else _EVERYTHING
        mujoco.mjv_updateScene(model, data, self._option, None, self._camera, drawn, self.scene)
        self._follow(look_at)
        self._cast_shadow()
        shown.mark(self, number, self._trail_width)
        return self.scene

    def line(self, start: Array, end: Array, leg: int, alpha: float, width: float) -> None:
        """Adds a line between two points (3,), world, in the colour of a leg; `width` in pixels."""
        geom = self.add(mujoco.mjtGeom.mjGEOM_LINE, _ZERO, _ZERO, leg_rgba(leg, alpha))
        mujoco.mjv_connector(geom, mujoco.mjtGeom.mjGEOM_LINE, width, start, end)
        geom.emission, geom.specular = 0.6, 0.0

    def disc(self, centre: Array, leg: int) -> None:
        """Adds the mark of a loaded foot on the ground under `centre` (3,), world."""
        terrain = self.video_scene.terrain
        ground = 0.0 if terrain is None else float(terrain.height(centre[0], centre[1]))
        at = np.array([centre[0], centre[1], ground + _MARK_HEIGHT])
        size = np.array([_MARK_RADIUS, 0.001, 0.0])
        geom = self.add(mujoco.mjtGeom.mjGEOM_CYLINDER, size, at, leg_rgba(leg, 0.75))
        geom.emission, geom.specular = 0.2, 0.0

    def add(self, kind: mujoco.mjtGeom, size: Array, at: Array, rgba: Rgba) -> mujoco.MjvGeom:
        """Adds something to be drawn in this frame, at (3,), world."""
        assert self.scene.ngeom + 1 < self.scene.maxgeom, "more to draw than there is room for"
        geom = self.scene.geoms[self.scene.ngeom]
        mujoco.mjv_initGeom(geom, kind, size, at, _UPRIGHT, np.array(rgba, dtype=np.float32))
        self.scene.ngeom += 1
        return geom

    def _follow(self, look_at: Array) -> None:
        """Moves the tiles, by whole periods of their pattern, and the light's depth map to the camera's point."""
        video_scene = self.video_scene
        period = 2 * video_scene.tile
        for tiles in video_scene.tiles:
            geom = next(g for g in self.scene.geoms[: self.scene.ngeom] if g.objtype == _GEOM and g.objid == tiles)
            geom.pos[:2] = self._data.geom_xpos[tiles, :2] + period * np.round(look_at[:2] / period)
        if video_scene.quality.shadow_map:
            light = self.scene.lights[self.scene.nlight - 1]
            direction = np.array(LIGHT_DIR) / np.linalg.norm(LIGHT_DIR)
            light.pos[:] = look_at - _LIGHT_DISTANCE * direction

    def _cast_shadow(self) -> None:
        """Appends the robot's geoms again, flattened onto the ground: much faster than a shadow map."""
        if self.video_scene.quality.shadow_map:
            return
        if self._shadows is None:
            geoms, end, casts_shadow = self.scene.geoms, self.scene.ngeom, self.video_scene.casts_shadow
            casting = [geom for geom in geoms[:end] if geom.objtype == _GEOM and casts_shadow[geom.objid]]
            self._shadows = [(geom, geoms[end + k]) for k, geom in enumerate(casting)]
            for geom, shadow in self._shadows:
                start_shadow(geom, shadow)
        for geom, shadow in self._shadows:
            flatten(geom, shadow)
        self.scene.ngeom += len(self._shadows)


def start_shadow(geom: mujoco.MjvGeom, shadow: mujoco.MjvGeom) -> None:
    """Gives `shadow` the geom's shape and the colour of ambient light."""
    color = np.array(_SHADOW_RGBA, dtype=np.float32)
    mujoco.mjv_initGeom(shadow, geom.type, np.ones(3), _ZERO, _UPRIGHT, color)
    shadow.size[:], shadow.dataid = geom.size, geom.dataid
    shadow.emission, shadow.specular, shadow.shininess = 0.6, 0.0, 0.0


def flatten(geom: mujoco.MjvGeom, shadow: mujoco.MjvGeom) -> None:
    """Poses `shadow` on the ground, along the light from the geom."""
    shadow.pos[:] = _FLATTEN @ geom.pos + _SHADOW_HEIGHT
    shadow.mat[:] = _FLATTEN @ geom.mat
