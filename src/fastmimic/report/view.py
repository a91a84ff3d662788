"""One panel of a video: the stage seen by a camera, with a shadow under the robot."""

from typing import Final

import mujoco
import numpy as np
from numpy.typing import NDArray

from fastmimic.report.scene import GHOST_GROUP, LIGHT_DIR, Stage

Array = NDArray[np.float64]

_ELEVATION_DEG: Final = -19.0
"""Steep enough that the ground fills the picture: a sky costs time and shows nothing."""
_SHADOW_RGBA: Final = (0.30, 0.33, 0.37, 1.0)
_EVERYTHING: Final = mujoco.mjtCatBit.mjCAT_ALL.value
_FLATTEN: Final = np.array(
    [
        [1.0, 0.0, -LIGHT_DIR[0] / LIGHT_DIR[2]],
        [0.0, 1.0, -LIGHT_DIR[1] / LIGHT_DIR[2]],
        [0.0, 0.0, 1e-3],  # not quite flat: a singular matrix has no normals
    ]
)
"""Projects along the light onto the ground."""
_ABOVE_GROUND: Final = np.array([0.0, 0.0, 0.002])


class View:
    """Poses the robots of a stage and collects what there is to draw.

    Args:
        stage: the model to pose.
        azimuth_deg: the camera's direction of sight, from the world's x axis.
        distance: from the camera to the point at which it looks, m.
    """

    def __init__(self, stage: Stage, azimuth_deg: float, distance: float) -> None:
        self._stage = stage
        self._data = mujoco.MjData(stage.model)
        self.scene = mujoco.MjvScene(stage.model, maxgeom=2 * stage.model.ngeom)
        for flag in (mujoco.mjtRndFlag.mjRND_SHADOW, mujoco.mjtRndFlag.mjRND_REFLECTION):
            self.scene.flags[flag] = 0
        self.scene.flags[mujoco.mjtRndFlag.mjRND_FOG] = 1
        self._option = mujoco.MjvOption()
        self._camera = mujoco.MjvCamera()
        self._camera.azimuth, self._camera.elevation = azimuth_deg, _ELEVATION_DEG
        self._camera.distance = distance
        self._shadows: list[tuple[mujoco.MjvGeom, mujoco.MjvGeom]] = []

    def update(self, robot: Array, ghost: Array | None, look_at: Array) -> None:
        """Poses the robot and the ghost, (19,) each, and points the camera at `look_at` (3,), world.

        A view shows the ghost always or never: that is settled by the first call.
        """
        model, data, stage = self._stage.model, self._data, self._stage
        data.qpos[stage.robot_qpos] = robot
        if stage.ghost_qpos is not None and ghost is not None:
            data.qpos[stage.ghost_qpos] = ghost
        self._option.geomgroup[GHOST_GROUP] = ghost is not None
        mujoco.mj_kinematics(model, data)
        mujoco.mj_camlight(model, data)
        self._camera.lookat[:] = look_at
        mujoco.mjv_updateScene(model, data, self._option, None, self._camera, _EVERYTHING, self.scene)
        self._cast_shadow()

    def _cast_shadow(self) -> None:
        """Appends the robot's geoms again, flattened onto the ground: far quicker than a shadow map."""
        if not self._shadows:
            self._shadows = _new_shadows(self.scene, self._stage.casts_shadow)
        for geom, shadow in self._shadows:
            shadow.pos[:] = _FLATTEN @ geom.pos + _ABOVE_GROUND
            shadow.mat[:] = _FLATTEN @ geom.mat
        self.scene.ngeom += len(self._shadows)


def _new_shadows(
    scene: mujoco.MjvScene, casts_shadow: NDArray[np.bool_]
) -> list[tuple[mujoco.MjvGeom, mujoco.MjvGeom]]:
    """The geoms that cast a shadow, each with the slot behind the scene's own geoms that shows it."""
    pairs: list[tuple[mujoco.MjvGeom, mujoco.MjvGeom]] = []
    for i in range(scene.ngeom):
        geom = scene.geoms[i]
        if geom.objtype != mujoco.mjtObj.mjOBJ_GEOM or not casts_shadow[geom.objid]:
            continue
        shadow = scene.geoms[scene.ngeom + len(pairs)]
        color = np.array(_SHADOW_RGBA, dtype=np.float32)
        mujoco.mjv_initGeom(shadow, geom.type, np.ones(3), np.zeros(3), np.eye(3).ravel(), color)
        shadow.size[:], shadow.dataid = geom.size, geom.dataid
        shadow.emission, shadow.specular, shadow.shininess = 0.6, 0.0, 0.0
        pairs.append((geom, shadow))
    return pairs
