"""The ground of a video: checkered and flat, or a terrain."""

from typing import Final

import mujoco
import numpy as np
from numpy.typing import NDArray

from fastmimic.base.arrays import Array
from fastmimic.render.encoding import Quality
from fastmimic.simulation.mujoco_sim import floor_shapes
from fastmimic.simulation.terrain import Terrain

_CHECKER: Final = "checker"
TILES: Final = ("light tiles", "dark tiles")
TILE_M: Final = 0.5  # edge of a ground tile
_TILED_M: Final = 8.0  # reach of the tiles; the fog hides the rest
_OVERLAP: Final = 0.05  # m
_GROUND_M: Final = 22.0  # reach of the ground; the fog hides its edge
_LIGHT_TILE: Final = (0.80, 0.82, 0.84)
_DARK_TILE: Final = (0.70, 0.73, 0.76)
HAZE: Final = (0.93, 0.95, 0.97)


def add_ground(spec: mujoco.MjSpec, floor: Array, quality: Quality, tile: float) -> None:
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
        _add_checker(spec, tile, quality.reflectance)
        return
    for parity, (name, rgb) in enumerate(zip(TILES, (_LIGHT_TILE, _DARK_TILE), strict=True)):
        vertices, faces = _checkered(tile, _TILED_M, parity)
        if parity == 0:
            vertices, faces = _framed(vertices, faces)
        spec.add_mesh(
            name=name,
            uservert=vertices.ravel(),
            userface=faces.ravel(),
            inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL,
        )
        spec.worldbody.add_geom(
            name=name,
            type=mujoco.mjtGeom.mjGEOM_MESH,
            meshname=name,
            rgba=[*rgb, 1],
            contype=0,
            conaffinity=0,
        )


def add_terrain(spec: mujoco.MjSpec, terrain: Terrain, tile: float) -> None:
    """The simulation's ground, checkered, or steps and stones of two colours by turns; and a sky, as the ground may not
    fill the picture."""
    sky, plain = mujoco.mjtTexture.mjTEXTURE_SKYBOX, mujoco.mjtBuiltin.mjBUILTIN_FLAT
    spec.add_texture(name="sky", type=sky, builtin=plain, rgb1=HAZE, rgb2=HAZE, width=8, height=48)
    _add_checker(spec, tile, 0.0)
    for k, shape in enumerate(floor_shapes(spec, terrain).values()):
        color = (_LIGHT_TILE, _DARK_TILE)[k % 2]
        look = {"rgba": [*color, 1]} if len(terrain.boxes) else {"material": _CHECKER}
        spec.worldbody.add_geom(**shape, **look)


def _add_checker(spec: mujoco.MjSpec, tile: float, reflectance: float) -> None:
    spec.add_texture(
        name=_CHECKER,
        type=mujoco.mjtTexture.mjTEXTURE_2D,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_CHECKER,
        mark=mujoco.mjtMark.mjMARK_EDGE,
        rgb1=_LIGHT_TILE,
        rgb2=_DARK_TILE,
        markrgb=[0.90, 0.91, 0.92],
        width=512,
        height=512,
    )
    material = spec.add_material(
        name=_CHECKER,
        texrepeat=[1 / tile, 1 / tile],  # a plane's texture spans two units of length, and two tiles
        texuniform=True,
        specular=0.0,
        shininess=0.0,
        reflectance=reflectance,
    )
    material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = _CHECKER


def _checkered(tile: float, reach: float, parity: int) -> tuple[Array, NDArray[np.int32]]:
    """Every other tile of a square of ± `reach` m: vertices (k, 4, 3) and triangles (k, 2, 3), facing up."""
    n = 2 * int(np.ceil(reach / (2 * tile)))
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
