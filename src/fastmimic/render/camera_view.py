"""One panel of a video: the scene seen by a camera, with a shadow under the robot."""

from typing import Final

import mujoco
import numpy as np

from fastmimic.base.arrays import Array
from fastmimic.render.video_scene import GHOST_GROUP, LIGHT_DIR, VideoScene

Rgba = tuple[float, float, float, float]

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
_LIGHT_DISTANCE: Final = 3.0  # m, from the point that the camera looks at
_ZERO: Final = np.zeros(3)
_UPRIGHT: Final = np.eye(3).ravel()
_MAX_MARKS: Final = 400  # bones, trails and contacts drawn at once, with their shadows


class CameraView:
    """Poses the robots of a video scene and collects what to draw. The camera looks along `azimuth_deg`, from the
    world's x axis, at a point in `distance`, m."""

    def __init__(self, video_scene: VideoScene, azimuth_deg: float, distance: float) -> None:
        self._video_scene = video_scene
        self._data = mujoco.MjData(video_scene.model)
        self.scene = mujoco.MjvScene(video_scene.model, maxgeom=2 * video_scene.model.ngeom + _MAX_MARKS)
        self.scene.flags[mujoco.mjtRndFlag.mjRND_SHADOW] = video_scene.quality.shadow_map > 0
        self.scene.flags[mujoco.mjtRndFlag.mjRND_REFLECTION] = video_scene.quality.reflectance > 0
        self.scene.flags[mujoco.mjtRndFlag.mjRND_FOG] = 1
        self._option = mujoco.MjvOption()
        self._camera = mujoco.MjvCamera()
        self._camera.azimuth, self._camera.elevation = azimuth_deg, _ELEVATION_DEG
        self._camera.distance = distance
        self._shadows: list[tuple[mujoco.MjvGeom, mujoco.MjvGeom]] | None = None

    def update(self, robot: Array | None, ghost: Array | None, look_at: Array) -> None:
        """Poses the robot and the ghost, (19,) each, and points the camera at `look_at` (3,), world.

        The first call settles whether robot and ghost are shown.
        """
        model, data, video_scene = self._video_scene.model, self._data, self._video_scene
        if robot is not None:
            data.qpos[video_scene.robot_qpos] = robot
        if video_scene.ghost_qpos is not None and ghost is not None:
            data.qpos[video_scene.ghost_qpos] = ghost
        self._option.geomgroup[GHOST_GROUP] = ghost is not None
        mujoco.mj_kinematics(model, data)
        mujoco.mj_camlight(model, data)
        self._camera.lookat[:] = look_at
        shown = _GROUND_ONLY if robot is None else _EVERYTHING
        mujoco.mjv_updateScene(model, data, self._option, None, self._camera, shown, self.scene)
        self._follow(look_at)
        self._cast_shadow()

    def line(self, start: Array, end: Array, rgba: Rgba, width: float) -> None:
        """Adds a line between two points (3,), world; `width` in pixels."""
        geom = self._add(mujoco.mjtGeom.mjGEOM_LINE, _ZERO, _ZERO, rgba)
        mujoco.mjv_connector(geom, mujoco.mjtGeom.mjGEOM_LINE, width, start, end)
        geom.emission, geom.specular = 0.6, 0.0

    def disc(self, centre: Array, rgba: Rgba) -> None:
        """Adds the mark of a loaded foot on the ground under `centre` (3,), world."""
        at = np.array([centre[0], centre[1], _MARK_HEIGHT])
        size = np.array([_MARK_RADIUS, 0.001, 0.0])
        geom = self._add(mujoco.mjtGeom.mjGEOM_CYLINDER, size, at, rgba)
        geom.emission, geom.specular = 0.2, 0.0

    def capsule(self, start: Array, end: Array, radius: float, rgba: Rgba) -> None:
        """Adds a capsule between two points (3,), world, with its shadow."""
        geom = self._add(mujoco.mjtGeom.mjGEOM_CAPSULE, _ZERO, _ZERO, rgba)
        mujoco.mjv_connector(geom, mujoco.mjtGeom.mjGEOM_CAPSULE, radius, start, end)
        geom.category = mujoco.mjtCatBit.mjCAT_DYNAMIC  # decoration has no shadow in the depth map
        if not self._video_scene.quality.shadow_map:
            shadow = self.scene.geoms[self.scene.ngeom]
            _start_shadow(geom, shadow)
            _flatten(geom, shadow)
            self.scene.ngeom += 1

    def _add(self, kind: mujoco.mjtGeom, size: Array, at: Array, rgba: Rgba) -> mujoco.MjvGeom:
        assert self.scene.ngeom + 1 < self.scene.maxgeom, "more to draw than there is room for"
        geom = self.scene.geoms[self.scene.ngeom]
        mujoco.mjv_initGeom(geom, kind, size, at, _UPRIGHT, np.array(rgba, dtype=np.float32))
        self.scene.ngeom += 1
        return geom

    def _follow(self, look_at: Array) -> None:
        """Moves the tiles, by whole periods of their pattern, and the light's depth map to the camera's point."""
        video_scene = self._video_scene
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
        if self._video_scene.quality.shadow_map:
            return
        if self._shadows is None:
            geoms, end, casts_shadow = self.scene.geoms, self.scene.ngeom, self._video_scene.casts_shadow
            casting = [geom for geom in geoms[:end] if geom.objtype == _GEOM and casts_shadow[geom.objid]]
            self._shadows = [(geom, geoms[end + k]) for k, geom in enumerate(casting)]
            for geom, shadow in self._shadows:
                _start_shadow(geom, shadow)
        for geom, shadow in self._shadows:
            _flatten(geom, shadow)
        self.scene.ngeom += len(self._shadows)


def _start_shadow(geom: mujoco.MjvGeom, shadow: mujoco.MjvGeom) -> None:
    """Gives `shadow` the geom's shape and the colour of ambient light."""
    color = np.array(_SHADOW_RGBA, dtype=np.float32)
    mujoco.mjv_initGeom(shadow, geom.type, np.ones(3), _ZERO, _UPRIGHT, color)
    shadow.size[:], shadow.dataid = geom.size, geom.dataid
    shadow.emission, shadow.specular, shadow.shininess = 0.6, 0.0, 0.0


def _flatten(geom: mujoco.MjvGeom, shadow: mujoco.MjvGeom) -> None:
    shadow.pos[:] = _FLATTEN @ geom.pos + _SHADOW_HEIGHT
    shadow.mat[:] = _FLATTEN @ geom.mat
