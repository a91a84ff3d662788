"""viser's scene nodes. If the view follows a robot, its frame moves against its path, so that the camera can stay."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from fastmimic.base.arrays import Array
from fastmimic.base.conventions import LEGS
from fastmimic.base.files import packaged
from fastmimic.render.tracks import Animal
from fastmimic.render.video_scene import GHOST_RGBA, leg_rgba
from fastmimic.robot import Robot
from fastmimic.viewer import take as marks
from fastmimic.viewer.bodies import BodyMesh, Placed, Puppet, ground_surface
from fastmimic.viewer.take import TRAIL_POINTS, Take

if TYPE_CHECKING:
    import viser
    from trimesh import Trimesh

LAYERS: Final = packaged("fastmimic.viewer", "layers.json", dict[str, str])  # names and labels
_LOOKS: Final = packaged("fastmimic.viewer", "looks.json", dict[str, dict[str, Any]])  # of nodes, as viser names them
WIDE_GROUND: Final = (24.0, 24.0)
_CELL_M: Final = float(_LOOKS["ground"]["cell_size"])
_TERRAIN_RGB: Final = (205, 210, 215)
_FORCE_RGB: Final = (178, 24, 43)
_ASKED_RGB: Final = (20, 20, 20)
_PYRAMID_RGB: Final = (120, 94, 240)
_COM_RGB: Final = (210, 30, 140)
_GHOST_RGB: Final = np.array([round(255 * c) for c in GHOST_RGBA[:3]], dtype=np.uint8)
_ANIMAL_RGB: Final = (140, 84, 20)


def gap(robot: Robot) -> float:
    """Distance between robots side by side, m."""
    return 2.4 * robot.leg_length


def animal_aside(robot: Robot) -> float:
    """Place of the animal, m to the left of its robot's place."""
    return -0.7 * gap(robot)


def line_up(
    server: "viser.ViserServer", takes: Sequence[Take], animal: Animal | None = None, names: Sequence[str] | None = None
) -> "list[RobotScene]":
    """Robots side by side, seen from the front the first on the left, the animal beside it. `takes` are each one's
    first, of the same robot; `names` those of their frames in the scene tree."""
    n, between, puppet = len(takes), gap(takes[0].robot), Puppet(takes[0].robot)
    ground = WIDE_GROUND if n == 1 else (3.0, round(between / _CELL_M) * _CELL_M)
    names = names if names is not None else [f"robot{i}" for i in range(n)]
    return [
        RobotScene(server, f"/{name}", puppet, take, between * (i - 0.5 * (n - 1)), ground, animal if i == 0 else None)
        for i, (name, take) in enumerate(zip(names, takes, strict=True))
    ]


class RobotScene:
    """One robot with its marks, `aside` m to the left of the middle; `root` is its frame, called `name` in the scene
    tree, which holds everything else, in `layers` by name. `puppet` is its geometry, which may be shared; `take` its
    first; `ground` length and width of its ground, m; `animal` is shown to the right of it."""

    def __init__(
        self,
        server: "viser.ViserServer",
        name: str,
        puppet: Puppet,
        take: Take,
        aside: float = 0.0,
        ground: tuple[float, float] = WIDE_GROUND,
        animal: Animal | None = None,
    ) -> None:
        self._server, self._robot, self._puppet, self._animal = server, take.robot, puppet, animal
        self.aside = aside
        self.root = server.scene.add_frame(name, show_axes=False)
        self.layers = {
            layer: server.scene.add_frame(f"{name}/{layer}", show_axes=False)
            for layer in LAYERS
            if layer != "animal" or animal is not None
        }
        self._grid = server.scene.add_grid(f"{name}/ground", *ground, position=(0.0, 0.0, -0.001), **_LOOKS["ground"])
        if take.terrain is not None:
            self._grid.visible = False
            mesh, rgb = ground_surface(take.terrain), _TERRAIN_RGB
            server.scene.add_mesh_simple(f"{name}/terrain", mesh.vertices, mesh.faces, color=rgb, flat_shading=True)
        self._bodies = self._add_bodies(f"{name}/robot", puppet.bodies, None)
        self._ghost = self._add_bodies(f"{name}/ghost", puppet.ghost_bodies, GHOST_RGBA[3])
        self._contacts = {
            kind: self._add_marks(f"{name}/contacts/{kind}", mesh)
            for kind, mesh in marks.contact_meshes(2.0 * self._robot.foot_radius).items()
        }
        self._nodes = self._add_lines(name)
        self._names = [
            server.scene.add_label(f"{name}/names/{leg}", leg, font_screen_scale=0.8, anchor="top-center")
            for leg in LEGS
        ]
        self._title = server.scene.add_label(f"{name}/names/title", take.title, anchor="bottom-center")
        if animal is not None:
            points = np.zeros((10, 3))
            self._bones = self._lines(f"{name}/animal/bones", marks.bone_segments(points), _ANIMAL_RGB, 4.0)
            self._points = server.scene.add_point_cloud(
                f"{name}/animal/points", points, _ANIMAL_RGB, point_size=0.022, point_shape="circle"
            )
        self.set_take(take)

    def set_take(self, take: Take) -> None:
        self.take = take
        self._path = self._followed(take)
        self._title.text = take.title

    def _followed(self, take: Take) -> Array:
        """The path (t, 2) that the view follows, m."""
        return marks.smoothed_path(take)

    def set_layer(self, layer: str, visible: bool) -> None:
        """Shows or hides one of `layers`, those of `LAYERS` that this robot has."""
        self.layers[layer].visible = visible

    def set_opacity(self, opacity: float | None) -> None:
        """Sets the robot's opacity; None for opaque."""
        for _, meshes in self._bodies:
            for mesh in meshes:
                mesh.opacity = opacity

    def show(self, row: int, *, follow: bool) -> None:
        """Moves everything to a row of the take, or to its last one."""
        take = self.take
        row = take.clamp(row)
        reference = None if take.reference is None else take.reference[row]
        placed, ghost = self._puppet.place(take.pose[row], reference)
        shift = -self._path[row] if follow else np.zeros(2)
        height = float(take.ground(self._path[row])) if follow else 0.0
        self.root.position = (float(shift[0]), float(shift[1]) + self.aside, -height)
        x, y = np.round(self._path[row] / _CELL_M) * _CELL_M
        self._grid.position = (float(x), float(y), -0.001)
        _move(self._bodies, placed)
        if ghost is not None:
            _move(self._ghost, ghost)
        here = np.array([*self._path[row], 0.0])  # origin of the marks: slow browsers take frames at once, points late
        for layer, group in self.layers.items():
            if layer != "ghost":
                group.position = here
        self._show_lines(row, placed, ghost, here)
        places = marks.contact_places(take, row)
        for kind, flags in marks.contact_flags(take, row).items():
            self._contacts[kind].batched_positions = (places - here).astype(np.float32)
            self._contacts[kind].batched_scales = np.where(flags, 1.0, 1e-4).astype(np.float32)
        for place, label in zip(places, self._names, strict=True):
            label.position = place - here + np.array([0.0, 0.0, -0.02])
        self._title.position = take.pose[row, :3] - here + np.array([0.0, 0.0, 0.55 * self._robot.leg_length])
        if self._animal is not None:
            points = marks.animal_beside(self._animal, take, row, animal_aside(self._robot)) - here
            self._points.points = points.astype(np.float32)
            self._bones.points = marks.bone_segments(points).astype(np.float32)

    def _add_bodies(
        self, name: str, bodies: tuple[BodyMesh, ...], opacity: float | None
    ) -> list[tuple["viser.FrameHandle", list["viser.MeshHandle"]]]:
        """A frame with meshes for each body; translucent ones have no shadow."""
        scene, found = self._server.scene, []
        look: dict[str, Any] = {"opacity": opacity, "cast_shadow": opacity is None, "receive_shadow": False}
        for body in bodies:
            path = f"{name}/{body.name}"
            frame = scene.add_frame(path, show_axes=False)
            meshes = [
                scene.add_mesh_simple(f"{path}/{k}", mesh.vertices, mesh.faces, color=rgb, **look)
                for k, (mesh, rgb) in enumerate(body.parts)
            ]
            found.append((frame, meshes))
        return found

    def _add_marks(self, name: str, mesh: "Trimesh") -> "viser.BatchedMeshHandle":
        """A mark under each foot."""
        return self._server.scene.add_batched_meshes_simple(
            name,
            mesh.vertices,
            mesh.faces,
            batched_wxyzs=np.tile([1.0, 0.0, 0.0, 0.0], (4, 1)),
            batched_positions=np.zeros((4, 3)),
            batched_scales=np.ones(4),
            batched_colors=linear(leg_colours()),
            **_LOOKS["marks"],
        )

    def _add_lines(self, name: str) -> dict[str, Any]:
        scene, one = self._server.scene, np.zeros((1, 2, 3))
        trail = np.zeros((4 * TRAIL_POINTS, 2, 3))
        colours = np.repeat(linear(leg_colours()), 2 * TRAIL_POINTS, axis=0).reshape(-1, 2, 3)
        return {
            "force": self._arrows(f"{name}/forces/measured", _FORCE_RGB, 0.006),
            "asked": self._lines(f"{name}/forces/asked", one, _ASKED_RGB, 3.0),
            "pyramid": self._lines(f"{name}/forces/pyramids", one, _PYRAMID_RGB, 1.5),
            "path": self._lines(f"{name}/paths/robot", trail, colours, 2.5),
            "reference_path": self._lines(f"{name}/paths/demonstration", trail, _GHOST_RGB, 1.5),
            "com": scene.add_icosphere(f"{name}/com/robot", radius=0.018, color=_COM_RGB, cast_shadow=False),
            "reference_com": scene.add_box(
                f"{name}/com/demonstration", dimensions=(0.03, 0.03, 0.03), color=_GHOST_RGB, cast_shadow=False
            ),
            "com_drop": self._lines(f"{name}/com/drops", np.zeros((6, 2, 3)), _COM_RGB, 2.0),
        }

    def _arrows(self, name: str, rgb: tuple[int, int, int], shaft_radius: float) -> Any:
        """Arrows that are hidden until they have points."""
        return self._server.scene.add_arrows(
            name,
            np.array([[[0, 0, 0], [0, 0, 1e-3]]]),
            linear(np.array(rgb)),
            shaft_radius=shaft_radius,
            head_radius=2.5 * shaft_radius,
            head_length=5.0 * shaft_radius,
            visible=False,
        )

    def _lines(self, name: str, points: Array, colours: Any, pixels: float) -> "viser.LineSegmentsHandle":
        return self._server.scene.add_line_segments(name, points, colours, thickness=pixels, thickness_units="screen")

    def _show_lines(self, row: int, placed: Placed, ghost: Placed | None, here: Array) -> None:
        take, nodes = self.take, self._nodes
        _set_lines(nodes["force"], marks.force_arrows(take, row, take.force) - here)
        _set_lines(nodes["asked"], marks.force_arrows(take, row, take.asked) - here)
        _set_lines(nodes["pyramid"], marks.friction_pyramids(take, row) - here)
        _set_lines(nodes["path"], marks.trails(take.feet, row, take.rate_hz) - here)
        drops = [_drop(placed.com, float(take.ground(placed.com)), upright=True)]
        nodes["com"].position = placed.com - here
        if ghost is not None and take.reference_feet is not None:
            trail = marks.trails(take.reference_feet, row, take.rate_hz, dashed=True)
            _set_lines(nodes["reference_path"], trail - here)
            nodes["reference_com"].position = ghost.com - here
            drops.append(_drop(ghost.com, float(take.ground(ghost.com)), upright=False))
        nodes["com_drop"].points = (np.concatenate(drops) - here).astype(np.float32)
        for kind in ("reference_path", "reference_com"):
            nodes[kind].visible = ghost is not None
        for frame, _ in self._ghost:
            frame.visible = ghost is not None


def leg_colours() -> NDArray[np.uint8]:
    """The legs' colours in the figures, (4, 3), 0 to 255."""
    return np.round(255.0 * np.array([leg_rgba(leg, 1.0)[:3] for leg in range(4)])).astype(np.uint8)


def linear(rgb: NDArray[Any]) -> NDArray[np.uint8]:
    """sRGB colours as linear light, 0 to 255: for viser's instances, vertices and arrows; whole nodes take sRGB."""
    c = np.asarray(rgb) / 255.0
    return np.round(255.0 * np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4)).astype(np.uint8)


def _move(bodies: list[tuple["viser.FrameHandle", list["viser.MeshHandle"]]], placed: Placed) -> None:
    for (frame, _), position, wxyz in zip(bodies, placed.position, placed.wxyz, strict=True):
        frame.position, frame.wxyz = position, wxyz


def _set_lines(node: Any, points: Array) -> None:
    """Sets lines or arrows; a node without any is hidden, since viser cannot draw none."""
    if len(points):
        node.points = points.astype(np.float32)
    node.visible = len(points) > 0


def _drop(com: Array, ground: float, *, upright: bool) -> Array:
    """The centre of mass on the `ground`'s height: a line down to an upright or a diagonal cross (3, 2, 3)."""
    foot = np.array([com[0], com[1], ground + 0.003])
    arms = 0.04 * np.array([[1.0, 0, 0], [0, 1.0, 0]] if upright else [[0.7, 0.7, 0], [0.7, -0.7, 0]])
    return np.array([[com, foot], *([foot - arm, foot + arm] for arm in arms)])
