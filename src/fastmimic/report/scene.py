"""The stage of a video: the robot, its ghost, ground, light, shadow and camera."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from fastmimic.errors import RobotError
from fastmimic.report.style import DEMONSTRATION

if TYPE_CHECKING:
    import mujoco

    from fastmimic.robot import Robot

Array = NDArray[np.float64]

_ROBOT: Final = "robot/"
_GHOST: Final = "ghost/"
_GHOST_GROUP: Final = 4
_HIDDEN_GROUP: Final = 5
_SHADOW_RGBA: Final = (0.30, 0.33, 0.37, 1.0)
_LIGHT_DIR: Final = (0.30, 0.40, -1.0)
_FOVY_DEG: Final = 32.0


def ghost_rgba(alpha: float = 0.42) -> tuple[float, float, float, float]:
    """The demonstration's colour, as in the figures, translucent."""
    r, g, b = (int(DEMONSTRATION.color[i : i + 2], 16) / 255 for i in (1, 3, 5))
    return r, g, b, alpha


@dataclass(frozen=True, eq=False)
class Stage:
    """A model with the robot and, if wanted, its ghost, and where their coordinates are in `qpos`.

    Attributes:
        model: the compiled model.
        robot_qpos: (19,) indices of the robot's root position, quaternion and joints in the common order.
        ghost_qpos: the same of the ghost; None without one.
    """

    model: "mujoco.MjModel"
    robot_qpos: NDArray[np.int64]
    ghost_qpos: NDArray[np.int64] | None


def build_stage(robot: "Robot", *, ghost: bool, width: int, height: int, floor: Array) -> Stage:
    """Puts a robot, and a ghost of it, on a checkered ground.

    Args:
        robot: the robot to show.
        ghost: whether a second, translucent robot is wanted.
        width: of the whole picture, pixels.
        height: of the whole picture, pixels.
        floor: (2, 2) lowest and highest x and y that the robots reach, m.

    Raises:
        RobotError: the robot's MJCF needs files that are not part of it.
    """
    import mujoco

    spec = mujoco.MjSpec()
    _set_visual(spec, width, height)
    _add_ground(spec, floor)
    for prefix in (_ROBOT, _GHOST)[: 1 + ghost]:
        spec.attach(_bare_robot(robot, ghost=prefix == _GHOST), prefix=prefix, frame=spec.worldbody.add_frame())
    try:
        model = spec.compile()
    except ValueError as error:
        raise RobotError(f"{robot.name}: the model cannot be drawn ({' '.join(str(error).split())})") from None
    return Stage(
        model,
        _qpos_indices(model, robot, _ROBOT),
        _qpos_indices(model, robot, _GHOST) if ghost else None,
    )


def _set_visual(spec: "mujoco.MjSpec", width: int, height: int) -> None:
    """Settings that keep software rendering fast: no multisampling, no shadow map, few facets."""
    visual = spec.visual
    visual.global_.offwidth, visual.global_.offheight = width, height
    visual.global_.fovy = _FOVY_DEG
    visual.quality.offsamples = 0
    visual.quality.shadowsize = 0
    visual.quality.numslices, visual.quality.numstacks, visual.quality.numquads = 24, 14, 2
    visual.headlight.ambient = [0.42, 0.42, 0.42]
    visual.headlight.diffuse = [0.28, 0.28, 0.28]
    visual.headlight.specular = [0.1, 0.1, 0.1]
    visual.rgba.fog = [0.93, 0.95, 0.97, 1]
    visual.map.fogstart, visual.map.fogend = 4.0, 12.0
    visual.map.znear, visual.map.zfar = 0.02, 60.0
    spec.stat.extent = 1.0
    spec.stat.center = [0, 0, 0.2]


def _add_ground(spec: "mujoco.MjSpec", floor: Array) -> None:
    import mujoco

    spec.add_texture(
        name="checker",
        type=mujoco.mjtTexture.mjTEXTURE_2D,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_CHECKER,
        mark=mujoco.mjtMark.mjMARK_EDGE,
        rgb1=[0.80, 0.82, 0.84],
        rgb2=[0.70, 0.73, 0.76],
        markrgb=[0.90, 0.91, 0.92],
        width=512,
        height=512,
    )
    material = spec.add_material(
        name="ground", texrepeat=[1, 1], texuniform=True, specular=0.0, shininess=0.0, reflectance=0.0
    )
    material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = "checker"
    half = float(np.max(floor[1] - floor[0])) / 2 + 14.0  # the fog hides the edge
    spec.worldbody.add_geom(
        name="ground",
        type=mujoco.mjtGeom.mjGEOM_PLANE,
        pos=[*np.round(floor.mean(axis=0)), 0],
        size=[half, half, half],  # the third is the grid's spacing: one quad is enough without spotlights
        material="ground",
    )
    spec.worldbody.add_light(
        type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL,
        dir=_LIGHT_DIR,
        diffuse=[0.55, 0.55, 0.55],
        specular=[0.2, 0.2, 0.2],
        castshadow=False,
    )


def _bare_robot(robot: "Robot", *, ghost: bool) -> "mujoco.MjSpec":
    """The robot's model without a floor, lights or cameras of its own."""
    import mujoco

    try:
        spec = mujoco.MjSpec.from_string(robot.xml)
    except ValueError as error:
        raise RobotError(f"{robot.name}: the model cannot be drawn ({' '.join(str(error).split())})") from None
    for element in (*spec.worldbody.geoms, *spec.lights, *spec.cameras, *spec.keys):
        spec.delete(element)
    if ghost:
        for geom in spec.geoms:
            geom.group = _GHOST_GROUP if geom.group <= 2 else _HIDDEN_GROUP
            geom.material = ""
            geom.rgba = ghost_rgba()
    return spec


def _qpos_indices(model: "mujoco.MjModel", robot: "Robot", prefix: str) -> NDArray[np.int64]:
    import mujoco

    joints = [model.joint(prefix + name).id for name in robot.joint_names]
    free = np.flatnonzero(model.jnt_type == mujoco.mjtJoint.mjJNT_FREE)
    root = model.jnt_qposadr[free[0 if prefix == _ROBOT else 1]]
    return np.concatenate([np.arange(root, root + 7), model.jnt_qposadr[joints]]).astype(np.int64)


class View:
    """One panel: a scene of the stage with its own camera. Draws a shadow on the ground for the robot."""

    def __init__(self, stage: Stage, azimuth_deg: float, distance: float) -> None:
        import mujoco

        self._stage = stage
        self._data = mujoco.MjData(stage.model)
        self.scene = mujoco.MjvScene(stage.model, maxgeom=4 * stage.model.ngeom + 200)
        for flag in (mujoco.mjtRndFlag.mjRND_SHADOW, mujoco.mjtRndFlag.mjRND_REFLECTION):
            self.scene.flags[flag] = 0
        self.scene.flags[mujoco.mjtRndFlag.mjRND_FOG] = 1
        self._option = mujoco.MjvOption()
        self._camera = mujoco.MjvCamera()
        self._camera.azimuth, self._camera.elevation, self._camera.distance = azimuth_deg, -14.0, distance

    def update(self, robot: Array, ghost: Array | None, look_at: Array) -> None:
        """Poses the robot and the ghost, (19,) each, and points the camera at `look_at` (3,), world."""
        import mujoco

        model, data, stage = self._stage.model, self._data, self._stage
        data.qpos[stage.robot_qpos] = robot
        if stage.ghost_qpos is not None and ghost is not None:
            data.qpos[stage.ghost_qpos] = ghost
        self._option.geomgroup[_GHOST_GROUP] = ghost is not None
        mujoco.mj_kinematics(model, data)
        mujoco.mj_camlight(model, data)
        self._camera.lookat[:] = look_at
        everything = mujoco.mjtCatBit.mjCAT_ALL.value
        mujoco.mjv_updateScene(model, data, self._option, None, self._camera, everything, self.scene)
        _add_shadow(self.scene)


_FLATTEN: Final = np.array(
    [
        [1.0, 0.0, -_LIGHT_DIR[0] / _LIGHT_DIR[2]],
        [0.0, 1.0, -_LIGHT_DIR[1] / _LIGHT_DIR[2]],
        [0.0, 0.0, 1e-3],  # not quite flat: a singular matrix has no normals
    ]
)


def _add_shadow(scene: "mujoco.MjvScene") -> None:
    """Adds the projection of each opaque geom onto the ground: a shadow map would take most of the time."""
    import mujoco

    for i in range(scene.ngeom):
        geom = scene.geoms[i]
        if geom.type == mujoco.mjtGeom.mjGEOM_PLANE or geom.rgba[3] < 1 or scene.ngeom >= scene.maxgeom:
            continue
        shadow = scene.geoms[scene.ngeom]
        mujoco.mjv_initGeom(
            shadow,
            geom.type,
            np.asarray(geom.size, dtype=np.float64),
            _FLATTEN @ geom.pos + (0, 0, 0.002),
            (_FLATTEN @ geom.mat).ravel(),
            np.array(_SHADOW_RGBA, dtype=np.float32),
        )
        shadow.dataid = geom.dataid
        shadow.emission, shadow.specular, shadow.shininess = 0.6, 0.0, 0.0
        scene.ngeom += 1
