"""Terrains, as legged_gym and mjlab have them, each an entry of a registry. To add one, register one entry:

    TERRAINS.register(TerrainKind("bumps", unit="m", lower=0.0, upper=0.1, about="…", make=make_bumps))

A terrain is a plane, boxes with exact edges, or a height field, under real gravity. Episodes begin on it at different
places and lead along the world's x axis, on irregular ground in any direction.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, Final, NamedTuple, TypeAlias

import numpy as np

from fastmimic.base.arrays import Array, Records
from fastmimic.base.errors import ConfigError
from fastmimic.base.files import UNREADABLE, open_arrays, packaged
from fastmimic.base.registry import Registry
from fastmimic.base.rotations import quat_conjugate, quat_multiply, quat_rotate, quat_rotate_inverse
from fastmimic.simulation.disturbance_kinds import DisturbanceKind
from fastmimic.simulation.simulators import SIMULATORS

FOOTPRINT_M: Final = 0.25  # half the edge of the ground that counts as under a robot
TREAD_M: Final = 0.3
REACH_M: Final = 20.0  # to which stairs go in each direction: more than 10 s at 1.5 m/s
STONE_M: Final = 0.4  # edge of a stepping stone
HOLE_M: Final = 0.2  # depth below the plane through the ground; a foot does not begin in a hole
CELL_M: Final = 0.15
FIELD_M: Final = 60.0  # edge of a height field; a robot that leaves it falls
WAVE_M: Final = 1.0
FILE_CELL_M: Final = 0.05
FILES: Final = (".png", ".npy")
MOST_POINTS: Final = 4_000_000  # of a file: a field of 100 m by 100 m
MOST_HEIGHT_M: Final = 1e3  # of a file
_ACROSS: Final = np.linspace(-FOOTPRINT_M, FOOTPRINT_M, 5)
_UNDER: Final = np.stack(np.meshgrid(_ACROSS, _ACROSS), axis=-1).reshape(-1, 2)  # points under a robot


class GroundPlane(NamedTuple):
    """Planes through the ground: heights (…) under robots, m, and the smallest rotations (…, 4) of z to the normal."""

    height: Array
    quat: Array

    @classmethod
    def of(cls, height: Array, gradient: Array) -> "GroundPlane":
        """From heights (…) and gradients (…, 2)."""
        x, y = gradient[..., 0], gradient[..., 1]
        quat = np.stack([1.0 + np.sqrt(1.0 + x * x + y * y), y, -x, np.zeros_like(x)], axis=-1)
        return cls(height, quat / np.linalg.norm(quat, axis=-1, keepdims=True))

    @property
    def normal(self) -> Array:
        """(…, 3) unit vectors, upwards."""
        return quat_rotate(self.quat, np.array([0.0, 0.0, 1.0]))

    def laid(self, position: Array, quat: Array) -> tuple[Array, Array]:
        """Positions (…, 3) and orientations (…, 4) above level ground, with their x and y, above this one."""
        above = position.copy()
        above[..., 2] = self.height + position[..., 2] / self.normal[..., 2]
        return above, quat_multiply(self.quat, quat)

    def seen(self, observation: Records) -> Records:
        """States (…) of `OBSERVATION` as from the ground: height along the normal, orientation and velocities in the
        plane's frame; x, y and forces are left."""
        out = observation.copy()
        out["root_pos"][..., 2] = (out["root_pos"][..., 2] - self.height) * self.normal[..., 2]
        out["root_quat"] = quat_multiply(quat_conjugate(self.quat), out["root_quat"])
        for name in ("lin_vel", "ang_vel"):
            out[name] = quat_rotate_inverse(self.quat, out[name])
        return out


@dataclass(frozen=True, eq=False)
class HeightField:
    """Heights (rows along y, columns along x) in m at points `cell` m apart, about the origin. The ground between them
    consists of triangles, as in MuJoCo."""

    heights: Array
    cell: float

    @property
    def half(self) -> Array:
        """Half of its edges along x and y, m."""
        return self.cell * (np.array(self.heights.shape)[::-1] - 1) / 2

    def height(self, x: Array, y: Array) -> Array:
        """Heights (…) at (…), m; beyond an edge those at it, and any where a lost robot is at NaN."""
        rows, columns = self.heights.shape
        column = np.clip((np.nan_to_num(x) + self.half[0]) / self.cell, 0.0, columns - 1.0)
        row = np.clip((np.nan_to_num(y) + self.half[1]) / self.cell, 0.0, rows - 1.0)
        j, i = np.minimum(column.astype(int), columns - 2), np.minimum(row.astype(int), rows - 2)
        u, v, low, high = column - j, row - i, self.heights[i, j], self.heights[i + 1, j + 1]
        beside = np.where(u >= v, self.heights[i, j + 1], self.heights[i + 1, j])  # the triangle's third corner
        return low + np.maximum(u, v) * (beside - low) + np.minimum(u, v) * (high - beside)


@dataclass(frozen=True, eq=False)
class Terrain:
    """The ground of episodes, world frame."""

    gradient: tuple[float, float] = (0.0, 0.0)  # of the plane through the origin that it is, or that its boxes follow
    boxes: Array = field(default_factory=lambda: np.zeros((0, 6)))  # centres and half edges, along the axes, m
    field: HeightField | None = None  # of irregular ground
    spread: tuple[float, float, float] = (0.0, 0.0, 0.0)  # greatest x and y, m, and heading, rad, where episodes begin

    def height(self, x: Array, y: Array) -> Array:
        """Heights (…) of the ground at (…), m; beside all boxes that of the lowest underside."""
        if self.field is not None:
            return self.field.height(x, y)
        if not len(self.boxes):
            return self.gradient[0] * x + self.gradient[1] * y
        at, half = self.boxes[:, :3], self.boxes[:, 3:]
        inside = (np.abs(x[..., None] - at[:, 0]) <= half[:, 0]) & (np.abs(y[..., None] - at[:, 1]) <= half[:, 1])
        tops = np.where(inside, at[:, 2] + half[:, 2], (at[:, 2] - half[:, 2]).min())
        return np.asarray(tops.max(axis=-1), dtype=np.float64)

    def plane(self, x: Array, y: Array) -> GroundPlane:
        """The plane through the ground under robots at (…), m: of a field, that nearest to their footprint."""
        if self.field is None:
            gradient = np.broadcast_to(self.gradient, (*np.shape(x), 2))
            return GroundPlane.of(gradient[..., 0] * x + gradient[..., 1] * y, gradient)
        under = self.field.height(x[..., None] + _UNDER[:, 0], y[..., None] + _UNDER[:, 1])
        return GroundPlane.of(under.mean(axis=-1), under @ _UNDER / np.sum(_ACROSS**2) / len(_ACROSS))

    def seen(self, observation: Records) -> Records:
        """States (n,) of `OBSERVATION` as from the ground under each robot."""
        return self.plane(observation["root_pos"][:, 0], observation["root_pos"][:, 1]).seen(observation)

    def support(self, x: Array, y: Array, radius: float) -> Array:
        """Heights (…) on which feet of a radius, m, stand at (…), m: on an edge if it is that near."""
        around = radius * np.array([[0.0, 0.0], [1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])
        return np.asarray(self.height(x[..., None] + around[:, 0], y[..., None] + around[:, 1]).max(axis=-1))

    def plane_through(self, root: Array, feet: Array, radius: float) -> GroundPlane:
        """The planes nearest to the ground, but for holes, under feet (n, 4, ≥2) of robots at (n, ≥2), world, m."""
        away = feet[..., :2] - root[:, None, :2]
        ground, mean = self.support(feet[..., 0], feet[..., 1], radius), self.plane(feet[..., 0], feet[..., 1]).height
        ground = np.where(ground < mean - HOLE_M, mean, ground)
        fit = np.linalg.pinv(np.concatenate([np.ones_like(away[..., :1]), away], axis=-1)) @ ground[..., None]
        return GroundPlane.of(fit[:, 0, 0], fit[:, 1:, 0])


Make: TypeAlias = Callable[[float, np.random.Generator], Terrain]


@dataclass(frozen=True)
class TerrainKind(DisturbanceKind):
    """A kind of terrain: its value is the level from which, with the ground's random numbers, `make` makes it."""

    per_robot: bool = False
    make: Make = lambda level, rng: Terrain()
    simulators: tuple[str, ...] = ("mujoco", "pybullet")
    given: str = ""  # the level if it is left out

    def realized_in(self, simulator: str) -> bool:
        return simulator in self.simulators or self.name in SIMULATORS[simulator].realizes


def terrain_kind(name: str) -> TerrainKind:
    """One of `TERRAINS`, or a height field, `FILE` or `FILE@CELL`: an `.npy` array of heights in m, or a `.png` from
    black at 0 to white at 1 m, with points CELL m apart. Its level is a factor. Raises `ConfigError`."""
    file, _, cell = name.partition("@")
    if not file.lower().endswith(FILES):
        return TERRAINS[name]
    try:
        apart = float(cell or FILE_CELL_M)
    except ValueError:
        apart = 0.0
    if not 1e-3 <= apart <= 100:
        raise ConfigError(f"terrain '{name}': the distance of points after @ must be 0.001 to 100, in m")
    make = partial(_from_file, Path(file), apart)
    return TerrainKind(name, "", -1e3, 1e3, "factor of the file's heights", make=make, given="1")


def _from_file(path: Path, cell: float, factor: float, _: np.random.Generator) -> Terrain:
    ground = HeightField(factor * _read_heights(path), cell)
    return Terrain(field=ground, spread=(ground.half[0] / 4, ground.half[1] / 4, np.pi))


def _read_heights(path: Path) -> Array:
    from PIL import Image

    is_array = path.suffix.lower() == ".npy"
    try:
        found: Any = np.asarray(open_arrays(path)) if is_array else Image.open(path)  # not in memory yet
        if (points := int(np.prod(found.size))) > MOST_POINTS:
            raise ValueError(f"it has {points} points, more than the {MOST_POINTS} of the largest ground")
        if is_array:
            heights = found.astype(np.float64)
        else:
            white = 65535 if found.mode.startswith("I") else 255
            heights = np.asarray(found.convert("F"), dtype=np.float64)[::-1] / white
    except FileNotFoundError:
        raise ConfigError(f"{path}: no such file") from None
    except (*UNREADABLE, Image.DecompressionBombError) as error:
        raise ConfigError(f"{path}: cannot be read as a height field: {error}") from None
    if heights.ndim != 2 or min(heights.shape) < 2:
        raise ConfigError(f"{path}: a height field has rows and columns of heights; found {heights.shape}")
    if not (highest := np.abs(heights).max()) <= MOST_HEIGHT_M:
        raise ConfigError(f"{path}: heights are in m and at most {MOST_HEIGHT_M:g}; found {highest:g}")
    return np.ascontiguousarray(heights)


def _plane(x: float, y: float, degrees: float, _: np.random.Generator) -> Terrain:
    slope = math.tan(math.radians(degrees))
    return Terrain((x * slope, y * slope))


def _stairs(sign: float, rise: float, _: np.random.Generator) -> Terrain:
    """Steps across the x axis; the plane through the middles of their treads goes through the origin."""
    steps, slope = round(REACH_M / TREAD_M), sign * rise / TREAD_M
    boxes = np.zeros((2 * steps, 6))
    boxes[:, 0] = (np.arange(-steps, steps) + 0.5) * TREAD_M
    boxes[:, 2] = slope * boxes[:, 0] - 0.5
    boxes[:, 3:] = TREAD_M / 2, REACH_M, 0.5
    return Terrain((slope, 0.0), boxes, spread=(TREAD_M / 2, 1.0, 0.0))


def _stones(gap: float, _: np.random.Generator) -> Terrain:
    """A path of stones from 3 m behind the origin to 18 m before it, 6 m wide, and the ground 0.3 m below."""
    pitch = STONE_M + gap
    x, y = np.meshgrid(np.arange(-3.0, 18.0, pitch), np.arange(-3.0, 3.0, pitch))
    boxes = np.zeros((x.size + 1, 6))
    boxes[1:, 0], boxes[1:, 1], boxes[1:, 2] = x.ravel(), y.ravel(), -0.25
    boxes[1:, 3:] = STONE_M / 2, STONE_M / 2, 0.25
    boxes[0] = 0.0, 0.0, -0.8, REACH_M, REACH_M, 0.5
    return Terrain(boxes=boxes, spread=(pitch / 2, pitch / 2, 0.0))


def _rough(height: float, rng: np.random.Generator) -> Terrain:
    points = round(FIELD_M / CELL_M) + 1
    heights = rng.uniform(-height, height, (points, points))
    return Terrain(field=HeightField(heights, CELL_M), spread=(5.0, 5.0, np.pi))


def _waves(amplitude: float, _: np.random.Generator) -> Terrain:
    cell = WAVE_M / 10
    along = amplitude / 2 * np.sin(2 * np.pi / WAVE_M * cell * np.arange(round(FIELD_M / cell) + 1))
    return Terrain(field=HeightField(along[:, None] + along, cell), spread=(5.0, 5.0, np.pi))


_MAKES: Final[dict[str, Make]] = {
    "stairs-up": partial(_stairs, 1.0),
    "stairs-down": partial(_stairs, -1.0),
    "slope": partial(_plane, 1.0, 0.0),
    "side-slope": partial(_plane, 0.0, 1.0),
    "rough": _rough,
    "waves": _waves,
    "stones": _stones,
}
_Said = dict[str, str | float | tuple[str | float, ...]]
_SAID: Final[Any] = packaged("fastmimic.simulation", "terrains.json", list[_Said])
TERRAINS: Final = Registry("terrain", [TerrainKind(**said, make=_MAKES[said["name"]]) for said in _SAID])
"""All terrains that have a level."""
