"""The stage of a video: the robot, its ghost, the ground and the light."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from fastmimic.report.style import DEMONSTRATION

if TYPE_CHECKING:
    import mujoco

    from fastmimic.robot import Robot

Array = NDArray[np.float64]

_ROBOT: Final = "robot/"
_GHOST: Final = "ghost/"
GHOST_GROUP: Final = 4
_HIDDEN_GROUP: Final = 5
_GHOST_SHRINK: Final = 0.97
"""Of the sizes, so that surfaces do not flicker where the robot is exactly on its demonstration."""
LIGHT_DIR: Final = (0.30, 0.40, -1.0)
_FOVY_DEG: Final = 30.0


def ghost_rgba(alpha: float = 0.36) -> tuple[float, float, float, float]:
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
        casts_shadow: (ngeom,) which geoms have a shadow: the robot's main ones.
    """

    model: "mujoco.MjModel"
    robot_qpos: NDArray[np.int64]
    ghost_qpos: NDArray[np.int64] | None
    casts_shadow: NDArray[np.bool_]


def build_stage(robot: "Robot", *, ghost: bool, width: int, height: int, floor: Array) -> Stage:
    """Puts a robot, and a ghost of it, on a checkered ground.

    Args:
        robot: the robot to show.
        ghost: whether a second, translucent robot is wanted.
        width: of the whole picture, pixels.
        height: of the whole picture, pixels.
        floor: (2, 2) lowest and highest x and y that the robots reach, m.
    """
    import mujoco

    spec = mujoco.MjSpec()
    _set_visual(spec, width, height)
    _add_ground(spec, floor)
    for prefix in (_ROBOT, _GHOST)[: 1 + ghost]:
        spec.attach(_bare_robot(robot), prefix=prefix, frame=spec.worldbody.add_frame())
    model = spec.compile()
    robot_qpos, robot_geoms = _find(model, robot, _ROBOT)
    ghost_qpos = None
    if ghost:
        ghost_qpos, ghost_geoms = _find(model, robot, _GHOST)
        _make_ghost(model, ghost_geoms)
    return Stage(model, robot_qpos, ghost_qpos, _main_geoms(model, robot_geoms))


def _set_visual(spec: "mujoco.MjSpec", width: int, height: int) -> None:
    """Settings that keep software rendering fast: no multisampling, no shadow map, few facets."""
    visual = spec.visual
    visual.global_.offwidth, visual.global_.offheight = width, height
    visual.global_.fovy = _FOVY_DEG
    visual.quality.offsamples = 0
    visual.quality.shadowsize = 0
    visual.quality.numslices, visual.quality.numstacks, visual.quality.numquads = 18, 9, 1
    visual.headlight.ambient = [0.42, 0.42, 0.42]
    visual.headlight.diffuse = [0.28, 0.28, 0.28]
    visual.headlight.specular = [0.1, 0.1, 0.1]
    visual.rgba.fog = [0.93, 0.95, 0.97, 1]
    visual.map.fogstart, visual.map.fogend = 2.5, 11.0
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
        name="ground", texrepeat=[2, 2], texuniform=True, specular=0.0, shininess=0.0, reflectance=0.0
    )
    material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = "checker"
    half = float(np.max(floor[1] - floor[0])) / 2 + 22.0  # the fog hides the edge
    spec.worldbody.add_geom(
        name="ground",
        type=mujoco.mjtGeom.mjGEOM_PLANE,
        pos=[*np.round(floor.mean(axis=0)), 0],
        size=[half, half, half],  # the third is the grid's spacing: one quad is enough without spotlights
        material="ground",
    )
    spec.worldbody.add_light(
        type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL,
        dir=LIGHT_DIR,
        diffuse=[0.55, 0.55, 0.55],
        specular=[0.2, 0.2, 0.2],
        castshadow=False,
    )


def _bare_robot(robot: "Robot") -> "mujoco.MjSpec":
    """The robot's model without a floor, lights or cameras of its own."""
    spec = robot.spec()
    for element in (*spec.worldbody.geoms, *spec.lights, *spec.cameras, *spec.keys):
        spec.delete(element)
    spec.nkey = 0
    return spec


def _find(model: "mujoco.MjModel", robot: "Robot", prefix: str) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Indices in `qpos` (19,) and a mask of the geoms (ngeom,) of the copy of the robot with this prefix."""
    import mujoco

    joints = [model.joint(prefix + name).id for name in robot.joint_names]
    root = model.body_rootid[model.jnt_bodyid[joints[0]]]
    free = np.flatnonzero((model.jnt_type == mujoco.mjtJoint.mjJNT_FREE) & (model.jnt_bodyid == root))[0]
    first = int(model.jnt_qposadr[free])
    qpos = np.concatenate([np.arange(first, first + 7), model.jnt_qposadr[joints]]).astype(np.int64)
    return qpos, model.body_rootid[model.geom_bodyid] == root


def _main_geoms(model: "mujoco.MjModel", geoms: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Which of a robot's `geoms` its ghost and its shadow show.

    Those that collide, if they are meant to be seen: decoration only costs time. Otherwise all that are
    seen, as in models whose collision geometry is hidden behind meshes.
    """
    seen = geoms & (model.geom_group <= 2) & (model.geom_rgba[:, 3] > 0)
    solid = seen & ((model.geom_contype != 0) | (model.geom_conaffinity != 0))
    return solid if solid.any() else seen


def _make_ghost(model: "mujoco.MjModel", geoms: NDArray[np.bool_]) -> None:
    """Makes a robot's `geoms` translucent, in the demonstration's colour."""
    main = _main_geoms(model, geoms)
    model.geom_group[geoms] = np.where(main[geoms], GHOST_GROUP, _HIDDEN_GROUP)
    model.geom_matid[geoms] = -1
    model.geom_rgba[geoms] = ghost_rgba()
    model.geom_size[geoms] *= _GHOST_SHRINK
